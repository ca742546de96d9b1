"""What every framework's script shares: how its door and what it learned are judged."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv

SCENARIO = "clutter-16"
"""Four robots among sixteen discs."""
STARTS = range(10_000, 10_100)
"""Seeds on which nobody trains."""

Policy = Callable[[NDArray[np.float32]], NDArray[Any]]
"""Observations of robots, (n, size), to their actions."""


def clean_success(policy: Policy, starts: Sequence[int] = STARTS) -> float:
    """Share of held-out starts on which all robots meet and none touches an obstacle."""
    env, clean = rv.training_env(SCENARIO), 0
    for seed in starts:
        observations, infos = env.reset(seed=seed)
        while env.agents:
            names, seen = zip(*observations.items(), strict=True)
            actions = dict(zip(names, policy(np.stack(seen)), strict=True))
            observations, _, _, _, infos = env.step(actions)
        last = next(iter(infos.values()))
        clean += bool(last["success"] and not last["contacts"])
    return clean / len(starts)


def frames_per_second(steps: Callable[[], int], seconds: float = 2.0) -> float:
    """Steps of single robots a second.

    Args:
        steps: takes some, and says how many; called once beforehand, to warm up.
        seconds: least time of the measurement.
    """
    steps()
    began, count = time.perf_counter(), 0
    while (passed := time.perf_counter() - began) < seconds:
        count += steps()
    return count / passed


def report(**figures: float) -> None:
    """Print figures as one line of JSON."""
    print(json.dumps(figures))
