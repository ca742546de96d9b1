"""Continuous-time integrator for single integrators, independent of the environment's code.

Velocities are held for a given duration, or until the first merge of the team, after which they are
computed anew. No merge is skipped, so claims for held inputs and delayed bearings are tested
exactly.
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
"""Tolerance, as a fraction of a length; actual rounding is far smaller."""


class Bearings(NamedTuple):
    """Bearings and distances between robots; index order [team, observer, neighbour]."""

    bearings: Array
    """g_ij, (B, n, n, d); zero for absent pairs."""
    distances: Array
    """Distances, (B, n, n), m; infinite for absent pairs."""
    present: Mask
    """Whether both robots are active and distinct, (B, n, n)."""


class Batch:
    """B teams of n single integrators with separate clocks.

    Args:
        positions: (B, n, d), m.
        merge_radius: r, m.
        weights: a_ij, (B, n, n), m/s; linked pairs can merge, by default all pairs. The surviving
            robot of a merge has the lower index, is placed at the midpoint and takes the larger
            weights of both.
    """

    def __init__(self, positions: Array, merge_radius: float, weights: Array | None = None) -> None:
        self.positions, self.merge_radius = np.array(positions, dtype=np.float64), merge_radius
        count, n, self.dim = positions.shape
        self.weights = np.ones((count, n, n)) if weights is None else np.array(weights)
        self.weights[:, np.arange(n), np.arange(n)] = 0.0
        self.active = np.ones((count, n), dtype=np.bool_)
        self.into = np.tile(np.arange(n), (count, 1))
        """Index of the robot into which each robot has merged, (B, n)."""
        self.time = np.zeros(count)
        self.merged = np.zeros((count, n), dtype=np.bool_)
        """Robots that absorbed another one at the end of the last advance."""
        self._pairs = np.triu_indices(n, 1)

    @property
    def left(self) -> NDArray[np.int64]:
        """Number of active robots of each team, (B,)."""
        return np.asarray(self.active.sum(axis=-1))

    def look(self) -> Bearings:
        """All bearings and distances."""
        offsets = self.positions[:, None] - self.positions[:, :, None]
        present = self.active[:, None] & self.active[:, :, None]
        present &= ~np.eye(self.active.shape[1], dtype=np.bool_)
        distances = np.sqrt(np.sum(offsets**2, axis=-1))
        distances[~present] = np.inf
        return Bearings(offsets / distances[..., None], distances, present)

    def size(self) -> Array:
        """Hull perimeter L, (B,), m."""
        pairs = zip(self.positions, self.active, strict=True)
        return np.array([size(places[there]) for places, there in pairs])

    def lyapunov(self) -> Array:
        """V for the weights, (B,), m²/s."""
        i, j = self._pairs
        distances = np.linalg.norm(self.positions[:, j] - self.positions[:, i], axis=-1)
        both = self.weights[:, i, j] + self.weights[:, j, i]
        return np.asarray(np.sum(both * distances, axis=-1))

    def advance(self, velocities: Array, durations: Array) -> None:
        """Move on straight lines until two robots of a team merge, or the duration has elapsed.

        Args:
            velocities: (B, n, d), m/s.
            durations: (B,), s; 0 leaves a team unchanged.
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
        """Merge robots i < j, then all robots within r of one another."""
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


Law = Callable[[Batch], Array]
"""Batch → velocities (B, n, d), m/s."""
Look = Callable[[Batch], Array]
"""Batch → relative margin by which each fulfils a claim after an advance, (B,); negative if
violated."""


@dataclass
class ContinuousTrial:
    """Environments, their law, and the claims to check."""

    teams: Batch
    law: Law
    step: Array | float
    """Maximum duration for which velocities are held, (B,) or common to all, s."""
    limit: Array
    """Claimed rendezvous time, (B,), s."""
    look: Look | None = None
    """Check of a further claim."""


def integrate(trial: ContinuousTrial) -> tuple[Array, Array]:
    """Run a trial until rendezvous, time-out or violation of its further claim.

    Returns:
        Rendezvous times (B,), s, infinite without one; and the minimum of ``look``, (B,).
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


def outward(teams: Batch, sights: Bearings) -> Array:
    """Unit vectors (B, n, d) along ∂L/∂p_i, exact in the plane and nearly so in 3-D.

    For robots inside the hull they point away from the centroid.
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


def _widest_gap(sights: Bearings) -> tuple[Array, Array]:
    """Middle and width of the widest angle without a neighbour, (B, n) each, rad.

    It is wider than π only at a corner of the hull, where its middle points along ∂L/∂p_i.
    """
    angles = np.arctan2(sights.bearings[..., 1], sights.bearings[..., 0])
    # inactive robots share a position with an active one
    alone = ~sights.present.any(axis=-1)
    someone = np.max(angles, axis=-1, keepdims=True, initial=-np.pi, where=sights.present)
    ordered = np.sort(np.where(sights.present, angles, someone), axis=-1)
    following = np.concatenate([ordered[..., 1:], ordered[..., :1] + 2 * np.pi], axis=-1)
    gaps = following - ordered
    widest = np.argmax(gaps, axis=-1)[..., None]
    width = np.take_along_axis(gaps, widest, axis=-1)[..., 0]
    start = np.take_along_axis(ordered, widest, axis=-1)[..., 0]
    return start + width / 2.0, np.where(alone, 0.0, width)
