"""What ``rendezvous bench`` times of the wrappers that keep a guarantee."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

import rendezvous_env as rv
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper

from .bench_cases import Case, Running, spread_out


def wrapped(n: int, num_envs: int, num_threads: int | None) -> list[Case]:
    """Steps of many teams under random choices, beside the certified heading's."""
    # robots that are steered go towards each other, unlike those of random actions
    scenario = spread_out(n).replace(spawn_size=1e6 * n)

    def build(wrap: Callable[[Any], Any]) -> Running:
        venv = wrap(rv.make_vec(scenario, num_envs, num_threads=num_threads))
        venv.reset(seed=0)
        choices = np.random.default_rng(0).uniform(-1, 1, (8, *venv.action_space.shape))
        tape = itertools.cycle(choices.astype(np.float32))
        intact = lambda: bool(venv.unwrapped.simulator.active.all())  # noqa: E731
        return Running(lambda: venv.step(next(tape)), intact)

    size = ("wrapped", n, num_envs, num_envs, "team steps")
    heading = "HeadingVectorWrapper"
    return [
        Case("make_vec", *size, lambda: build(lambda env: env)),
        Case(heading, *size, lambda: build(HeadingVectorWrapper)),
        Case("EnergyTankWrapper", *size, lambda: build(EnergyTankWrapper), heading),
    ]
