"""Headings among the bearings, with which law (4) never lets the hull grow (guarantees 10, C4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import floats, refuse
from ..compilation import kernel
from ..physics.least_norm import least_along
from ..physics.rows import net_bearing_of
from ..physics.vectors import ORIGIN, add, combine, cross, dot, load, scaled, split, store, subtract
from .heading import into_cap
from .settings import check_gate_constants, check_vectors

_MOST_ROUNDS = 32
"""A few do, however many bearings there are."""
_ROUNDING = 1e-13
_FLAT = 1e-12
"""Volume or area of unit vectors below which they count as dependent."""


def cone_heading(
    raw: ArrayLike, neighbour_rows: ArrayLike, *, min_alignment: float
) -> NDArray[np.float64]:
    """The heading nearest to a raw vector among the bearings of neighbours, and near f.

        h ∈ cone{g_j},   h·f ≥ ε ‖f‖                                  (guarantees 10, C4)

    The raw vector is projected onto the cone, and the result turned towards f, which lies in the
    cone, as far as the margin needs; f/‖f‖ if all bearings lie across or away from the raw vector.
    Then law (4), v = h hᵀf, keeps the hull of the team nested on any graph, in continuous time.

    Args:
        raw: any vectors, (..., d), d = 2 or 3, of any unit; only the direction counts.
        neighbour_rows: a_ij g_ij, (..., K, d), m/s, in the same frame; zero rows are absent.
        min_alignment: ε, in (0, 1).

    Returns:
        h, (..., d), unit vectors; zero where f is.

    Raises:
        ValueError: naming an argument out of range, of the wrong shape, or not finite.
    """
    check_gate_constants(min_alignment, 1.0)
    vectors = check_vectors("raw", raw)
    rows = floats("neighbour_rows", neighbour_rows)
    if rows.ndim < 2 or (*rows.shape[:-2], rows.shape[-1]) != vectors.shape:
        leading = ", ".join(map(str, (*vectors.shape[:-1], "K", vectors.shape[-1])))
        refuse("neighbour_rows", rows, f"of shape ({leading}), not {rows.shape}")
    if not np.isfinite(rows).all():
        raise ValueError("neighbour_rows must be finite")
    d, out = vectors.shape[-1], np.empty_like(vectors)
    flat = np.ascontiguousarray(rows).reshape(-1, *rows.shape[-2:])
    headings_in_cones(vectors.reshape(-1, d), flat, float(min_alignment), out.reshape(-1, d))
    return out


def cone_velocity(
    headings: ArrayLike,
    net_bearing: ArrayLike,
    least_norm_point: ArrayLike,
    *,
    merge_radius: float,
    duration: float,
) -> NDArray[np.float64]:
    """Law (4) along headings of the cone, slow enough for the hull to be nested in a held step.

        v = h min(hᵀf, r ‖q‖/τ)

    A heading is a sum of bearings with weights of 1/‖q‖ or less in all, so τ v is one of r or less.

    Args:
        headings: h, (..., d), from ``cone_heading``.
        net_bearing: f, (..., d), m/s.
        least_norm_point: q, (..., d), from ``least_norm_points``.
        merge_radius: r, m.
        duration: τ, s.

    Returns:
        v, (..., d), m/s.
    """
    h, f = np.asarray(headings), np.asarray(net_bearing)
    most = merge_radius / duration * np.linalg.norm(least_norm_point, axis=-1)
    speed = np.minimum(np.sum(h * f, axis=-1), most)
    return np.asarray(h * speed[..., np.newaxis])


@kernel
def headings_in_cones(raw, rows, min_alignment, out):
    """``cone_heading`` for N robots; ``out`` (N, d) is filled in."""
    slots = rows.shape[1]
    for i in range(len(out)):
        strength, towards = split(net_bearing_of(rows[i], slots))
        heading = towards
        if strength > 0.0:
            _, direction = split(load(raw[i]))
            length, aim = split(_project_on_cone(direction, rows[i], slots))
            if length > _ROUNDING:
                heading = into_cap(aim, towards, min_alignment, towards)
        store(heading, out[i])


@kernel
def _project_on_cone(wanted, rows, neighbour_slots):
    """The point of cone{g_j} that is nearest to a vector, a triple.

    An active set of up to three bearings: the one that what is left points along most comes in, and
    the longest projection onto it and the active ones with weights that are not negative remains.
    """
    point, active = ORIGIN, (ORIGIN, ORIGIN, ORIGIN)
    for _ in range(_MOST_ROUNDS):
        left = subtract(wanted, point)
        bearing = least_along(rows, neighbour_slots, scaled(left, -1.0))
        if dot(left, bearing) <= _ROUNDING:
            break
        before = dot(point, point)
        others = (ORIGIN, active[0], active[1], active[2])
        for k in range(4):
            for m in range(max(k, 1)):
                found = _within(wanted, bearing, others[k], others[m])
                if dot(found, found) > dot(point, point):
                    point, active = found, (bearing, others[k], others[m])
        if dot(point, point) <= before:
            break
    return point


@kernel
def _within(wanted, a, b, c):
    """The projection of a vector onto the span of one to three bearings, b and c zero if they are
    none; the origin where a weight would be negative.
    """
    if dot(b, b) == 0.0:
        return scaled(a, max(dot(wanted, a), 0.0))
    if dot(c, c) == 0.0:
        normal = cross(a, b)
        area = dot(normal, normal)
        if area < _FLAT * _FLAT:
            return ORIGIN
        p, q = dot(cross(wanted, b), normal) / area, dot(cross(a, wanted), normal) / area
        return combine(p, a, q, b) if min(p, q) >= 0.0 else ORIGIN
    volume = dot(a, cross(b, c))
    if abs(volume) < _FLAT:
        return ORIGIN
    p = dot(wanted, cross(b, c)) / volume
    q = dot(a, cross(wanted, c)) / volume
    s = dot(a, cross(b, wanted)) / volume
    return add(combine(p, a, q, b), s, c) if min(p, q, s) >= 0.0 else ORIGIN
