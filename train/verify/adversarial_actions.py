"""Adversaries that know where all robots are, and choose what a policy is allowed to choose."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

import rendezvous_env as rv

from .adversarial_bearings import across, unit

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

    def __call__(self, observations: NDArray[np.float32], teams: rv.Simulator) -> ArrayLike:
        """Choices (B, n, k)."""
        redrawn = self.restless[:, None] & (self.random.random(self.size) < 0.1)
        self.kinds[redrawn] = self.random.integers(len(WISHES), size=int(redrawn.sum()))
        if self.by == "gains":
            return self._gains(observations, teams)
        if not self.scenario.model.bounded:
            return self._controls(observations)
        wishes = self._directions(teams) * self.strength
        return np.einsum("bnji,bnj->bni", teams.frames, wishes)

    def _directions(self, teams: rv.Simulator) -> Array:
        """What each robot wants, in the global frame, (B, n, d)."""
        places, active = teams.positions, teams.active
        offsets = places[:, None] - places[:, :, None]
        distances = np.linalg.norm(offsets, axis=-1)
        linked = (teams.weights > 0) & active[:, None] & active[:, :, None]
        bearings = offsets / np.maximum(distances, _TINY)[..., None]
        f = np.sum(teams.weights[..., None] * bearings * linked[..., None], axis=2)
        ahead = unit(f)
        there = active[..., None]
        centre = np.sum(places * there, axis=1, keepdims=True) / there.sum(axis=1, keepdims=True)
        farthest = np.where(linked, distances, -1.0).argmax(axis=-1)[..., None, None]
        nearest = np.where(linked, distances, np.inf).argmin(axis=-1)[..., None, None]
        far = np.take_along_axis(bearings, farthest, axis=2)[:, :, 0]
        near = np.take_along_axis(bearings, nearest, axis=2)[:, :, 0]
        outward = unit(places - centre)
        anew = self.random.normal(size=places.shape)
        options = (
            -ahead,
            unit(across(ahead, self.frozen)) * self.side,
            outward,
            -far,
            -near,
            near,
            self.frozen,
            anew,
            np.zeros_like(places),
        )
        return np.asarray(np.choose(self.kinds[..., None], options))

    def _gains(self, observations: NDArray[np.float32], teams: rv.Simulator) -> Array:
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
        side = f[..., 1:]
        square = np.sum(side**2, axis=-1, keepdims=True)
        abeam = -side * f[..., :1] / (scenario.tau * (square + _TINY))
        limits = np.minimum(3.0, scenario.action_bounds[1:])
        abeam = np.clip(abeam / limits, -1.0, 1.0) if len(limits) == side.shape[-1] else anew
        full = abeam
        if self.by != "heading":
            full = np.concatenate([-np.sign(f[..., :1]), abeam], axis=-1)[..., :size]
        chosen = np.choose(self.kinds[..., None] % 4, (full, held, anew, np.sign(held)))
        return np.asarray(chosen)
