"""Law (R b): robots that go where all their neighbours are, so that no link grows longer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..compilation import kernel
from ..equations.least_norm import least_norm_of
from ..equations.vectors import store
from ..experiment.checks import floats


def least_norm_points(neighbour_rows: ArrayLike) -> NDArray[np.float64]:
    """q_i, the point of least norm of the averages of a robot's bearings (guarantees, lemma 2).

        q_i = argmin ‖q‖,   q ∈ conv{g_ij : j seen}

    All bearings lie along it, q_i·g_ij ≥ ‖q_i‖², and it is zero where neighbours are all round.

    Args:
        neighbour_rows: a_ij g_ij, (..., K, d), m/s; zero rows are absent, lengths do not count.

    Returns:
        (..., d), without unit, ‖q_i‖ ≤ 1; zero where nobody is seen.

    Raises:
        ValueError: for another shape, or rows that are not finite.
    """
    rows = floats("neighbour_rows", neighbour_rows)
    if rows.ndim < 2 or rows.shape[-1] not in (2, 3):
        raise ValueError(
            f"neighbour_rows has shape {rows.shape}; it must be (..., K, 2) or (..., K, 3)"
        )
    if not np.isfinite(rows).all():
        raise ValueError("neighbour_rows must be finite")
    points = np.empty((*rows.shape[:-2], rows.shape[-1]))
    flat = np.ascontiguousarray(rows).reshape(-1, *rows.shape[-2:])
    least_norm_points_of(flat, points.reshape(-1, rows.shape[-1]))
    return points


@kernel
def least_norm_points_of(rows, out):
    """``least_norm_points`` for N robots; ``out`` (N, d) is filled in."""
    for i in range(len(rows)):
        store(least_norm_of(rows[i], rows.shape[1]), out[i])


def link_keeping_law(
    least_norm_point: NDArray[np.float64], degree: Any, *, merge_radius: float, duration: float
) -> NDArray[np.float64]:
    """Velocity that lengthens no link, held over the step too.

        v_i = min(d_i, r/τ) q_i                                     (theorem R b)

    Args:
        least_norm_point: q_i, (..., d), without unit, in the robot's own frame.
        degree: d_i = Σ_j a_ij, (...), m/s.
        merge_radius: r, m.
        duration: τ, s.

    Returns:
        Velocities, (..., d), m/s.
    """
    speed = np.minimum(degree, merge_radius / duration)
    return least_norm_point * np.asarray(speed)[..., np.newaxis]
