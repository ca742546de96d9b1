"""Bearings that are wrong by a bounded angle, turned as an adversary likes."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rendezvous_env import Scenario
from rendezvous_env.compilation import kernel
from rendezvous_env.physics.vectors import (
    ORIGIN,
    combine,
    cross,
    load,
    perpendicular,
    scaled,
    split,
    store,
    subtract,
    without,
)

Array = NDArray[np.float64]

KINDS = ("against", "to one side", "anyhow", "to changing sides", "outward")
_SWITCHING = 7
"""Steps after which errors turn round."""
_AT_ONCE = 16
"""Steps for which random numbers are drawn at once."""
_ROUNDED = 1.0 - 1e-6
"""Share of an error that is still none too much after rounding to float32."""
_TINY = 1e-12
DOWN = (0.0, 0.0, -1.0)
"""v × DOWN is v turned by 90° in the plane."""


class Misled(gymnasium.vector.VectorWrapper):
    """A vector environment of teams whose neighbour rows are turned by an error.

    Away from f, to one side, anyhow, to changing sides, or away from the middle of what is seen:
    each robot has a kind of its own, and in half of the teams all have the same.

    Args:
        env: a vector environment.
        scenario: its own.
        error: η, rad.
        seed: team b draws from seed + b, so that it errs alone as it does among others.
    """

    def __init__(self, env: Any, scenario: Scenario, error: float, seed: int) -> None:
        super().__init__(env)
        n, slots = scenario.n_robots, scenario.observation_layout.neighbour_slots
        self._step, self._rows = 0, scenario.observation_layout.neighbours
        self._errors = np.full((env.num_envs, n, slots), error * _ROUNDED)
        self._randoms = [np.random.default_rng([seed + b, 3]) for b in range(env.num_envs)]
        kinds = [r.integers(len(KINDS), size=n if r.random() < 0.5 else 1) for r in self._randoms]
        self._kinds = np.array([np.resize(own, n) for own in kinds])
        self._axes = np.array([r.normal(size=(n, 3)) for r in self._randoms])
        if scenario.dim == 2:
            self._axes[:] = DOWN

    def reset(self, **asked: Any) -> tuple[Any, dict[str, Any]]:
        """As the environment."""
        observations, infos = self.env.reset(**asked)
        return self.turn(observations), infos

    def step(self, actions: Any) -> Any:
        """As the environment."""
        observations, *others = self.env.step(actions)
        return self.turn(observations), *others

    def turn(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Observations (B, n, rows, d) with turned rows."""
        seen, ahead = observations.copy(), self._step % _AT_ONCE
        rows = observations[..., self._rows, :].astype(np.float64)
        if ahead == 0:
            shape = _AT_ONCE, *rows.shape[1:]
            self._anyhow = np.array([random.normal(size=shape) for random in self._randoms])
        self._step += 1
        side = -1.0 if self._step // _SWITCHING % 2 else 1.0
        towards = self._anyhow[:, ahead]
        _aim(rows, (self._kinds, self._axes, side), towards)
        _turn(rows, towards, self._errors)
        seen[..., self._rows, :] = rows
        return seen


@kernel
def _aim(rows: Any, how: Any, towards: Any) -> None:
    """Write where the rows of robots are turned to, by their KINDS, over what is anyhow.

    Args:
        rows: (B, n, K, d).
        how: kinds (B, n), axes (B, n, 3), and ±1 for changing sides.
        towards: random vectors, (B, n, K, d).
    """
    kinds, axes, side = how
    for b in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            kind, axis, against, outward = kinds[b, i], load(axes[b, i]), ORIGIN, ORIGIN
            for row in rows[b, i]:
                against = subtract(against, load(row))
                outward = subtract(outward, split(load(row))[1])
            for k in range(rows.shape[2]):
                if kind == 1 or kind == 3:
                    aside = cross(load(rows[b, i, k]), axis)
                    store(scaled(aside, 1.0 if kind == 1 else side), towards[b, i, k])
                elif kind != 2:
                    store(against if kind == 0 else outward, towards[b, i, k])


def turned(bearings: Array, towards: Array, error: Array | float) -> Array:
    """Bearings (B, n, k, d) turned by an error, rad, of all, each team (B,) or each bearing (B, n,
    k, 1), towards directions of the same shape.

    One that already points there, or away, is turned across.
    """
    rows = np.array(bearings, dtype=np.float64)
    aims = np.broadcast_to(towards, rows.shape).astype(np.float64)
    angles = np.reshape(error, (*np.shape(error), *[1] * (4 - np.ndim(error))))[..., 0]
    _turn(rows, aims, np.broadcast_to(angles, rows.shape[:3]).astype(np.float64))
    return rows


@kernel
def _turn(rows: Any, towards: Any, errors: Any) -> None:
    """Turn rows (B, n, K, d) towards directions of that shape by errors (B, n, K), rad; lengths
    stay.
    """
    for b in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            for k in range(rows.shape[2]):
                length, ahead = split(load(rows[b, i, k]))
                size, aside = split(without(load(towards[b, i, k]), ahead))
                if size < 1e-9:
                    _, aside = split(perpendicular(ahead))
                along, beside = math.cos(errors[b, i, k]), math.sin(errors[b, i, k])
                store(combine(length * along, ahead, length * beside, aside), rows[b, i, k])


def across(ahead: Array, axis: Array) -> Array:
    """Vectors across others, (..., d): turned by 90° in the plane, ahead × axis in 3-D."""
    if ahead.shape[-1] == 2:
        return np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    return np.cross(ahead, axis)


def unit(vectors: Array) -> Array:
    """Unit vectors (..., d); zero stays zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > _TINY)
