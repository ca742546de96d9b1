"""Bearings that are wrong by a bounded angle, turned as an adversary likes."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rendezvous_env import Scenario

Array = NDArray[np.float64]

KINDS = ("against", "to one side", "anyhow", "to changing sides", "outward")
_SWITCHING = 7
"""Steps after which errors turn round."""
_ROUNDED = 1.0 - 1e-6
"""Share of an error that is still none too much after rounding to float32."""
_TINY = 1e-12


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
        self._rows, self._error = scenario.observation_layout.neighbours, error * _ROUNDED
        self._step, n = 0, scenario.n_robots
        self._randoms = [np.random.default_rng([seed + b, 3]) for b in range(env.num_envs)]
        kinds = [r.integers(len(KINDS), size=n if r.random() < 0.5 else 1) for r in self._randoms]
        self._kinds = np.array([np.resize(own, (n, 1, 1)) for own in kinds])
        self._axis = np.array([r.normal(size=(n, 1, 3)) for r in self._randoms])

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
        seen = observations.copy()
        rows = observations[..., self._rows, :].astype(np.float64)
        lengths = np.linalg.norm(rows, axis=-1, keepdims=True)
        self._step += 1
        bearings = unit(rows)
        seen[..., self._rows, :] = lengths * turned(bearings, self._towards(rows), self._error)
        return seen

    def _towards(self, rows: Array) -> Array:
        """Directions of the shape of the rows."""
        against = -np.broadcast_to(rows.sum(axis=-2, keepdims=True), rows.shape)
        side = across(unit(rows), np.broadcast_to(self._axis, (*rows.shape[:-1], 3)))
        outward = -np.broadcast_to(unit(rows).sum(axis=-2, keepdims=True), rows.shape)
        there = -1.0 if self._step // _SWITCHING % 2 else 1.0
        anyhow = np.array([random.normal(size=rows.shape[1:]) for random in self._randoms])
        return np.asarray(np.choose(self._kinds, (against, side, anyhow, there * side, outward)))


def turned(bearings: Array, towards: Array, error: Array | float) -> Array:
    """Bearings (B, n, k, d) turned by an error, rad, towards directions of the same shape.

    One that already points there, or away, is turned across.
    """
    aside = towards - np.sum(towards * bearings, axis=-1, keepdims=True) * bearings
    beside = np.roll(bearings, 1, axis=-1) * np.array([-1.0, 1.0, 0.5])[: bearings.shape[-1]]
    beside = beside - np.sum(beside * bearings, axis=-1, keepdims=True) * bearings
    aligned = np.sum(aside**2, axis=-1, keepdims=True) < 1e-18
    side = unit(np.where(aligned, beside, aside))
    angle = np.asarray(error)
    if angle.ndim:
        angle = angle.reshape(*angle.shape, *[1] * (4 - angle.ndim))
    return np.asarray(np.cos(angle) * bearings + np.sin(angle) * side)


def across(ahead: Array, axis: Array) -> Array:
    """Vectors across others, (..., d): turned by 90° in the plane, ahead × axis in 3-D."""
    if ahead.shape[-1] == 2:
        return np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    return np.cross(ahead, axis)


def unit(vectors: Array) -> Array:
    """Unit vectors (..., d); zero stays zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > _TINY)
