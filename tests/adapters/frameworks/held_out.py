"""Common measurement of speed and success for the framework scripts."""

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv

SCENARIO = "clutter-16"
"""Four robots among sixteen discs."""
Policy = Callable[[NDArray[np.float32]], NDArray[Any]]
"""Observations of robots, (n, size) → actions."""


def settings(description: str | None, **defaults: int) -> argparse.Namespace:
    """Options of a script with defaults; ``episodes`` counts held-out ones."""
    parser = argparse.ArgumentParser(description=description)
    for name, default in (defaults | {"episodes": 100}).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=default)
    return parser.parse_args()


def collision_free_success(policy: Policy, episodes: int) -> float:
    """Fraction of held-out initial conditions with collision-free rendezvous."""
    env, clean = rv.training_env(SCENARIO), 0
    for seed in range(10_000, 10_000 + episodes):
        observations, infos = env.reset(seed=seed)
        while env.agents:
            names, seen = zip(*observations.items(), strict=True)
            actions = dict(zip(names, policy(np.stack(seen)), strict=True))
            observations, _, _, _, infos = env.step(actions)
        last = next(iter(infos.values()))
        clean += bool(last["success"] and not last["contacts"])
    return clean / episodes


def measure(
    steps: Callable[[], int], train: Callable[[], int], policy: Policy, episodes: int
) -> None:
    """Train, and print one line of JSON: speed, duration, success before and after.

    Args:
        steps: takes random steps, and returns how many, of single robots.
        train: trains what the policy uses, and returns how many steps of robots it took.
        policy: the one that is judged.
        episodes: number of held-out episodes.
    """
    steps()  # warms up
    began, count = time.perf_counter(), 0
    while (passed := time.perf_counter() - began) < 2.0:
        count += steps()
    before = collision_free_success(policy, episodes)
    began = time.perf_counter()
    found = {"frames_per_second": count / passed, "training_frames": train()}
    found |= {"training_seconds": time.perf_counter() - began, "before": before}
    print(json.dumps(found | {"after": collision_free_success(policy, episodes)}))
