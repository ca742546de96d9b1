"""Hull perimeter L: perimeter of the convex hull, in 3-D 2π times its mean width (guarantees 9)."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_FLAT = 1e-10
"""Relative extent below which a hull counts as flat, which bounds the relative error of L."""


def size(points: Array) -> float:
    """L = ∫_{|u|=1} max_i u·p_i du, m, of finite points p, (N, d), m, N ≥ 1; 0 for a single point.

    A segment is a polygon with two sides. A flat polygon in 3-D has the mean width P/4, with P its
    perimeter, so L = (π/2) P.
    """
    d, flat = points.shape[1], _in_their_own_axes(points)
    if flat.shape[1] == 3:
        return 2.0 * math.pi * _mean_width(flat)
    if flat.shape[1] == 2:
        perimeter = float(_hull(flat).area)
    else:  # of a segment both sides count
        perimeter = 2.0 * float(np.ptp(flat)) if flat.size else 0.0
    return perimeter * (1.0 if d == 2 else math.pi / 2.0)


def _in_their_own_axes(points: Array) -> Array:
    """Coordinates (N, k) along the k ≤ d principal directions in which the points extend, m."""
    offsets = points - points[0]
    _, extents, axes = np.linalg.svd(offsets, full_matrices=False)
    k = int(np.sum(extents > _FLAT * extents[0]))
    return np.asarray(offsets @ axes[:k].T)


def _mean_width(points: Array) -> float:
    """Mean width of a solid hull, m: (1/4π) Σ_edges length × exterior dihedral angle."""
    hull = _hull(points)
    normals, total = hull.equations[:, :3], 0.0
    for k in range(3):  # a facet's edge opposite its corner k is also its neighbour k's
        ends = np.delete(hull.simplices, k, axis=1)
        length = np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=-1)
        other = normals[hull.neighbors[:, k]]
        sine = np.linalg.norm(np.cross(normals, other), axis=-1)
        total += float(length @ np.arctan2(sine, np.sum(normals * other, axis=-1)))
    return total / 2.0 / (4.0 * math.pi)  # each edge was met from both sides


def _hull(points: Array) -> Any:
    from scipy.spatial import ConvexHull

    return ConvexHull(points)
