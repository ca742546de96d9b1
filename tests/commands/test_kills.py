"""Killed at any moment, a comparison and a training run leave a folder that is whole.

It is the old one or the new one, the same command goes on, and what comes of it in the end is equal
to what an uninterrupted run finds, bit for bit.
"""

import os
import random
import signal
import time
from contextlib import suppress

import numpy as np
import pytest
from fork_server import ForkServer

from baselines.learned import checkpoints, plain_data
from train import results
from train.compare.out_folder import RUN, part_of
from train.learn.checkpoint import STATE_FILES
from train.learn.log import WALL_TIME
from train.learn.ppo import Config
from train.report.input import read

KILLS = 40


@pytest.fixture
def server(tmp_path):
    """A server whose commands said nothing of a traceback."""
    running = ForkServer(tmp_path / "log")
    yield running
    running.close()
    assert "Traceback" not in (tmp_path / "log").read_text()


def live(server, words, seconds):
    """Run a command for so long and kill it, unless that is None; its exit status."""
    process = server.start(words)
    if seconds is not None:
        time.sleep(seconds)
        with suppress(ProcessLookupError):  # it has ended by itself
            os.kill(process, signal.SIGKILL)
    return server.status()


def duration(server, words):
    """How long a command takes that nothing stops, s."""
    began = time.monotonic()
    server.start(words)
    assert server.status() == 0
    return time.monotonic() - began


def files(folder):
    """All but what tells of time."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != RUN}


def comparison(out, seed):
    names = ["--scenarios", "duo", "clutter-4", "--policies", "bearing-only", "tangent-joined"]
    numbers = ["--episodes", "20", "--keep", "2", "--seed", str(seed)]
    return ["compare", *names, *numbers, "--out", str(out)]


@pytest.mark.slow
def test_compare(server, tmp_path, capsys):
    server.start(comparison(tmp_path / "warm", 0), kept=True)
    assert server.status() == 0
    whole, took = {}, 0.0
    for seed in (0, 1):
        took = duration(server, comparison(tmp_path / f"whole-{seed}", seed))
        whole[seed] = files(tmp_path / f"whole-{seed}")
    out, moments = tmp_path / "out", random.Random(0)
    kills, found, runs, seed = 0, {"old": 0, "new": 0, "none": 0}, 0, 0
    while kills < KILLS:
        due = runs < kills // 16  # some come to their end, however busy the machine is
        moment = None if due else moments.uniform(0.0, 0.8 * took)
        status = live(server, comparison(out, seed), moment)
        assert status in (0, -signal.SIGKILL)
        kills += status != 0
        if out.exists():
            there = read(out).run["seed"]  # refuses what is not whole
            assert files(out) == whole[there]
            found["new" if there == seed else "old"] += status != 0
        else:
            assert runs == 0 or (part_of(out) / RUN).exists()
            found["none"] += status != 0
        if status == 0:
            assert there == seed
            seed, runs = 1 - seed, runs + 1
    server.start(comparison(out, seed))
    assert server.status() == 0 and files(out) == whole[seed]
    left = {path.name for path in tmp_path.iterdir()} - {"warm", "whole-0", "whole-1", "log"}
    assert left == {"out"}
    with capsys.disabled():
        print(f"\ncompare: {kills} kills of {KILLS}, {runs} runs to the end, left: {found}")


SMALL = {
    "scenario": "clutter-4", "num-teams": 8, "n-steps": 16, "batch-size": 128, "epochs": 2,
    "total-steps": 12 * 512, "set-width": 8, "hidden": 16, "eval-every": 2000, "eval-starts": 2,
    "checkpoint-every": 1000, "num-threads": 1,
}  # fmt: skip


def training(folder):
    """Begin a run, or go on with it."""
    if (folder / "config.json").exists():
        return ["train", "--resume", str(folder)]
    words = [word for name, value in SMALL.items() for word in (f"--{name}", str(value))]
    return ["train", *words, "--no-tensorboard", "--out", str(folder)]


def outcome(folder):
    """Metrics without times, evaluations, and all arrays of the last checkpoint."""
    rows = results.read_csv(folder / "metrics.csv")
    metrics = [{key: row[key] for key in row if key not in WALL_TIME} for row in rows]
    _, tables = checkpoints.read(checkpoints.find(folder), STATE_FILES)
    return metrics, (folder / "evaluation.csv").read_text(), tables


def assert_equal(one, other):
    assert one[:2] == other[:2]
    for name, arrays in one[2].items():
        assert arrays.keys() == other[2][name].keys()
        for key, array in arrays.items():
            np.testing.assert_array_equal(array, other[2][name][key], key)


@pytest.mark.slow
def test_train(server, tmp_path, capsys):
    server.start(training(tmp_path / "warm"), kept=True)
    assert server.status() == 0
    took = duration(server, training(tmp_path / "whole"))
    whole, moments = outcome(tmp_path / "whole"), random.Random(1)
    kills = runs = resumed = 0
    while kills < KILLS:
        folder = tmp_path / f"run-{runs}"
        status = live(server, training(folder), moments.uniform(0.0, 0.6 * took))
        assert status in (0, -signal.SIGKILL)
        kills += status != 0
        if (folder / "config.json").exists():
            Config.from_plain(plain_data.read_json(folder / "config.json"))
        if checkpoints.candidates(folder):
            checkpoints.read(checkpoints.find(folder), STATE_FILES)  # refuses what is not whole
            resumed += status != 0
        if status == 0:
            assert_equal(outcome(folder), whole)
            runs += 1
    folder = tmp_path / f"run-{runs}"
    server.start(training(folder))
    assert server.status() == 0
    assert_equal(outcome(folder), whole)
    with capsys.disabled():
        print(f"\ntrain: {kills} kills of {KILLS}, {resumed} with a checkpoint, {runs + 1} runs")
