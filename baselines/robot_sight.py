"""What one robot measured, in any order, as the rows of an observation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.experiment.checks import floats, refuse
from rendezvous_env.experiment.observation_layout import ObservationLayout

_ROUNDING = 1e-3
"""So far from 1 may the length of a unit vector be: directions come rounded, too."""
_AWAY = 1.0
"""By how much both edges of an obstacle together turn between ticks, rad, before it is taken for
another one."""
_OPPOSITE = 1e-6
"""Edges are opposite below this sine of the angle between them."""


class RobotSight:
    """Orders what a robot measures in the plane, and knows obstacles again from tick to tick.

    Neighbours need no names: policies add up their rows or pool them. Obstacles keep their slots,
    because how fast an edge turns is a measurement, too: what is seen now is matched to what was
    seen at the last tick so that all edges together turn least.

    Args:
        layout: of the observation, in the plane.
        max_degree: D̄, the most that all gains may come to, m/s: time steps are made for it.
    """

    def __init__(self, layout: ObservationLayout, max_degree: float) -> None:
        self._layout, self._max_degree = layout, max_degree
        self._edges = np.zeros((layout.obstacle_slots, 2, 2))
        self._unseen = np.zeros(layout.obstacle_slots)
        self.forget()

    def forget(self) -> None:
        """Forget which obstacle stood in which slot."""
        self._unseen[:] = np.inf

    def rows(
        self, bearings: ArrayLike, obstacles: ArrayLike, weights: ArrayLike | None
    ) -> NDArray[np.float32]:
        """The observation of the robot.

        Args:
            bearings: g_ij, (k, 2), unit vectors in the robot's frame; k at most K.
            obstacles: both edges of each obstacle, (m, 2, 2), unit vectors; m at most M. A
                silhouette is narrower than π, which tells the counter-clockwise edge; of two
                opposite edges that is the first.
            weights: a_ij, (k,), m/s, positive; None is 1 for all.

        Returns:
            (rows, 2).

        Raises:
            ValueError: naming the argument, its value and what would be right; nothing has changed
                then.
        """
        layout = self._layout
        seen = _unit_vectors("bearings", bearings, (2,), layout.neighbour_slots, "neighbours")
        edges = _unit_vectors("obstacles", obstacles, (2, 2), layout.obstacle_slots, "obstacles")
        gains = _gains(weights, len(seen), self._max_degree)
        rows = np.zeros(layout.shape, dtype=np.float32)
        rows[: len(seen)] = gains[:, np.newaxis] * seen
        silhouettes = rows[layout.obstacles].reshape(-1, 2, 2)
        ordered = _counter_clockwise_first(edges)
        slots = self._slots_of(ordered)
        silhouettes[slots] = ordered
        self._unseen += 1.0
        self._unseen[slots] = 0.0
        self._edges[slots] = ordered
        return rows

    def _slots_of(self, edges: NDArray[np.float64]) -> NDArray[np.int64]:
        """A slot for each obstacle (m, 2, 2), the same as at the last tick for those seen then."""
        if not len(edges):
            return np.zeros(0, dtype=np.int64)
        from scipy.optimize import linear_sum_assignment  # takes long to import

        along = np.einsum("mid,sid->msi", edges, self._edges)
        turned = np.arccos(np.clip(along, -1.0, 1.0)).sum(axis=-1)
        vacant = _AWAY + 1e-3 / (1.0 + self._unseen)  # the longer, the sooner taken
        cost = np.where(self._unseen == 0.0, turned, vacant)
        return np.asarray(linear_sum_assignment(cost)[1])


def _unit_vectors(
    name: str, value: ArrayLike, shape: tuple[int, ...], most: int, what: str
) -> NDArray[np.float64]:
    """Some (k, *shape) unit vectors, k ≤ most."""
    vectors = floats(name, value)
    if vectors.size == 0:
        return np.zeros((0, *shape))
    if vectors.shape[1:] != shape:
        axes = ", ".join(map(str, shape))
        raise ValueError(f"{name} have shape {vectors.shape}; they must be (…, {axes})")
    if len(vectors) > most:
        raise ValueError(
            f"{name} are of {len(vectors)} {what}; this scenario has room for {most}: see its "
            f"{'neighbour_slots' if name == 'bearings' else 'obstacle_slots'}"
        )
    lengths = np.linalg.norm(vectors, axis=-1)
    wrong = ~(np.abs(lengths - 1.0) <= _ROUNDING)  # true of NaN, too
    for index in np.argwhere(wrong):
        place = tuple(index.tolist())
        refuse(f"{name}{list(place)}", vectors[place].tolist(), "a unit vector")
    return vectors


def _gains(weights: ArrayLike | None, count: int, most: float) -> NDArray[np.float64]:
    """Weights (count,), m/s, that come to no more than ``most``."""
    gains = np.ones(count) if weights is None else floats("weights", weights)
    if gains.shape != (count,):
        raise ValueError(
            f"weights have shape {gains.shape}; they must be ({count},), one for each bearing"
        )
    for index in np.flatnonzero(~((gains > 0.0) & np.isfinite(gains))):
        refuse(f"weights[{index}]", float(gains[index]), "positive and finite (m/s)")
    if (total := float(gains.sum())) > (1.0 + _ROUNDING) * most:
        raise ValueError(
            f"weights sum to {total:g} m/s; this scenario's come to D̄ = {most:g} m/s at most. "
            "Where they are not 1, give them"
        )
    return gains


def _counter_clockwise_first(edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pairs of edges (m, 2, 2), the counter-clockwise one first."""
    first, second = edges[:, 0], edges[:, 1]
    across = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.where(across[:, np.newaxis, np.newaxis] > _OPPOSITE, edges[:, ::-1], edges)
