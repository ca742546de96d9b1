"""Pursuit by robots with a turn limit (guarantees 13, E2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.laws import pitch_of
from rendezvous_env import Scenario
from rendezvous_env.trajectory import Policy

from .cases import Case
from .claim import Array


def pursuit(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Pursuers at the scenario's speed limit."""
    return Pursuit(case.scenario, num_envs, random)


class Pursuit:
    """Pursue one robot that is seen until it is gone: turn towards it at ω_max, drive only while
    pointing at it, to within what is turned in a step.

    Args:
        scenario: of unicycles or 3-D robots with a row for each other robot; its speed limit is c,
            its turn limit ω_max.
        num_envs: B.
        random: draws whom each robot would rather pursue.
    """

    def __init__(self, scenario: Scenario, num_envs: int, random: np.random.Generator) -> None:
        self.scenario = scenario
        rows = scenario.n_robots - 1
        self._liking = random.random((num_envs, scenario.n_robots, rows))
        self._target = np.full((num_envs, scenario.n_robots), -1)

    def __call__(self, observations: NDArray[np.float32], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (B, n, a): v, and ω or (ω_α, ω_β)."""
        rows = self.scenario.observation_layout.split(observations)
        seen = np.any(rows.neighbours, axis=-1)
        self._choose(seen)
        chosen = self._target[..., None, None]
        bearing = np.take_along_axis(rows.neighbours, chosen, axis=2)[..., 0, :].astype(np.float64)
        if rows.gravity is None:
            turns = np.arctan2(bearing[..., 1:], bearing[..., :1])
        else:
            turns = _yaw_and_pitch(bearing, pitch_of(rows.gravity))
        tau, fastest = self.scenario.tau, self.scenario.turn_limit
        rates = turns / tau
        limits = self.scenario.action_bounds[1:]
        off_course = np.arctan2(np.linalg.norm(bearing[..., 1:], axis=-1), bearing[..., 0])
        aligned = (off_course <= fastest * tau) & seen.any(axis=-1)
        speed = np.where(aligned, self.scenario.speed_limit, 0.0)
        return np.concatenate(
            [speed[..., None], np.clip(rates, -limits, limits)], axis=-1, dtype=np.float32
        )

    def _choose(self, seen: NDArray[np.bool_]) -> None:
        """Keep a target that is still seen, else take the one that is liked best."""
        kept = np.take_along_axis(seen, np.maximum(self._target, 0)[..., None], axis=-1)[..., 0]
        best = np.argmax(np.where(seen, self._liking, -1.0), axis=-1)
        self._target = np.where(kept & (self._target >= 0), self._target, best)


def _yaw_and_pitch(bearing: Array, pitch: Array) -> Array:
    """Turns (..., 2), rad, in yaw and in pitch that point the body at a bearing of its frame."""
    forward, left, up = np.moveaxis(bearing, -1, 0)
    level = np.cos(pitch) * forward - np.sin(pitch) * up
    height = np.sin(pitch) * forward + np.cos(pitch) * up
    yaw = np.arctan2(left, level)
    return np.stack([yaw, np.arctan2(height, np.hypot(level, left)) - pitch], axis=-1)
