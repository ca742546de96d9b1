"""Upper bounds on collision-free success: an oracle planner, and randomised runs of law (4).

The success of the planner is the fraction of solvable initial conditions. The fraction solved by at
least one of many randomised certified runs is a lower estimate of the best heading policy.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.obstacle_rules.obstacle_avoidance import (
    CertifiedHeadingPolicy,
    tangent_merged_heading,
)
from rendezvous_env.baselines.references import privileged_planner

from rendezvous_env import baselines
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.trajectory import Policy

from .. import policies
from .evaluation import Episodes, counts_contacts, play
from .playing import Task
from .settings import Config

MIN_ALIGNMENT = 0.05
"""Minimum alignment ε of every run."""
_LEAST_CLEARANCE, _MOST_CLEARANCE = 0.02, 0.4  # rad
_SPREADS = (0.3, 0.6, 1.0)  # rad; of the constant bias of a robot in an episode
_WANDER = 0.3
"""Standard deviation of the varying bias relative to the constant one."""
_WANDER_TIME = 1.0  # s


def applies(scenario: Scenario) -> bool:
    """True if the merged-interval rule fits and the scenario has obstacles."""
    return "tangent-merged" in baselines.names(scenario) and counts_contacts(scenario)


def play_run(scenario: Scenario, number: int | None, episodes: int, seed: int) -> Episodes:
    """Run all initial conditions from ``seed`` on with one randomised policy.

    The run number determines all randomness: 0 randomises the clearance only, None is the planner.
    """
    make: Callable[[], Policy] = partial(baselines.make, privileged_planner.NAME, scenario)
    if number is not None:
        spread = _SPREADS[number % 3] if number else 0.0
        make = partial(randomised, scenario, seed=number, spread=spread)
    margin = None if number is None else MIN_ALIGNMENT
    return play(scenario, make, margin=margin, episodes=episodes, seed=seed)[0]


def tasks_of(scenario: Scenario, config: Config) -> list[Task]:
    """Tasks of the requested runs of law (4) and of the planner."""
    starts = config.count(scenario)
    return [
        Task(
            name=f"upper-bound-{scenario.name}-{'planner' if run is None else f'{run:04d}'}",
            label=f"{scenario.name} · best of {config.ceiling}",
            scenario=scenario,
            count=starts,
            work=partial(play_run, scenario, run, starts, config.seed),
            stays=bool(policies.registered(scenario)),
        )
        for run in (*range(config.ceiling), None)
    ]


def row_of(scenario: Scenario, runs: Sequence[Episodes]) -> dict[str, Any]:
    """Row of ceiling.csv from all runs on a scenario, with the planner's last.

    Fractions of initial conditions, and those without a collision-free run, or without success.
    """
    *own, planned = runs
    free = np.array([run.collision_free == 1 for run in own])
    success = np.array([run.success for run in own])
    return {
        "scenario": scenario.name,
        "episodes": free.shape[1],
        "runs": len(own),
        "collision_free_planner": float((planned.collision_free == 1).mean()),
        "collision_free_best": float(free.any(axis=0).mean()),
        "success_best": float(success.any(axis=0).mean()),
        "collision_free_mean": float(free.mean()),
        "never_collision_free": int((~free.any(axis=0)).sum()),
        "never_met": int((~success.any(axis=0)).sum()),
    }


def randomised(scenario: Scenario, *, seed: int, spread: float) -> CertifiedHeadingPolicy:
    """Merged-interval rule with f rotated by a random angle per robot.

    ``spread`` is the standard deviation of the angle, rad.
    """
    rule = _RandomRule(scenario.tau, np.random.default_rng(seed), spread)
    return CertifiedHeadingPolicy(scenario, rule, MIN_ALIGNMENT, math.pi / scenario.tau)


class _RandomRule:
    """Stateful heading rule with one random angle per robot."""

    def __init__(self, tau: float, random: np.random.Generator, spread: float) -> None:
        self.tau, self.random, self.spread = tau, random, spread
        self.clearance = float(random.uniform(_LEAST_CLEARANCE, _MOST_CLEARANCE))
        self._bias = self._wander = np.zeros(0)

    def __call__(
        self, net_bearing: NDArray[np.float64], silhouettes: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Headings of the rule for the rotated f, never opposite to the true f."""
        shape = net_bearing.shape[:-1]
        if self._bias.shape != shape:
            self._bias = self.random.normal(0.0, self.spread, shape)
            self._wander = np.zeros(shape)
        share = math.sqrt(2.0 * self.tau / _WANDER_TIME)
        self._wander *= 1.0 - self.tau / _WANDER_TIME
        self._wander += self.random.normal(0.0, share * _WANDER * self.spread, shape)
        f, aside, angle = net_bearing, net_bearing.copy(), self._bias + self._wander
        c, s = np.cos(angle), np.sin(angle)  # about z
        aside[..., 0] = c * f[..., 0] - s * f[..., 1]
        aside[..., 1] = s * f[..., 0] + c * f[..., 1]
        headings = tangent_merged_heading(aside, silhouettes, clearance=self.clearance)
        square = np.maximum(np.sum(f * f, axis=-1, keepdims=True), np.finfo(float).tiny)
        against = np.minimum(np.sum(headings * f, axis=-1, keepdims=True), 0.0)
        return headings - against / square * f
