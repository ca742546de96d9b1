"""What ``rendezvous bench`` times of the adapters: each learner's environment over ours.

An adapter is timed on what it adapts: bare, with nothing but the physics of ``make_vec``, where
robots never meet and where they learn, and in training, with all that ``vector.training_env`` does
and episodes that end.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from importlib import metadata
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import MultiDiscrete
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

import rendezvous_env as rv
from rendezvous_env.vector import training_env

from .bench_cases import Case, Running, spread_out

BARE: dict[str, Any] = {"guarantee": None, "learning_preset": False}
"""Choices of ``training_env`` under which it does what ``make_vec`` does."""
TRAINING = "clutter-8"
"""Scenario of the cases in training."""


class Learner(NamedTuple):
    """A library with an adapter."""

    name: str
    distribution: str
    """What it is installed as."""
    build: Callable[..., Running]
    """Makes something that steps, of a scenario, num_envs, num_threads and choices of
    ``training_env``."""


def adapters(n: int, num_envs: int, num_threads: int | None) -> list[Case]:
    """Bare steps of robots that never meet, for each learner that is installed."""
    return _cases(spread_out(n), num_envs, num_threads, ("make_vec", _raw), BARE)


def adapters_in_training(num_envs: int, num_threads: int | None) -> Iterator[list[Case]]:
    """Steps where robots learn, bare and in training, for each learner that is installed."""
    scenario = rv.scenarios.get(TRAINING)
    yield _cases(scenario, num_envs, num_threads, (f"make_vec of {TRAINING}", _raw), BARE)
    yield _cases(scenario, num_envs, num_threads, ("training_env", _training), {})


def _cases(
    scenario: rv.Scenario,
    num_envs: int,
    num_threads: int | None,
    ours: tuple[str, Callable[..., Running]],
    choices: dict[str, Any],
) -> list[Case]:
    size = ("adapters", scenario.n_robots, num_envs, num_envs, "team steps")
    name, build = ours
    found = [Case(name, *size, lambda: build(scenario, num_envs, num_threads))]
    for learner in LEARNERS:
        if is_installed(learner.distribution):
            make = learner.build
            found.append(
                Case(
                    f"{learner.name} over {name}",
                    *size,
                    lambda make=make: make(scenario, num_envs, num_threads, **choices),
                    name,
                )
            )
    return found


def is_installed(distribution: str) -> bool:
    """Whether a library is there."""
    try:
        metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return False
    return True


def actions_of(space: Any, num_envs: int) -> Iterator[NDArray[Any]]:
    """Random actions of all teams again and again, from the space of one team."""
    random = np.random.default_rng(0)
    shape = (8, num_envs, *space.shape)
    if isinstance(space, MultiDiscrete):
        return itertools.cycle(random.integers(space.nvec[0], size=shape))
    return itertools.cycle(random.uniform(space.low, space.high, shape).astype(np.float32))


def _stepping(env: VectorEnv[Any, Any, Any]) -> Running:
    env.reset(seed=0)
    tape = actions_of(env.single_action_space, env.num_envs)
    return Running(lambda: env.step(next(tape)), lambda: True)


def _raw(scenario: rv.Scenario, num_envs: int, num_threads: int | None) -> Running:
    return _stepping(rv.make_vec(scenario, num_envs, num_threads=num_threads))


def _training(scenario: rv.Scenario, num_envs: int, num_threads: int | None) -> Running:
    return _stepping(training_env(scenario, num_envs, num_threads=num_threads))


def _torchrl(
    scenario: rv.Scenario, num_envs: int, num_threads: int | None, **choices: Any
) -> Running:
    """What ``rollout`` and collectors do with each step, without a policy and without storing."""
    import torch

    from rendezvous_env.adapters.torchrl import GROUP, RendezvousEnv

    env = RendezvousEnv(scenario, num_envs, num_threads=num_threads, seed=0, **choices)
    given = actions_of(env.teams.single_action_space, num_envs)
    tape = itertools.cycle([torch.from_numpy(next(given)) for _ in range(8)])
    now = [env.reset()]

    def step() -> None:
        now[0].set((GROUP, "action"), next(tape))
        now[0] = env.step_and_maybe_reset(now[0])[1]

    return Running(step, lambda: True)


def _pufferlib(
    scenario: rv.Scenario, num_envs: int, num_threads: int | None, **choices: Any
) -> Running:
    from rendezvous_env.adapters.pufferlib import make

    env = make(scenario, num_envs, num_threads=num_threads, seed=0, **choices)
    env.reset()
    given = actions_of(env.slots.teams.single_action_space, num_envs)
    tape = itertools.cycle([next(given).reshape(env.actions.shape) for _ in range(8)])
    return Running(lambda: env.step(next(tape)), lambda: True)


LEARNERS = (
    Learner("TorchRL", "torchrl", _torchrl),
    Learner("PufferLib", "pufferlib-core", _pufferlib),
)
"""Libraries whose adapters are timed where they are installed."""
