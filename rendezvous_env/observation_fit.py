"""Observations of a fixed size: added rows, or the nearest neighbours and obstacles.

The engine writes a row for every neighbour and obstacle. Robots measure bearings only; with too few
rows, the simulator selects them by distance.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .engine.stages.sense_obstacles import keep_nearest
from .obstacles.obstacle_set import ObstacleSet
from .scenario.observation_layout import ObservationLayout
from .scenario.scenario import Scenario

Float32 = NDArray[np.float32]
Array = NDArray[np.float64]


class ObservationFit:
    """Converts observations of ``Scenario.with_all_rows`` to a scenario's own layout."""

    def __init__(self, scenario: Scenario) -> None:
        self.full: ObservationLayout = scenario.with_all_rows.observation_layout
        self.own = scenario.observation_layout
        n = scenario.n_robots
        others = np.arange(n - 1) + (np.arange(n - 1) >= np.arange(n)[:, None])
        self._others: NDArray[np.int64] = others
        """Robot of each neighbour row, (n, n − 1)."""

    def __call__(self, observations: Float32, positions: Array, obstacles: ObstacleSet) -> Float32:
        """Convert observations with all rows to the own layout, (B, n, rows, d).

        Args:
            observations: (B, n, rows, d).
            positions: positions of the robots, (B, n, d), m.
            obstacles: set of obstacles, with a leading axis B.
        """
        own, full = self.own, self.full
        fitted = np.zeros((*observations.shape[:2], *own.shape), np.float32)
        seen = observations[..., full.neighbours, :]
        kept = fitted[..., own.neighbours, :]
        if seen.shape[2] <= kept.shape[2]:
            kept[:, :, : seen.shape[2]] = seen
        else:
            kept[...] = _nearest(seen, self._distances(positions), kept.shape[2])
        self._fit_obstacles(observations, positions, obstacles, fitted)
        fitted[..., own.obstacles.stop :, :] = observations[..., full.obstacles.stop :, :]
        return fitted

    def _fit_obstacles(
        self, observations: Float32, positions: Array, obstacles: ObstacleSet, fitted: Float32
    ) -> None:
        own, full = self.own, self.full
        seen, kept = observations[..., full.obstacles, :], fitted[..., own.obstacles, :]
        if seen.shape[2] <= kept.shape[2]:
            kept[:, :, : seen.shape[2]] = seen
        elif own.obstacle_slots:
            rows = full.obstacles.start, own.obstacles.start
            memory = np.empty(own.obstacle_slots, np.int64), np.empty(own.obstacle_slots)
            seen = np.ascontiguousarray(observations)
            keep_nearest(obstacles, positions, seen, *rows, fitted, *memory)

    def _distances(self, positions: Array) -> Array:
        """Distance of every robot to the robots of its rows, (B, n, n − 1), m."""
        offsets = positions[:, self._others] - positions[:, :, None]
        return np.asarray(np.linalg.norm(offsets, axis=-1))


def _nearest(rows: Float32, distances: Array, count: int) -> NDArray[Any]:
    """Nearest ``count`` nonzero rows of (B, n, N, …), in their order."""
    there = rows.any(axis=-1)
    distances = np.where(there, distances, np.inf)
    order = np.argsort(distances, axis=-1, kind="stable")[..., :count]
    # present rows first, in their order
    absent = np.isinf(np.take_along_axis(distances, order, axis=-1))
    order = np.sort(order + absent * rows.shape[2], axis=-1) % rows.shape[2]
    return np.take_along_axis(rows, order[..., None], axis=2)
