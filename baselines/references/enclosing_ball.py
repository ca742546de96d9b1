"""Smallest enclosing ball of a set of points."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import floats
from rendezvous_env.limits import LARGEST

Array = NDArray[np.float64]


def smallest_enclosing_ball(points: ArrayLike) -> tuple[Array, float]:
    """Smallest enclosing ball: min_c max_k ‖p_k − c‖.

    Welzl's algorithm (1991) with move-to-front.

    Args:
        points: (N, d), N ≥ 1, m.

    Returns:
        Centre c, (d,), m, and radius, m.

    Raises:
        ValueError: for no point, or one that is not finite.
    """
    p = floats("points", points)
    if p.ndim != 2 or p.size == 0 or not (np.abs(p) <= LARGEST).all():
        raise ValueError(
            f"points have shape {p.shape}; they must be finite, within {LARGEST:g} m, and (N, d) "
            "with N >= 1"
        )
    centre, square = _enclose(p, len(p), [])
    return centre, math.sqrt(square)


def _enclose(points: Any, count: int, boundary: list[Array]) -> tuple[Array, float]:
    """Smallest ball around the first ``count`` points with ``boundary`` on its surface."""
    dim = points.shape[1]
    centre, square = _circumscribe(boundary, dim)
    if len(boundary) == dim + 1:
        return centre, square
    for k in range(count):
        if square < 0 or np.sum((points[k] - centre) ** 2) > square * (1 + 1e-12) + 1e-300:
            centre, square = _enclose(points, k, [*boundary, points[k].copy()])
            points = np.concatenate([points[k : k + 1], points[:k], points[k + 1 :]])
    return centre, square


def _circumscribe(boundary: list[Array], dim: int) -> tuple[Array, float]:
    """Smallest ball with all of ``boundary`` on its surface; squared radius −1 for no point."""
    if not boundary:
        return np.zeros(dim), -1.0
    origin = boundary[0]
    edges = np.array([point - origin for point in boundary[1:]]).reshape(-1, dim)
    shares, *_ = np.linalg.lstsq(2.0 * edges @ edges.T, np.sum(edges**2, axis=1), rcond=None)
    offset = shares @ edges if len(edges) else np.zeros(dim)
    return origin + offset, float(offset @ offset)
