"""Short training runs, and their comparison."""

import os
import signal

import numpy as np
import pytest

from baselines.learned import checkpoints
from train import results
from train.learn import ppo, trainer
from train.learn.ppo import Config

UPDATE = 512
SMALL = {
    "scenario": "clutter-4", "num_envs": 8, "n_steps": 16, "batch_size": 128, "epochs": 2,
    "total_steps": 12 * UPDATE, "set_width": 8, "hidden": (16,), "eval_every": 2000,
    "eval_episodes": 4, "checkpoint_every": 1000, "tensorboard": False, "num_threads": 1,
}  # fmt: skip
"""Twelve updates of 512 steps."""
WALL_TIME = ("wall_s", "steps_per_s", "environment_share")
"""Columns of metrics.csv that differ between two runs that are otherwise the same."""


def config(out, **changes):
    return Config(**SMALL | {"out": out} | changes)


def flags(out, **changes):
    """The same as command-line arguments."""
    words = ["--out", str(out)]
    for name, value in (SMALL | changes).items():
        flag = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", *map(str, value if isinstance(value, tuple) else (value,))]
    return words


def metrics(folder):
    """Rows without time columns."""
    rows = results.read_csv(folder / "metrics.csv")
    return [{key: value for key, value in row.items() if key not in WALL_TIME} for row in rows]


def network(folder):
    return checkpoints.read(checkpoints.find(folder), ["network"])[1]["network"]


def assert_same_run(one, other):
    assert metrics(one) == metrics(other)
    assert (one / "evaluation.csv").read_text() == (other / "evaluation.csv").read_text()
    for name, weights in network(one).items():
        np.testing.assert_array_equal(weights, network(other)[name], name)


def stopped_after(settings, updates, number=signal.SIGTERM):
    """Run until a signal during the log of an update; returns the exit status."""
    real, done = trainer.Trainer.report, 0

    def report(self):
        nonlocal done
        done += 1
        if done == updates:
            os.kill(os.getpid(), number)
        return real(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer.Trainer, "report", report)
        return ppo.run(settings).status


def resumed(folder, **changes):
    """Resume a run to its end."""
    result = ppo.run(Config(resume=folder, **changes))
    assert result.status == 0
    return result


def assert_goes_on(folder, updates, **changes):
    """Assert that an interrupted and resumed run equals an uninterrupted one."""
    assert ppo.run(config(folder / "whole", **changes)).status == 0
    assert stopped_after(config(folder / "run", **changes), updates) == 128 + signal.SIGTERM
    resumed(folder / "run")
    assert_same_run(folder / "whole", folder / "run")
    return folder / "run"
