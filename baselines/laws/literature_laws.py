"""Laws from the literature for robots that can move in any direction, from bearings alone."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import whole
from rendezvous_env.compilation import kernel
from rendezvous_env.limits import MOST_SECTORS
from rendezvous_env.safety.heading import step_scale
from rendezvous_env.scenario.observation_layout import ObservedRows
from rendezvous_env.sensors.sensor_equations import in_sectors

from ..policy import Policy, in_the_plane, is_single_integrator, register
from .neighbour_order import (
    chosen_rows,
    first_seen,
    rows_from_nearest,
    rows_from_next,
    rows_have_an_order,
)
from .paper_laws import Array, LawPolicy, bearing_only_law

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario


def unit_mean_law(net_bearing: Array, *, speed: float) -> Array:
    """Velocity along the mean bearing at one speed, however long that is.

        ṗᵢ = v fᵢ/‖fᵢ‖,   0 where fᵢ = 0

    The circular mean of the bearings, which rendezvous code calls the average bearing. By lemma 1
    (theory 3) V̇ = −2 v Σ‖fᵢ‖ ≤ −4 v a*, so all meet within V0⁺/(4 v a*) in continuous time.

    Args:
        net_bearing: fᵢ, (..., d), m/s.
        speed: v, m/s.

    Returns:
        Velocities, (..., d), m/s.
    """
    f = net_bearing
    length = np.linalg.norm(f, axis=-1, keepdims=True)
    return speed * f / np.where(length > 0.0, length, 1.0)


def smallest_sector_law(bearings: NDArray[Any]) -> Array:
    """Velocity from the two bearings that bound the smallest sector with all neighbours in it.

        ṗᵢ = g₊ + g₋ if the sector is narrower than π, else 0    (Bellaiche & Bruckstein, 2016)

    The sector is what the widest gap between neighbouring directions leaves, wherever angles are
    counted from. Its half is the point of least norm of conv{gᵢⱼ} in the plane (guarantees 12).

    Args:
        bearings: of the neighbours, (..., K, 2), of any length; zero rows are absent.

    Returns:
        Velocities, (..., 2), at most 2 m/s.
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


def rounded_bearings(bearings: NDArray[Any], sectors: int) -> Array:
    """Bearings turned into the middles of their sectors, see ``sensor_equations.in_sectors``.

    Args:
        bearings: (..., 2), of any length, which is kept.
        sectors: how many there are, all round.

    Returns:
        The same, (..., 2), float64.
    """
    rows = np.ascontiguousarray(bearings, np.float64).reshape(-1, 2)
    rounded = np.empty_like(rows)
    _round_rows(rows, sectors, rounded)
    return rounded.reshape(bearings.shape)


@kernel
def _round_rows(rows, sectors, out):
    """Rows (N, 2) turned into the middles of their sectors, as long as before."""
    for i in range(rows.shape[0]):
        out[i, 0], out[i, 1] = in_sectors((rows[i, 0], rows[i, 1]), sectors)


def cyclic_pursuit_law(bearings: NDArray[Any], *, speed: float) -> Array:
    """Velocity straight at the next robot, at one speed.

        ṗᵢ = v gᵢⱼ,   j the next in cyclic order that is seen     (Yu et al., 2012, corollary 20)

    Args:
        bearings: of the neighbours, (..., n, K, d), of any length; zero rows are absent. See
            ``rows_from_next`` for which row comes next.
        speed: v, m/s.

    Returns:
        Velocities, (..., n, d), m/s; 0 for a robot that sees nobody.
    """
    return _pursuit_law(bearings, rows_from_next(*bearings.shape[-3:-1]), speed)


def nearest_pursuit_law(bearings: NDArray[Any], *, speed: float) -> Array:
    """Velocity straight at the robot nearest by index, at one speed.

        ṗᵢ = v gᵢⱼ,   j the one of least |i − j| that is seen            (theorem G, guarantees 10)

    Bearings do not tell who is nearest in 3-D. All meet within L0/(2vκ(n)) in continuous time on
    any graph, while everybody sees somebody.

    Args:
        bearings: of the neighbours, (..., n, K, d), of any length; zero rows are absent. See
            ``rows_from_nearest`` for which row is whose.
        speed: v, m/s.

    Returns:
        Velocities, (..., n, d), m/s; 0 for a robot that sees nobody.
    """
    return _pursuit_law(bearings, rows_from_nearest(*bearings.shape[-3:-1]), speed)


def _pursuit_law(bearings: NDArray[Any], order: NDArray[np.int64], speed: float) -> Array:
    """Velocity straight at the first robot of an order, (n, K), that is seen."""
    target = first_seen(np.any(bearings, axis=-1), order)
    return unit_mean_law(chosen_rows(bearings, target), speed=speed)


# ---- as policies --------------------------------------------------------------------------------


def _unit_mean_velocities(f: Array, seen: ObservedRows, time: ArrayLike, *, speed: float) -> Array:
    return unit_mean_law(f, speed=speed)


@register("unit-mean", fits=is_single_integrator, kind="field", on_request=True)
def _unit_mean(scenario: Scenario) -> Policy:
    """Along the net bearing at the speed limit."""
    return LawPolicy(scenario, partial(_unit_mean_velocities, speed=scenario.speed_limit))


def _smallest_sector_velocities(f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
    return smallest_sector_law(seen.neighbours)


@register("smallest-sector", fits=in_the_plane, kind="field", on_request=True)
def _smallest_sector(scenario: Scenario) -> Policy:
    """Between the two neighbours that bound the smallest sector with all of them in it."""
    return LawPolicy(scenario, _smallest_sector_velocities)


def _quantised_velocities(
    f: Array, seen: ObservedRows, time: ArrayLike, *, scenario: Scenario, sectors: int
) -> Array:
    rows = rounded_bearings(seen.neighbours, sectors)
    degree = np.linalg.norm(rows, axis=-1).sum(axis=-1)[..., np.newaxis]
    scale = step_scale(degree, scenario.merge_radius, scenario.tau)
    return bearing_only_law(rows.sum(axis=-2)) * (scale if scenario.scales_velocity else 1.0)


@register("quantised", fits=in_the_plane, kind="field", on_request=True)
def _quantised(scenario: Scenario, sectors: int = 8) -> Policy:
    """Law (1) of bearings that are known by sector only."""
    count = whole("sectors", sectors, 2, MOST_SECTORS)
    return LawPolicy(scenario, partial(_quantised_velocities, scenario=scenario, sectors=count))


def _knows_who(scenario: Scenario) -> bool:
    return is_single_integrator(scenario) and rows_have_an_order(scenario)


def _pursuit_velocities(
    f: Array, seen: ObservedRows, time: ArrayLike, *, law: Callable[..., Array], speed: float
) -> Array:
    return law(seen.neighbours, speed=speed)


@register("cyclic-pursuit", fits=_knows_who, kind="field", on_request=True)
def _cyclic_pursuit(scenario: Scenario) -> Policy:
    """Straight at the next robot by row, at the speed limit."""
    speed = scenario.speed_limit
    return LawPolicy(scenario, partial(_pursuit_velocities, law=cyclic_pursuit_law, speed=speed))


@register("nearest-pursuit", fits=_knows_who, kind="field", on_request=True)
def _nearest_pursuit(scenario: Scenario) -> Policy:
    """Straight at the robot nearest by index, at the speed limit."""
    speed = scenario.speed_limit
    return LawPolicy(scenario, partial(_pursuit_velocities, law=nearest_pursuit_law, speed=speed))
