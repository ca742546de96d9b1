"""Bearing-only laws from the literature for holonomic robots."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import check_int
from rendezvous_env.compilation import kernel
from rendezvous_env.limits import MAX_SECTORS
from rendezvous_env.scenario.observation_layout import ObservedRows
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.sensors.imperfections import in_sectors

from ..policy import in_the_plane, is_single_integrator, register
from .paper_laws import Array, Law, bearing_only_law

Rows = NDArray[Any]
"""Neighbour rows (..., K, d) of any length, zero where absent."""
Order = NDArray[np.int64]


def unit_mean_law(net_bearing: Array, *, speed: float) -> Array:
    """Velocities along the mean bearing at constant speed, (..., d), for fᵢ, (..., d), and v, m/s.

        ṗᵢ = v fᵢ/‖fᵢ‖,   0 where fᵢ = 0

    By lemma 1 (theory 3), V̇ = −2 v Σ‖fᵢ‖ ≤ −4 v a* on a fixed, connected, undirected graph, so
    rendezvous takes at most V0⁺/(4 v a*) in continuous time.
    """
    f = net_bearing
    length = np.linalg.norm(f, axis=-1, keepdims=True)
    return speed * f / np.where(length > 0.0, length, 1.0)


def smallest_sector_law(bearings: Rows) -> Array:
    """Velocities (..., 2), at most 2 m/s, of rows (..., K, 2) of any length, zero where absent.

        ṗᵢ = g₊ + g₋ if the sector is narrower than π, else 0    (Bellaiche & Bruckstein, 2016)

    g₊ and g₋ bound the smallest sector that contains all neighbours, the complement of the widest
    gap between adjacent bearings. Half of ṗᵢ is the point of least norm of conv{gᵢⱼ} in the plane
    (guarantees 12).
    """
    seen = np.any(bearings, axis=-1)
    angles = np.arctan2(bearings[..., 1], bearings[..., 0], dtype=np.float64)
    angles = np.sort(np.where(seen, angles, np.inf), axis=-1)
    once_round = angles[..., :1] + 2.0 * np.pi
    following = np.minimum(np.concatenate([angles[..., 1:], once_round], axis=-1), once_round)
    gaps = np.full(angles.shape, -1.0)
    np.subtract(following, angles, out=gaps, where=np.isfinite(angles))
    widest = np.argmax(gaps, axis=-1)[..., np.newaxis]
    gap, before, after = (np.take_along_axis(a, widest, -1) for a in (gaps, angles, following))
    before, after = (np.where(gap > np.pi, angle, 0.0) for angle in (before, after))
    both = [np.cos(before) + np.cos(after), np.sin(before) + np.sin(after)]
    velocity: Array = np.where(gap > np.pi, np.concatenate(both, axis=-1), 0.0)
    return velocity


def rounded_bearings(bearings: Rows, sectors: int) -> Array:
    """Bearings (..., 2) rotated to the centres of their sectors, see ``in_sectors``."""
    rows = np.ascontiguousarray(bearings, np.float64).reshape(-1, 2)
    rounded = np.empty_like(rows)
    _round_rows(rows, sectors, rounded)
    return rounded.reshape(bearings.shape)


@kernel
def _round_rows(rows, sectors, out):
    for i in range(rows.shape[0]):
        out[i, 0], out[i, 1] = in_sectors((rows[i, 0], rows[i, 1]), sectors)


def cyclic_pursuit_law(bearings: Rows, *, speed: float) -> Array:
    """Velocities towards the next visible robot, (..., n, d), m/s; 0 without one.

        ṗᵢ = v gᵢⱼ,   j the next visible robot in cyclic order    (Yu et al., 2012, corollary 20)

    Rows are (..., n, K, d) of any length, in the order of ``rows_from_next``; v in m/s.
    """
    return _pursuit_law(bearings, rows_from_next(*bearings.shape[-3:-1]), speed)


def nearest_pursuit_law(bearings: Rows, *, speed: float) -> Array:
    """Velocities towards the visible robot with the nearest index; as ``cyclic_pursuit_law``.

        ṗᵢ = v gᵢⱼ,   j the visible robot with least |i − j|             (theorem G, guarantees 10)

    Bearings do not determine the nearest robot. Rendezvous takes at most L0/(2vκ(n)) in continuous
    time on any graph, while every robot has a visible neighbour.
    """
    return _pursuit_law(bearings, rows_from_nearest(*bearings.shape[-3:-1]), speed)


def _pursuit_law(bearings: Rows, order: Order, speed: float) -> Array:
    target = first_seen(np.any(bearings, axis=-1), order)
    return unit_mean_law(chosen_rows(bearings, target), speed=speed)


def rows_from_next(n_robots: int, rows: int) -> Order:
    """Row indices, (n, K), of robots i + 1, i + 2, … (mod n); unchanged on sparse graphs."""
    robots, steps = np.arange(n_robots)[:, np.newaxis], np.arange(rows)
    return (robots + steps) % rows if rows == n_robots - 1 else 0 * robots + steps


def rows_from_nearest(n_robots: int, rows: int) -> Order:
    """Row indices, (n, K), by |i − j|, lower j first; unchanged on sparse graphs."""
    own, row = np.arange(n_robots)[:, np.newaxis], np.arange(rows)
    if rows != n_robots - 1:
        return 0 * own + row
    return np.argsort(np.abs(row + (row >= own) - own), axis=1, kind="stable")


def first_seen(seen: NDArray[np.bool_], order: Order) -> Order:
    """Index, (..., n), of the first visible row (mask (..., n, K)) in an order ([...,] n, K)."""
    order = np.broadcast_to(order, seen.shape)
    first = np.argmax(np.take_along_axis(seen, order, axis=-1), axis=-1)
    return np.take_along_axis(order, first[..., np.newaxis], axis=-1)[..., 0]


def chosen_rows(rows: Rows, target: Order) -> Array:
    """Target rows (..., n, d), float64, of rows (..., n, K, d) by index (..., n)."""
    chosen = target[..., np.newaxis, np.newaxis]
    return np.take_along_axis(rows, chosen, axis=-2)[..., 0, :].astype(np.float64)


@register("unit-mean", fits=is_single_integrator, kind="field")
class _UnitMean(Law):
    """Along the net bearing at the speed limit."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return unit_mean_law(f, speed=self.scenario.speed_limit)


@register("smallest-sector", fits=in_the_plane, kind="field")
class _SmallestSector(Law):
    """Along the sum of the two bearings that bound the smallest sector of all neighbours."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return smallest_sector_law(seen.neighbours)


@register("quantised", fits=in_the_plane, kind="field")
@dataclass(frozen=True)
class _Quantised(Law):
    """Law (1) with bearings quantised to sectors."""

    sectors: int = 8

    def __post_init__(self) -> None:
        check_int("sectors", self.sectors, 2, MAX_SECTORS)

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        rows = rounded_bearings(seen.neighbours, self.sectors)
        return self.slowed(bearing_only_law(rows.sum(axis=-2)), seen._replace(neighbours=rows))


def _tells_robots_apart(scenario: Scenario) -> bool:
    """True if there is a row for each other robot, or a single row."""
    slots = scenario.observation_layout.neighbour_slots
    return is_single_integrator(scenario) and slots in (1, scenario.n_robots - 1)


@register("cyclic-pursuit", fits=_tells_robots_apart, kind="field")
class _CyclicPursuit(Law):
    """Towards the next visible robot in cyclic order, at the speed limit."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return cyclic_pursuit_law(seen.neighbours, speed=self.scenario.speed_limit)


@register("nearest-pursuit", fits=_tells_robots_apart, kind="field")
class _NearestPursuit(Law):
    """Towards the visible robot with the nearest index, at the speed limit."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return nearest_pursuit_law(seen.neighbours, speed=self.scenario.speed_limit)
