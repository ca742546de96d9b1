"""Headings in the cone of the bearings: with law (4) the hull never grows (guarantees 10, C4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls

from rendezvous_env.safety.heading import into_cap
from rendezvous_env.safety.settings import check_gate_constants, check_vectors

Array = NDArray[np.float64]


def cone_heading(raw: ArrayLike, neighbour_rows: ArrayLike, *, min_alignment: float) -> Array:
    """Heading closest to a raw vector within the cone of bearings, with a minimum alignment.

        h ∈ cone{g_j},   h·f ≥ ε ‖f‖                                  (guarantees 10, C4)

    The raw vector is projected onto the cone. The result is turned towards f, which lies in the
    cone, as far as the minimum alignment requires. It is f/‖f‖ if no bearing has a positive
    component along the raw vector.

    Args:
        raw: any vectors, (..., d), d = 2 or 3; only the direction counts.
        neighbour_rows: a_ij g_ij, (..., K, d), m/s, in the same frame; zero rows are absent.
        min_alignment: ε, in (0, 1).

    Returns:
        h, (..., d), unit vectors; zero where f is zero.

    Raises:
        ValueError: naming an argument out of range, of the wrong shape, or not finite.
    """
    check_gate_constants(min_alignment, 1.0)
    vectors, rows = check_vectors("raw", raw), check_vectors("neighbour_rows", neighbour_rows)
    out = np.empty_like(vectors)
    for index in np.ndindex(vectors.shape[:-1]):
        out[index] = _heading(vectors[index], rows[index], min_alignment)
    return out


def _heading(raw: Array, rows: Array, min_alignment: float) -> Array:
    f = rows.sum(axis=0)
    strength, length = np.linalg.norm(f), np.linalg.norm(raw)
    if strength == 0.0:
        return f
    towards = f / strength
    wanted = raw / length if length > 0.0 else raw
    nearest = rows.T @ nnls(rows.T, wanted)[0]
    size = np.linalg.norm(nearest)
    if size < 1e-12:
        return towards
    centre = (*towards, 0.0)[:3]
    h = into_cap((*(nearest / size), 0.0)[:3], centre, min_alignment, centre)
    return np.array(h)[: len(f)]


def cone_velocity(
    headings: ArrayLike,
    net_bearing: ArrayLike,
    least_norm_point: ArrayLike,
    *,
    merge_radius: float,
    duration: float,
) -> Array:
    """Law (4) along headings of the cone, at a speed for which the hulls of held steps are nested.

        v = h min(hᵀf, r ‖q‖/τ)

    A heading is a sum of bearings with a total weight of at most 1/‖q‖, so τ v is one of at most r.
    q, (..., d), is from ``least_norm_points``.
    """
    h, f = np.asarray(headings), np.asarray(net_bearing)
    most = merge_radius / duration * np.linalg.norm(least_norm_point, axis=-1)
    speed = np.minimum(np.sum(h * f, axis=-1), most)
    return np.asarray(h * speed[..., np.newaxis])
