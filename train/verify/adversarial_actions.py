"""Adversaries that know where all robots are, and choose what a policy is allowed to choose."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import rendezvous_env as rv
from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.safety.settings import MAX_TURN_RATE

from .adversarial_bearings import unit
from .adversaries import orthogonal_rates
from .monitors import Moment

Array = NDArray[np.float64]
_TINY = 1e-12

WISHES = (
    "flee",
    "across",
    "outward",
    "from_farthest",
    "from_nearest",
    "to_nearest",
    "frozen",
    "random",
    "rest",
)
"""Against V; against its fall; against the hull; against links; to make merges; and blindly."""


class Adversary:
    """Knows where all robots are, and makes of it what a policy is allowed to choose.

    Half of the teams have one kind of wish, which all their robots share; in the others each robot
    has its own, and every fourth team draws anew now and then.

    Args:
        scenario: whose robots are misled.
        num_envs: B.
        by: what stands between the choices and the robots.
        random: draws all kinds.
    """

    def __init__(
        self, scenario: rv.Scenario, num_envs: int, by: str, random: np.random.Generator
    ) -> None:
        self.scenario, self.by, self.random = scenario, by, random
        self.size = num_envs, scenario.n_robots
        self.kinds = random.integers(len(WISHES), size=self.size)
        alike = np.arange(num_envs) % 2 == 0
        self.kinds[alike] = self.kinds[alike, :1]
        self.restless = np.arange(num_envs) % 4 == 3
        self.frozen = random.normal(size=(*self.size, scenario.dim))
        self.side = random.choice([-1.0, 1.0], size=(*self.size, 1))
        self.strength = np.where(
            random.random((*self.size, 1)) < 0.7, 1.0, random.random((*self.size, 1))
        )
        self.blind = random.uniform(-1.0, 1.0, (*self.size, max(scenario.action_size, 3)))

    def __call__(self, observations: NDArray[np.float32], teams: Moment) -> ArrayLike:
        """Choices (B, n, k)."""
        redrawn = self.restless[:, None] & (self.random.random(self.size) < 0.1)
        self.kinds[redrawn] = self.random.integers(len(WISHES), size=int(redrawn.sum()))
        if self.by == "gains":
            return self._gains(observations, teams)
        if not self.scenario.model.bounded:
            return self._controls(observations)
        wishes = self._directions(teams) * self.strength
        return np.einsum("bnji,bnj->bni", teams.frames, wishes)

    def _directions(self, teams: Moment) -> Array:
        """What each robot wants, in the global frame, (B, n, d)."""
        wanted = self.random.normal(size=self.frozen.shape)
        now = teams.positions, teams.active, teams.weights
        _want(now, (self.kinds, self.frozen, self.side), np.zeros((4, wanted.shape[-1])), wanted)
        return wanted

    def _gains(self, observations: NDArray[np.float32], teams: Moment) -> Array:
        """Weights (B, n, K) of the rows: one row alone, all alike, or blindly."""
        rows = self.scenario.observation_layout.split(observations).neighbours
        rows = rows.astype(np.float64)
        seen = np.any(rows, axis=-1)
        wishes = np.einsum("bnji,bnj->bni", teams.frames, self._directions(teams))
        score = np.where(seen, np.einsum("bnkd,bnd->bnk", unit(rows), wishes), -np.inf)
        # the row that is wanted most, and the others by ever so little
        chosen = (score == score.max(axis=-1, keepdims=True)).astype(float)
        leaning = np.where(seen, np.clip(score, 0.0, 1.0), 0.0)
        blind = self.random.random(chosen.shape)
        style = (np.arange(self.size[1]) + np.arange(self.size[0])[:, None] // 2)[..., None] % 4
        weights = np.choose(style, (chosen, chosen, leaning, blind))
        return np.where(self.kinds[..., None] == WISHES.index("rest"), 0.0, weights)

    def _controls(self, observations: NDArray[np.float32]) -> Array:
        """Inputs of robots that turn, in units of their bounds: blind, held, to and fro, away from
        f or keeping it abeam.
        """
        scenario = self.scenario
        f = scenario.observation_layout.net_bearing(observations)
        size = scenario.action_size - (self.by == "heading")
        if size < 1:
            return np.zeros((*self.size, 1))
        held, anew = self.blind[..., :size], self.random.uniform(-1, 1, (*self.size, size))
        limits = np.minimum(MAX_TURN_RATE, scenario.action_bounds[1:])
        abeam = anew
        if scenario.model.nonholonomic:
            abeam = np.clip(orthogonal_rates(f, None, scenario.tau) / limits, -1.0, 1.0)
        full = abeam
        if self.by != "heading":
            full = np.concatenate([-np.sign(f[..., :1]), abeam], axis=-1)[..., :size]
        chosen = np.choose(self.kinds[..., None] % 4, (full, held, anew, np.sign(held)))
        return np.asarray(chosen)


@kernel
def _want(now: Any, wishes: Any, seen: Any, wanted: Any) -> None:
    """Write unit vectors, or zero, by the WISHES of robots over what they would want blindly.

    Args:
        now: places (B, n, d), who is there (B, n), weights (B, n, n).
        wishes: kinds (B, n), fixed vectors (B, n, d) and sides ±1 (B, n, 1).
        seen: working memory, (4, d).
        wanted: random vectors, (B, n, d).
    """
    kinds, frozen, side = wishes
    for b in range(wanted.shape[0]):
        for i in range(wanted.shape[1]):
            kind, aim = kinds[b, i], wanted[b, i]
            for k in range(len(aim) if kind == 6 or kind == 8 else 0):
                aim[k] = frozen[b, i, k] if kind == 6 else 0.0
            if kind < 6:
                _look_round(now, b, i, seen)
                if kind == 1:
                    _across(seen[0], frozen[b, i], side[b, i, 0], aim)
                else:
                    ahead = seen[0 if kind == 0 else min(kind - 1, 3)]
                    _scale(ahead, 1.0 if kind == 2 or kind == 5 else -1.0, aim)


@inner_kernel
def _look_round(now: Any, b: int, i: int, seen: Any) -> None:
    """Write what f_i is, what leads away from all others, and where the farthest and the nearest of
    those lie that robot i is linked to, (4, d); zero where there is nobody.
    """
    places, active, weights = now
    farthest, nearest = 0.0, np.inf
    for k in range(4 * places.shape[2]):
        seen[k // places.shape[2], k % places.shape[2]] = 0.0
    for j in range(places.shape[1]):
        if j == i or not (active[b, i] and active[b, j]):
            continue
        square = 0.0
        for k in range(places.shape[2]):
            square += (places[b, j, k] - places[b, i, k]) ** 2
        distance, weight = max(math.sqrt(square), _TINY), weights[b, i, j]
        far, near = weight > 0.0 and distance > farthest, weight > 0.0 and distance < nearest
        farthest, nearest = distance if far else farthest, distance if near else nearest
        for k in range(places.shape[2]):
            offset = places[b, j, k] - places[b, i, k]
            seen[0, k] += weight * offset / distance
            seen[1, k] -= offset
            seen[2, k] = offset if far else seen[2, k]
            seen[3, k] = offset if near else seen[3, k]


@inner_kernel
def _across(ahead: Any, axis: Any, side: float, aim: Any) -> None:
    """Write the unit vector across one (d,): turned by 90° in the plane, ahead × axis in 3-D."""
    aim[0], aim[1] = -ahead[1], ahead[0]
    if len(aim) == 3:
        aim[0] = ahead[1] * axis[2] - ahead[2] * axis[1]
        aim[1] = ahead[2] * axis[0] - ahead[0] * axis[2]
        aim[2] = ahead[0] * axis[1] - ahead[1] * axis[0]
    _scale(aim, side, aim)


@inner_kernel
def _scale(ahead: Any, length: float, aim: Any) -> None:
    """Write a vector (d,) of this length along one; zero stays zero."""
    square = 0.0
    for k in range(len(aim)):
        square += ahead[k] ** 2
    by = length / math.sqrt(square) if square > _TINY**2 else 0.0
    for k in range(len(aim)):
        aim[k] = ahead[k] * by
