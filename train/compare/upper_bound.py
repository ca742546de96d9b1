"""Upper bounds: by a planner that knows the map, and by law (4).

The planner's collision-free success is the share of starts that are possible. The share that at
least one of many randomised certified runs passed without a collision is an estimate, from below,
of what any heading policy can reach.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.obstacle_rules.obstacle_avoidance import (
    CertifiedHeadingPolicy,
    tangent_joined_heading,
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
"""ε of every run."""
_LEAST_CLEARANCE, _MOST_CLEARANCE = 0.02, 0.4  # rad
_SPREADS = (0.3, 0.6, 1.0)  # rad; of the bias that a robot keeps for an episode
_WANDER = 0.3
"""Spread of the varying bias, as a share of the constant one."""
_WANDER_TIME = 1.0  # s


def applies(scenario: Scenario) -> bool:
    """Whether the joined rule, whose runs these are, fits, and there is something to touch."""
    return "tangent-joined" in baselines.names(scenario) and counts_contacts(scenario)


def play_run(scenario: Scenario, number: int | None, episodes: int, seed: int) -> Episodes:
    """Play a run on the starts from ``seed`` on. All that is random follows from its number; 0 is
    the joined rule with nothing random but its clearance, None the planner.
    """
    make: Callable[[], Policy] = partial(baselines.make, privileged_planner.NAME, scenario)
    if number is not None:
        spread = _SPREADS[number % 3] if number else 0.0
        make = partial(randomised, scenario, seed=number, spread=spread)
    margin = None if number is None else MIN_ALIGNMENT
    return play(scenario, make, margin=margin, episodes=episodes, seed=seed)[0]


def tasks_of(scenario: Scenario, config: Config) -> list[Task]:
    """The runs of law (4) that are asked for, and the planner's."""
    starts = config.starts(scenario)
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
    """The row of ceiling.csv of all runs on a scenario, of which the planner's is the last:
    fractions 0–1 of the starts, and starts that no run passed cleanly, or at all.
    """
    *own, planned = runs
    clean = np.array([run.clean == 1 for run in own])
    success = np.array([run.success for run in own])
    return {
        "scenario": scenario.name,
        "episodes": clean.shape[1],
        "runs": len(own),
        "clean_planner": float((planned.clean == 1).mean()),
        "clean_best": float(clean.any(axis=0).mean()),
        "success_best": float(success.any(axis=0).mean()),
        "clean_mean": float(clean.mean()),
        "never_clean": int((~clean.any(axis=0)).sum()),
        "never_met": int((~success.any(axis=0)).sum()),
    }


def randomised(scenario: Scenario, *, seed: int, spread: float) -> CertifiedHeadingPolicy:
    """The joined rule looking past f by an angle that is random for each robot, of standard
    deviation ``spread``, rad.
    """
    rule = _RandomRule(scenario.tau, np.random.default_rng(seed), spread)
    return CertifiedHeadingPolicy(scenario, rule, MIN_ALIGNMENT, math.pi / scenario.tau)


class _RandomRule:
    """A heading rule with memory of its random angles, one for each robot."""

    def __init__(self, tau: float, random: np.random.Generator, spread: float) -> None:
        self.tau, self.random, self.spread = tau, random, spread
        self.clearance = float(random.uniform(_LEAST_CLEARANCE, _MOST_CLEARANCE))
        self._bias = self._wander = np.zeros(0)

    def __call__(
        self, net_bearing: NDArray[np.float64], silhouettes: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Headings of the joined rule, as if f pointed elsewhere; never against the true f."""
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
        headings = tangent_joined_heading(aside, silhouettes, clearance=self.clearance)
        square = np.maximum(np.sum(f * f, axis=-1, keepdims=True), np.finfo(float).tiny)
        against = np.minimum(np.sum(headings * f, axis=-1, keepdims=True), 0.0)
        return headings - against / square * f
