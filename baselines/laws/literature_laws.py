"""Laws from the literature for robots that can move in any direction, from bearings alone."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import whole
from rendezvous_env.compilation import kernel
from rendezvous_env.limits import MOST_SECTORS
from rendezvous_env.scenario.observation_layout import ObservedRows
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.sensors.imperfections import in_sectors

from ..policy import in_the_plane, is_single_integrator, register
from .paper_laws import Array, Law, bearing_only_law

Rows = NDArray[Any]
"""Neighbour rows (..., K, d) of any length, zero where absent."""
Order = NDArray[np.int64]


def unit_mean_law(net_bearing: Array, *, speed: float) -> Array:
    """Velocities along the mean bearing at one speed, (..., d), of fᵢ, (..., d), and v, all in m/s.

        ṗᵢ = v fᵢ/‖fᵢ‖,   0 where fᵢ = 0

    The circular mean of the bearings, which rendezvous code calls the average bearing. By lemma 1
    (theory 3) V̇ = −2 v Σ‖fᵢ‖ ≤ −4 v a* on a fixed, connected, undirected graph, so all meet within
    V0⁺/(4 v a*) in continuous time.
    """
    f = net_bearing
    length = np.linalg.norm(f, axis=-1, keepdims=True)
    return speed * f / np.where(length > 0.0, length, 1.0)


def smallest_sector_law(bearings: Rows) -> Array:
    """Velocities (..., 2), at most 2 m/s, of rows (..., K, 2) of any length, zero where absent.

        ṗᵢ = g₊ + g₋ if the sector is narrower than π, else 0    (Bellaiche & Bruckstein, 2016)

    g₊ and g₋ bound the smallest sector with all neighbours in it, which is what the widest gap
    between neighbouring directions leaves, wherever angles are counted from. Half of ṗᵢ is the
    point of least norm of conv{gᵢⱼ} in the plane (guarantees 12).
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
    """Bearings (..., 2) turned into the middles of their sectors, see ``in_sectors``."""
    rows = np.ascontiguousarray(bearings, np.float64).reshape(-1, 2)
    rounded = np.empty_like(rows)
    _round_rows(rows, sectors, rounded)
    return rounded.reshape(bearings.shape)


@kernel
def _round_rows(rows, sectors, out):
    for i in range(rows.shape[0]):
        out[i, 0], out[i, 1] = in_sectors((rows[i, 0], rows[i, 1]), sectors)


def cyclic_pursuit_law(bearings: Rows, *, speed: float) -> Array:
    """Velocities straight at the next robot that is seen, (..., n, d), m/s; 0 if nobody is.

        ṗᵢ = v gᵢⱼ,   j the next in cyclic order that is seen     (Yu et al., 2012, corollary 20)

    Of rows (..., n, K, d) of any length in the order of ``rows_from_next``, and v, m/s.
    """
    return _pursuit_law(bearings, rows_from_next(*bearings.shape[-3:-1]), speed)


def nearest_pursuit_law(bearings: Rows, *, speed: float) -> Array:
    """Velocities straight at the robot nearest by index; as ``cyclic_pursuit_law`` otherwise.

        ṗᵢ = v gᵢⱼ,   j the one of least |i − j| that is seen            (theorem G, guarantees 10)

    Bearings do not tell who is nearest in 3-D. All meet within L0/(2vκ(n)) in continuous time on
    any graph, while everybody sees somebody.
    """
    return _pursuit_law(bearings, rows_from_nearest(*bearings.shape[-3:-1]), speed)


def _pursuit_law(bearings: Rows, order: Order, speed: float) -> Array:
    target = first_seen(np.any(bearings, axis=-1), order)
    return unit_mean_law(chosen_rows(bearings, target), speed=speed)


def rows_from_next(n_robots: int, rows: int) -> Order:
    """Rows, (n, K), of robots i + 1, i + 2, … (mod n); on sparse graphs as they stand."""
    robots, steps = np.arange(n_robots)[:, np.newaxis], np.arange(rows)
    return (robots + steps) % rows if rows == n_robots - 1 else 0 * robots + steps


def rows_from_nearest(n_robots: int, rows: int) -> Order:
    """Rows, (n, K), by |i − j|, the lower j of two first; on sparse graphs as they stand."""
    own, row = np.arange(n_robots)[:, np.newaxis], np.arange(rows)
    if rows != n_robots - 1:
        return 0 * own + row
    return np.argsort(np.abs(row + (row >= own) - own), axis=1, kind="stable")


def first_seen(seen: NDArray[np.bool_], order: Order) -> Order:
    """Index, (..., n), of the first row of an order, ([...,] n, K), that is seen, (..., n, K)."""
    order = np.broadcast_to(order, seen.shape)
    first = np.argmax(np.take_along_axis(seen, order, axis=-1), axis=-1)
    return np.take_along_axis(order, first[..., np.newaxis], axis=-1)[..., 0]


def chosen_rows(rows: Rows, target: Order) -> Array:
    """Of the rows (..., n, K, d) of each robot its target, (..., n): (..., n, d), float64."""
    chosen = target[..., np.newaxis, np.newaxis]
    return np.take_along_axis(rows, chosen, axis=-2)[..., 0, :].astype(np.float64)


@register("unit-mean", fits=is_single_integrator, kind="field")
class _UnitMean(Law):
    """Along the net bearing at the speed limit."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return unit_mean_law(f, speed=self.scenario.speed_limit)


@register("smallest-sector", fits=in_the_plane, kind="field")
class _SmallestSector(Law):
    """Between the two neighbours that bound the smallest sector with all of them in it."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return smallest_sector_law(seen.neighbours)


@register("quantised", fits=in_the_plane, kind="field")
@dataclass(frozen=True)
class _Quantised(Law):
    """Law (1) of bearings that are known by sector only."""

    sectors: int = 8

    def __post_init__(self) -> None:
        whole("sectors", self.sectors, 2, MOST_SECTORS)

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        rows = rounded_bearings(seen.neighbours, self.sectors)
        return self.slowed(bearing_only_law(rows.sum(axis=-2)), seen._replace(neighbours=rows))


def _tells_robots_apart(scenario: Scenario) -> bool:
    """Whether there is a row for each other robot, or one in all."""
    slots = scenario.observation_layout.neighbour_slots
    return is_single_integrator(scenario) and slots in (1, scenario.n_robots - 1)


@register("cyclic-pursuit", fits=_tells_robots_apart, kind="field")
class _CyclicPursuit(Law):
    """Straight at the next robot by row, at the speed limit."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return cyclic_pursuit_law(seen.neighbours, speed=self.scenario.speed_limit)


@register("nearest-pursuit", fits=_tells_robots_apart, kind="field")
class _NearestPursuit(Law):
    """Straight at the robot nearest by index, at the speed limit."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return nearest_pursuit_law(seen.neighbours, speed=self.scenario.speed_limit)
