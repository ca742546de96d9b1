"""Ctrl-C and SIGTERM: commands end soon with one line, and finished work is kept.

Finished work is also kept after SIGKILL.
"""

import random
import signal
import subprocess
import sys
import time
from itertools import product

import numpy as np
import pytest
from parameters import needed, slow

from baselines.obstacle_rules.merged_intervals_2d import TWO_PI, counter_clockwise
from train import cli, interrupts
from train.compare.out_folder import RUN, part_of
from train.report.input import read

COMMANDS = {
    "compare": ["--scenarios", "clutter-24", "--episodes", "3000", "--out", "out"],
    "train": ["--scenario", "clutter-24", "--num-threads", "1", "--out", "run"],
    "verify": ["--trials", "1000000", "--out", "out"],
    "render": ["--scenario", "clutter-16", "--speed", "0.01", "--out", "x.gif"],
    "bench": ["--seconds", "60", "--only", "one-team"],
}
"""Commands that may take long; the others share the same lines of cli.py."""
ANNOUNCED = """
run = c._run
def announced(*words):
    print("at work", flush=True)
    return run(*words)
c._run = announced"""
SIGNALS = [signal.SIGINT, signal.SIGTERM]
KILLS = 4


def start(words, folder, before=""):
    """Start a command in a new process, whether or not this one ignores Ctrl-C."""
    code = f"import sys, train.cli as c\n{before}\nsys.exit(c.main())"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-c", code, *words], cwd=folder, text=True, **pipes)


def stop(process, number):
    """Send a signal; returns the exit status, the output, and the duration, s."""
    began = time.monotonic()
    process.send_signal(number)
    try:
        said, wrong = process.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, said, wrong, time.monotonic() - began


FAST = ("compare", signal.SIGINT)
OWN = {FAST, ("train", signal.SIGTERM)}


class TestCommands:
    @pytest.mark.parametrize(
        ("command", "number"),
        [
            FAST,
            needed("train", signal.SIGTERM),
            *(slow(*both) for both in product(("compare", "train"), SIGNALS) if both not in OWN),
            slow("verify", signal.SIGTERM),
            slow("render", signal.SIGINT),
            slow("bench", signal.SIGTERM),
        ],
    )
    def test_signal_ends_running_command(self, command, number, tmp_path):
        process = start([command, *COMMANDS[command]], tmp_path, ANNOUNCED)
        assert process.stdout.readline() == "at work\n"  # however busy the machine is
        time.sleep(3.0)
        assert process.poll() is None
        status, said, wrong, took = stop(process, number)
        assert status == 128 + number and took < 5.0
        assert "Traceback" not in wrong and wrong.count("\n") <= 1
        assert "interrupted" in wrong or "stopped at step" in said
        assert not list(tmp_path.rglob("*.part.*"))

    @pytest.mark.slow
    def test_signal_ends_command_while_importing(self, tmp_path):
        for wait in (0.3, 0.6, 0.9):
            process = start(["compare", *COMMANDS["compare"]], tmp_path)
            time.sleep(wait)
            status, _, wrong, took = stop(process, signal.SIGTERM)
            assert status in (-signal.SIGTERM, 128 + signal.SIGTERM) and took < 5.0
            assert "Traceback" not in wrong and wrong.count("\n") <= 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "body"),
    [
        slow(signal.SIGINT, "print('at work', flush=True)\n    while True:\n"
             "        try: time.sleep(60)\n        except BaseException: pass"),
        (signal.SIGTERM, "work = numba.njit(nogil=True)(spin)\n    work(numpy.ones(1))\n"
         "    print('at work', flush=True)\n    work(numpy.zeros(1))"),
    ],
    ids=["exception-lost", "compiled-code"],
)  # fmt: skip
def test_grace_period_ends_unresponsive_command(number, body, tmp_path):
    before = (
        "import time, numba, numpy\n"
        "def spin(x):\n    while x[0] == 0: pass\n"
        f"def run(*words):\n    {body}\n"
        "c._run = run"
    )
    process = start(["compare"], tmp_path, before)
    assert process.stdout.readline() == "at work\n"
    time.sleep(1.0)
    status, _, wrong, took = stop(process, number)
    assert status == 128 + number and interrupts.GRACE - 0.1 < took < 5.0
    assert wrong.startswith("rendezvous compare: interrupted; it did not stop in time")


class TestInside:
    def test_signal_handlers_are_restored(self, monkeypatch, capsys):
        before = [signal.getsignal(number) for number in SIGNALS]
        monkeypatch.setattr(cli, "_run", lambda *words: signal.raise_signal(signal.SIGTERM))
        assert cli.main(["compare"]) == 128 + signal.SIGTERM
        assert [signal.getsignal(number) for number in SIGNALS] == before
        assert capsys.readouterr().err.count("\n") == 1

    @pytest.mark.parametrize(
        ("error", "words"),
        [
            (OSError(28, "No space left on device", "x.csv"), "x.csv: No space left on device"),
            (MemoryError(), "not enough memory"),
        ],
    )
    def test_full_disk_or_memory_is_one_line(self, error, words, monkeypatch, capsys):
        def full(*given):
            raise error

        monkeypatch.setattr(cli, "_run", full)
        assert cli.main(["verify"]) == 2
        said = capsys.readouterr().err
        assert words in said and said.count("\n") == 1


def test_angle_reduction_of_huge_values_terminates():
    for turns in (-40, -16, -3, -1, 0, 1, 2, 15.9, 16, 1e6):
        angle = 1.25 + turns * TWO_PI
        found = counter_clockwise(angle)
        assert 0 <= found < TWO_PI
        assert np.exp(1j * found) == pytest.approx(np.exp(1j * angle), abs=1e-9)
    assert np.isnan([counter_clockwise(x) for x in (np.inf, -np.inf, np.nan)]).all()


def live(words, folder, seconds=None):
    """Exit status of a command, which is killed after a number of seconds, if given."""
    process = start(words, folder)
    try:
        _, wrong = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        _, wrong = process.communicate()
    assert "Traceback" not in wrong
    return process.returncode


def files(folder):
    """All entries except times."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != RUN}


def comparison(out, seed):
    names = ["--scenarios", "duo", "clutter-4", "--policies", "bearing-only", "tangent-merged"]
    numbers = ["--episodes", "20", "--keep", "2", "--seed", str(seed)]
    return ["compare", *names, *numbers, "--out", str(out)]


@pytest.mark.nightly
def test_killed_compare_leaves_complete_folder(tmp_path):
    """The folder is the old or the new one, and the same command resumes.

    The final result is bitwise equal to that of an uninterrupted run.
    """
    whole = {}
    for seed in (0, 1):
        began = time.monotonic()
        assert live(comparison(tmp_path / f"whole-{seed}", seed), tmp_path) == 0
        took = time.monotonic() - began
        whole[seed] = files(tmp_path / f"whole-{seed}")
    out, moments, kills, runs = tmp_path / "out", random.Random(0), 0, 0
    while kills < KILLS:
        seed = runs % 2
        due = runs < kills // 3  # some come to their end, however busy the machine is
        moment = None if due else moments.uniform(0.4, 0.9) * took  # at work, or about to be
        began = time.monotonic()
        status = live(comparison(out, seed), tmp_path, moment)
        assert status in (0, -signal.SIGKILL)
        kills += status != 0
        if out.exists():
            there = read(out).run["seed"]  # refuses what is not whole
            assert files(out) == whole[there]
        else:
            assert runs == 0 or (part_of(out) / "whole" / RUN).exists()
        if status == 0:
            assert there == seed
            took = time.monotonic() - began  # the machine may be less busy than before
            runs += 1
    assert live(comparison(out, seed), tmp_path) == 0 and files(out) == whole[seed]
    left = {path.name for path in tmp_path.iterdir()} - {"whole-0", "whole-1"}
    assert left == {"out"}
