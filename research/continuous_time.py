"""Teams of points that move as they are told: an integrator of its own, which shares no code with
the environment.

Velocities are held for as long as is asked, or until two robots dock, whichever is first: then
the robots of that team are asked anew. So nothing is passed over, and what is proven for inputs
held over a step, or for bearings of some age, is tried exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.physics.hull_perimeter import size
from train.verify.monitors import directions, unit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ROUNDING = 1e-9
"""Of shares of a length, of which rounding takes far less."""


class Sights(NamedTuple):
    """What robots could see of one another; index order [team, observer, neighbour]."""

    bearings: Array
    """g_ij, (B, n, n, d); zero where there is nobody."""
    distances: Array
    """(B, n, n), m; infinite where there is nobody."""
    present: Mask
    """(B, n, n), whether both are there and are two."""


class Teams:
    """B teams of n points, each with a clock of its own.

    Args:
        positions: (B, n, d), m.
        merge_radius: r, m.
        weights: a_ij, (B, n, n), m/s: who can dock with whom, all pairs without it. The survivor
            of a merge, the lower index, stands at the midpoint and has the larger weights of both.
    """

    def __init__(self, positions: Array, merge_radius: float, weights: Array | None = None) -> None:
        self.positions, self.merge_radius = np.array(positions, dtype=np.float64), merge_radius
        count, n, self.dim = positions.shape
        self.weights = np.ones((count, n, n)) if weights is None else np.array(weights)
        self.weights[:, np.arange(n), np.arange(n)] = 0.0
        self.active = np.ones((count, n), dtype=np.bool_)
        self.into = np.tile(np.arange(n), (count, 1))
        """Whom each robot is part of, (B, n)."""
        self.time = np.zeros(count)
        self.merged = np.zeros((count, n), dtype=np.bool_)
        """Who has taken someone in at the end of the last advance."""
        self._pairs = np.triu_indices(n, 1)

    @property
    def left(self) -> NDArray[np.int64]:
        """Robots that each team still has, (B,)."""
        return np.asarray(self.active.sum(axis=-1))

    def look(self) -> Sights:
        """All bearings and distances."""
        offsets = self.positions[:, None] - self.positions[:, :, None]
        present = self.active[:, None] & self.active[:, :, None]
        present &= ~np.eye(self.active.shape[1], dtype=np.bool_)
        distances = np.sqrt(np.sum(offsets**2, axis=-1))
        distances[~present] = np.inf
        return Sights(offsets / distances[..., None], distances, present)

    def size(self) -> Array:
        """L, (B,), m."""
        pairs = zip(self.positions, self.active, strict=True)
        return np.array([size(places[there]) for places, there in pairs])

    def lyapunov(self) -> Array:
        """V of the weights, (B,), m²/s."""
        i, j = self._pairs
        distances = np.linalg.norm(self.positions[:, j] - self.positions[:, i], axis=-1)
        both = self.weights[:, i, j] + self.weights[:, j, i]
        return np.asarray(np.sum(both * distances, axis=-1))

    def advance(self, velocities: Array, durations: Array) -> None:
        """Move on straight lines until two robots of a team dock, or its time is up.

        Args:
            velocities: (B, n, d), m/s.
            durations: (B,), s; 0 leaves a team alone.
        """
        i, j = self._pairs
        offsets = self.positions[:, j] - self.positions[:, i]
        closing = velocities[:, j] - velocities[:, i]
        gap = np.sum(offsets**2, axis=-1) - self.merge_radius**2
        along = np.sum(offsets * closing, axis=-1)
        under = along**2 - np.sum(closing**2, axis=-1) * gap
        docks = self.active[:, i] & self.active[:, j]
        docks &= (self.weights[:, i, j] > 0) | (self.weights[:, j, i] > 0)
        when = np.full(gap.shape, np.inf)
        meets = docks & (gap > 0) & (along < 0) & (under >= 0)
        when[meets] = gap[meets] / (np.sqrt(under[meets]) - along[meets])
        when[docks & (gap <= 0)] = 0.0
        soonest = when.min(axis=-1)
        moved = np.minimum(durations, soonest)
        self.positions += moved[:, None, None] * velocities
        self.time += moved
        self.merged[...] = False
        for team in np.flatnonzero((soonest <= durations) & (durations > 0)):
            pair = int(np.argmin(when[team]))
            self._merge(int(team), int(i[pair]), int(j[pair]))

    def _merge(self, team: int, i: int, j: int) -> None:
        """Make one robot of i < j, then of all that stand within r of one another."""
        places, weights = self.positions[team], self.weights[team]
        places[i] = (places[i] + places[j]) / 2.0
        weights[i] = np.maximum(weights[i], weights[j])
        weights[:, i] = np.maximum(weights[:, i], weights[:, j])
        weights[i, i] = weights[j] = weights[:, j] = 0.0
        self.into[team][self.into[team] == j] = i
        self.active[team, j] = self.merged[team, j] = False
        self.merged[team, i] = True
        first, second = self._pairs
        docks = self.active[team, first] & self.active[team, second]
        docks &= (weights[first, second] > 0) | (weights[second, first] > 0)
        distance = np.linalg.norm(places[second] - places[first], axis=-1)
        distance[~docks] = np.inf
        nearest = int(np.argmin(distance))
        if distance[nearest] <= self.merge_radius:
            self._merge(team, int(first[nearest]), int(second[nearest]))


Law = Callable[[Teams], Array]
"""Teams → velocities (B, n, d), m/s."""
Look = Callable[[Teams], Array]
"""Teams, after every advance → by what share each keeps a promise, (B,); negative: broken."""


@dataclass
class Trial:
    """Teams, how they move, and what is claimed of them."""

    teams: Teams
    law: Law
    step: Array | float
    """For how long velocities are held, at most, (B,) or the same for all, s."""
    limit: Array
    """Time by which they have met, (B,), s."""
    look: Look | None = None
    """What is promised beside it."""


def integrate(trial: Trial) -> tuple[Array, Array]:
    """Run the teams of a trial until they have met, are out of time, or have broken what is
    promised beside it.

    Returns:
        Times of the rendezvous (B,), s, infinite without; and the least that ``look`` found (B,).
    """
    teams, limit = trial.teams, trial.limit
    times, kept = np.full(limit.shape, np.inf), np.full(limit.shape, np.inf)
    while True:
        running = (teams.left > 1) & (teams.time < limit) & (kept >= -ROUNDING)
        if not running.any():
            return times, kept
        velocities = trial.law(teams)
        velocities[~teams.active | ~running[:, None]] = 0.0
        teams.advance(velocities, np.where(running, trial.step, 0.0))
        met = running & (teams.left == 1)
        times[met] = teams.time[met]
        if trial.look is not None:
            kept[running] = np.minimum(kept, trial.look(teams))[running]


def outward(teams: Teams, sights: Sights) -> Array:
    """Unit vectors (B, n, d) along ∂L/∂p_i, exact in the plane and nearly so in 3-D; away from
    the centroid for robots inside the hull.
    """
    there = teams.active[..., None]
    centroid = np.sum(teams.positions * there, axis=1, keepdims=True) / teams.left[:, None, None]
    inside = unit(teams.positions - centroid)
    if teams.dim == 2:
        middle, width = _widest_gap(sights)
        found = np.stack([np.cos(middle), np.sin(middle)], axis=-1)
        vertex = width > np.pi * (1.0 + 1e-9)
    else:
        along = directions(3, 64)
        reach = np.where(there, teams.positions @ along.T, -np.inf)
        farthest = reach == reach.max(axis=1, keepdims=True)
        found = unit(farthest @ along)
        vertex = farthest.any(axis=-1)
    return np.where(vertex[..., None], found, inside)


def _widest_gap(sights: Sights) -> tuple[Array, Array]:
    """The middle and the width of the widest angle in which a robot sees nobody, (B, n) each, rad.

    Only of a corner of the hull it is wider than π; then its middle points along ∂L/∂p_i.
    """
    angles = np.arctan2(sights.bearings[..., 1], sights.bearings[..., 0])
    # who is not there stands where another one does
    alone = ~sights.present.any(axis=-1)
    someone = np.max(angles, axis=-1, keepdims=True, initial=-np.pi, where=sights.present)
    ordered = np.sort(np.where(sights.present, angles, someone), axis=-1)
    following = np.concatenate([ordered[..., 1:], ordered[..., :1] + 2 * np.pi], axis=-1)
    gaps = following - ordered
    widest = np.argmax(gaps, axis=-1)[..., None]
    width = np.take_along_axis(gaps, widest, axis=-1)[..., 0]
    start = np.take_along_axis(ordered, widest, axis=-1)[..., 0]
    return start + width / 2.0, np.where(alone, 0.0, width)
