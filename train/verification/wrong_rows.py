"""Policies that are shown wrong bearings, as wrong as is allowed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env import Scenario
from rendezvous_env.trajectory import Policy

from .adversaries import Steered, across, adversary
from .cases import BATCH, Case
from .claim import Array
from .flow_sights import turned, unit
from .laws import by_name
from .tank_cases import tanked

KINDS = ("against", "spinning", "anyhow", "switching", "outward")
_SWITCHING = 7
"""Steps after which errors turn round."""
_ROUNDED = 1.0 - 1e-6
"""Share of an error that is still none too much after rounding to float32."""


class Misled:
    """A policy behind a sensor whose bearings are turned: away from f, to one side, anyhow, or to
    changing sides; "outward" away from the middle of what is seen, for each robot its own kind.

    Args:
        scenario: whose robots they are.
        policy: what acts on what is seen.
        error: η, rad.
        random: draws the kinds.
    """

    def __init__(
        self, scenario: Scenario, policy: Policy, error: float, random: np.random.Generator
    ) -> None:
        self.policy, self._scenario, self._random = policy, scenario, random
        self._error, self._step = error * _ROUNDED, 0
        kinds = random.integers(len(KINDS), size=(BATCH, scenario.n_robots, 1, 1))
        alike = random.random(BATCH) < 0.5
        kinds[alike] = kinds[alike, :1]
        self._kinds, self._axis = kinds, random.normal(size=(BATCH, scenario.n_robots, 1, 3))

    def watch(self, teams: object) -> None:
        """Let the policy look at these teams, if it does."""
        if hasattr(self.policy, "watch"):
            self.policy.watch(teams)

    def __call__(self, observations: NDArray[np.float32], time: ArrayLike) -> NDArray[np.float32]:
        """What the policy does when it sees the turned rows."""
        seen, layout = observations.copy(), self._scenario.observation_layout
        rows = observations[..., layout.neighbours, :].astype(np.float64)
        lengths = np.linalg.norm(rows, axis=-1, keepdims=True)
        wrong = turned(unit(rows), self._towards(rows), self._error)
        seen[..., layout.neighbours, :] = lengths * wrong
        self._step += 1
        return self.policy(seen, np.asarray(time))

    def _towards(self, rows: Array) -> Array:
        """Directions of the shape of the rows."""
        against = -np.broadcast_to(rows.sum(axis=-2, keepdims=True), rows.shape)
        side = across(unit(rows), np.broadcast_to(self._axis, (*rows.shape[:-1], 3)))
        outward = -np.broadcast_to(unit(rows).sum(axis=-2, keepdims=True), rows.shape)
        there = -1.0 if self._step // _SWITCHING % 2 else 1.0
        anyhow = self._random.normal(size=rows.shape)
        return np.asarray(np.choose(self._kinds, (against, side, anyhow, there * side, outward)))


def misled_law_1(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Law (1) on wrong bearings."""
    law = by_name("bearing-only")(case, num_envs, random)
    return Misled(case.scenario, law, case.error, random)


def misled_headings(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """All adversaries under headings that allow for errors, on wrong bearings."""
    scenario = case.scenario
    chooser = adversary(scenario, num_envs, random)
    careful = Steered(
        scenario,
        num_envs,
        chooser,
        decision_period=int(random.choice([1, 1, 5])),
        min_alignment=case.margin,
        max_turn_rate=float(random.uniform(1.0, 10.0)),
        frame=str(random.choice(["net_bearing", "local"])),
        bearing_error=case.error,
    )
    return Misled(scenario, careful, case.error, random)


def misled_tanks(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """All wishes under a tank that allows for errors, on wrong bearings."""
    return Misled(case.scenario, tanked(case, num_envs, random), case.error, random)
