"""Adversaries that know where all robots are, and choose what a policy is allowed to choose."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import rendezvous_env as rv
from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.safety.settings import MAX_TURN_RATE

from .adversarial_bearings import length_of, set_across
from .adversaries import orthogonal_rates
from .monitors import Moment

Array = NDArray[np.float64]
_TINY = 1e-12

KINDS = (
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

    Half of the teams have one kind of desired input, which all their robots share; in the others
    each robot has its own, and every fourth team draws anew now and then.

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
        self.kinds = random.integers(len(KINDS), size=self.size)
        alike = np.arange(num_envs) % 2 == 0
        self.kinds[alike] = self.kinds[alike, :1]
        self.frozen = random.normal(size=(*self.size, scenario.dim))
        self.side = random.choice([-1.0, 1.0], size=(*self.size, 1))
        self.strength = np.where(
            random.random((*self.size, 1)) < 0.7, 1.0, random.random((*self.size, 1))
        )
        self.blind = random.uniform(-1.0, 1.0, (*self.size, max(scenario.action_size, 3)))

    def __call__(self, observations: NDArray[np.float32], teams: Moment) -> ArrayLike:
        """Choices (B, n, k)."""
        restless = self.kinds[3::4]
        anew = self.random.random(restless.shape) < 0.1
        restless[anew] = self.random.integers(len(KINDS), size=int(anew.sum()))
        if self.by == "gains":
            rows = self.scenario.observation_layout.split(observations).neighbours
            weights = self.random.random(rows.shape[:-1])
            _lean(rows, self._desired(teams), self.kinds, weights)
            return weights
        return self._desired(teams) if self.scenario.model.bounded else self._controls(observations)

    def _desired(self, teams: Moment) -> Array:
        """What each robot wants, in its own frame, (B, n, d)."""
        wanted = self.random.normal(size=self.frozen.shape)
        now = teams.positions, teams.active, teams.weights, teams.frames
        kinds_of = self.kinds, self.frozen, self.side, self.strength
        _want(now, kinds_of, np.zeros((5, wanted.shape[-1])), wanted)
        return wanted

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
def _want(now: Any, kinds_of: Any, seen: Any, wanted: Any) -> None:
    """Write what robots want, by their kinds, in their own frames, over what they would want
    blindly.

    Args:
        now: places (B, n, d), who is there (B, n), weights (B, n, n), frames (B, n, d, d).
        kinds_of: kinds (B, n), fixed vectors (B, n, d), sides ±1 and lengths (B, n, 1).
        seen: working memory, (5, d).
        wanted: random vectors, (B, n, d).
    """
    kinds, frozen, side, strength = kinds_of
    for b in range(wanted.shape[0]):
        for i in range(wanted.shape[1]):
            kind, aim = kinds[b, i], wanted[b, i]
            for k in range(len(aim) if kind == 6 or kind == 8 else 0):
                aim[k] = frozen[b, i, k] if kind == 6 else 0.0
            if kind < 6:
                _look_round(now, b, i, seen)
                if kind == 1:
                    set_across(seen[0], frozen[b, i], side[b, i, 0], aim)
                    _scale(aim, 1.0, aim)
                else:
                    ahead = seen[0 if kind == 0 else min(kind - 1, 3)]
                    _scale(ahead, 1.0 if kind == 2 or kind == 5 else -1.0, aim)
            for k in range(len(aim)):
                seen[4, k] = strength[b, i, 0] * aim[k]
            for k in range(len(aim)):
                aim[k] = 0.0
                for j in range(len(aim)):
                    aim[k] += now[3][b, i, j, k] * seen[4, j]


@kernel
def _lean(rows: Any, desired: Any, kinds: Any, weights: Any) -> None:
    """Write weights of rows: the one that is wanted most alone, of some robots all that are wanted
    or blindly; nothing for those that want to rest.

    Args:
        rows: of neighbours, (B, n, K, d) float32.
        desired: what robots want, (B, n, d).
        kinds: their kinds, (B, n).
        weights: random numbers in [0, 1), (B, n, K).
    """
    for b in range(weights.shape[0]):
        for i in range(weights.shape[1]):
            style, best, most = (i + b // 2) % 4, -1, -np.inf
            for k in range(weights.shape[2]):
                length, score = length_of(rows[b, i, k]), 0.0
                for axis in range(desired.shape[2]):
                    score += rows[b, i, k, axis] * desired[b, i, axis]
                score /= length if length > 0.0 else 1.0
                if length > 0.0 and score > most:
                    best, most = k, score
                if style == 2:
                    weights[b, i, k] = min(max(score, 0.0), 1.0)
            for k in range(weights.shape[2]):
                if style < 2:
                    weights[b, i, k] = 1.0 if k == best else 0.0
                if kinds[b, i] == 8:
                    weights[b, i, k] = 0.0


@inner_kernel
def _look_round(now: Any, b: int, i: int, seen: Any) -> None:
    """Write what f_i is, what leads away from all others, and where the farthest and the nearest of
    those lie that robot i is linked to, (4, d); zero where there is nobody.
    """
    places, active, weights, _ = now
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
def _scale(ahead: Any, length: float, aim: Any) -> None:
    """Write a vector (d,) of this length along one; zero stays zero."""
    along = length_of(ahead)
    by = length / along if along > _TINY else 0.0
    for k in range(len(aim)):
        aim[k] = ahead[k] * by
