"""Where to head among obstacles, from the bearings of their edges alone: pure functions."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.checks import real, shown
from rendezvous_env.safety.settings import check_vectors
from rendezvous_env.scenario.observation_layout import SILHOUETTE_POINTS

from .merged_silhouettes_2d import joined_headings_2d
from .merged_silhouettes_3d import joined_headings_3d
from .silhouettes import tangent_headings

Array = NDArray[np.float64]


class HeadingRule(Protocol):
    """A pure function from what robots see to headings."""

    def __call__(self, net_bearing: Array, silhouettes: NDArray[Any]) -> Array:
        """Headings hᵢ, (..., d), unit vectors.

        Args:
            net_bearing: fᵢ, (..., d), m/s.
            silhouettes: unit bearings, (..., M, S, d); zero where no obstacle is seen.
        """
        ...


def tangent_heading(net_bearing: Array, silhouettes: NDArray[Any]) -> Array:
    """Section IV-C read literally: the edge nearest to f of the most prominent obstacle in sight.

    The most prominent obstacle is the one with the largest angular width, whether it stands in the
    way or not. With none in sight h = f/‖f‖ (the x axis where f = 0).

    Args:
        net_bearing: fᵢ, (..., d), m/s.
        silhouettes: unit bearings, (..., M, S, d).

    Returns:
        Headings, (..., d).

    Raises:
        ValueError: naming an argument of the wrong shape, or that is not finite.
    """
    return _over_robots(tangent_headings, net_bearing, silhouettes, False)


def tangent_blocking_heading(net_bearing: Array, silhouettes: NDArray[Any]) -> Array:
    """Section IV-C for obstacles in the way only: of those that f points into, the most prominent.

    Args:
        net_bearing: fᵢ, (..., d), m/s.
        silhouettes: unit bearings, (..., M, S, d).

    Returns:
        Headings, (..., d); f/‖f‖ (the x axis where f = 0) if nothing is in the way.

    Raises:
        ValueError: naming an argument of the wrong shape, or that is not finite.
    """
    return _over_robots(tangent_headings, net_bearing, silhouettes, True)


def tangent_joined_heading(
    net_bearing: Array,
    silhouettes: NDArray[Any],
    *,
    clearance: float = 0.05,
    carried: Array | None = None,
    persistence: float = 0.0,
) -> Array:
    """Overlapping silhouettes are one obstacle; pass it on the nearer side (theory 6).

    Details are with ``joined_plane.joined_headings_2d`` and ``joined_space.joined_headings_3d``.

    Args:
        net_bearing: fᵢ, (..., d), m/s.
        silhouettes: unit bearings, (..., M, S, d).
        clearance: angle by which to stay clear of an edge, rad.
        carried: headings of the step before, (..., d), zero where there is none; in the plane only.
        persistence: how much an edge's angle from the carried heading counts beside that from f.

    Returns:
        Headings, (..., d); f/‖f‖ (the x axis where f = 0) if nothing is in the way.

    Raises:
        ValueError: naming an argument of the wrong shape, or that is not finite.
    """
    f = check_vectors("net_bearing", net_bearing)
    if f.shape[-1] == 3:
        return _over_robots(joined_headings_3d, f, silhouettes, float(clearance))
    before = np.zeros_like(f) if carried is None else check_vectors("carried", carried, like=f)
    options = float(clearance), before.reshape(-1, 2), float(persistence)
    return _over_robots(joined_headings_2d, f, silhouettes, *options)


def _over_robots(
    rule: Any, net_bearing: Array, silhouettes: NDArray[Any], *options: bool | float | Array
) -> Array:
    f = check_vectors("net_bearing", net_bearing)
    points = np.ascontiguousarray(silhouettes)
    d, leading = f.shape[-1], f.shape[:-1]
    seen = (SILHOUETTE_POINTS[d], d)
    if points.ndim != f.ndim + 2 or (*points.shape[:-3], *points.shape[-2:]) != (*leading, *seen):
        raise ValueError(
            f"silhouettes has shape {points.shape}; with net_bearing of shape {f.shape} it must be "
            f"(..., M, {seen[0]}, {seen[1]})"
        )
    if points.dtype not in (np.float32, np.float64):
        raise ValueError(f"silhouettes are {points.dtype}; they must be float32 or float64")
    headings = np.empty_like(f)
    robots = f.size // d
    points = points.reshape(robots, *points.shape[-3:])  # -1 cannot be inferred without obstacles
    rule(f.reshape(robots, d), points, *options, headings.reshape(robots, d))
    return headings


def check_clearance(clearance: Any) -> None:
    """Refuse a clearance that is no angle in [0, π) rad.

    Raises:
        ValueError: naming it.
    """
    if not 0 <= real(clearance) < np.pi:
        raise ValueError(f"clearance is {shown(clearance)}; it must be an angle in [0, π) rad")
