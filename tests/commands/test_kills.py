"""Killed at any moment, a comparison leaves a folder that is whole.

It is the old one or the new one, the same command goes on, and what comes of it in the end is equal
to what an uninterrupted run finds, bit for bit.
"""

import random
import signal
import subprocess
import sys
import time

import pytest

from train.compare.out_folder import RUN, part_of
from train.report.input import read

KILLS = 16


def live(words, log, seconds=None):
    """The exit status of a command, which is killed after so many seconds, if any."""
    with log.open("a") as file:
        process = subprocess.Popen([sys.executable, "-m", "train.cli", *words], stderr=file)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
    return process.wait()


def files(folder):
    """All but what tells of time."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != RUN}


def comparison(out, seed):
    names = ["--scenarios", "duo", "clutter-4", "--policies", "bearing-only", "tangent-joined"]
    numbers = ["--episodes", "20", "--keep", "2", "--seed", str(seed)]
    return ["compare", *names, *numbers, "--out", str(out)]


@pytest.mark.slow
def test_compare(tmp_path, capsys):
    log, whole, took = tmp_path / "log", {}, 0.0
    for seed in (0, 1):
        began = time.monotonic()
        assert live(comparison(tmp_path / f"whole-{seed}", seed), log) == 0
        took = time.monotonic() - began
        whole[seed] = files(tmp_path / f"whole-{seed}")
    out, moments = tmp_path / "out", random.Random(0)
    kills, found, runs, seed = 0, {"old": 0, "new": 0, "none": 0}, 0, 0
    while kills < KILLS:
        due = runs < kills // 6  # some come to their end, however busy the machine is
        moment = None if due else moments.uniform(0.4, 0.9) * took  # at work, or about to be
        status = live(comparison(out, seed), log, moment)
        assert status in (0, -signal.SIGKILL)
        kills += status != 0
        if out.exists():
            there = read(out).run["seed"]  # refuses what is not whole
            assert files(out) == whole[there]
            found["new" if there == seed else "old"] += status != 0
        else:
            assert runs == 0 or (part_of(out) / "whole" / RUN).exists()
            found["none"] += status != 0
        if status == 0:
            assert there == seed
            seed, runs = 1 - seed, runs + 1
    assert live(comparison(out, seed), log) == 0 and files(out) == whole[seed]
    left = {path.name for path in tmp_path.iterdir()} - {"whole-0", "whole-1", "log"}
    assert left == {"out"}
    assert "Traceback" not in log.read_text()
    with capsys.disabled():
        print(f"\ncompare: {kills} kills of {KILLS}, {runs} runs to the end, left: {found}")
