"""Occupancy grids: cells, their pose in the plane, and the area of occupied cells."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

MAX_CELLS = 2**26
"""Maximum number of cells of a grid."""


class Pose(NamedTuple):
    """Frame in which an area is described: metres per unit, origin in m, and yaw in rad."""

    scale: float = 1.0
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 2) of the frame in m, counterclockwise by the yaw about its origin."""
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        if self.yaw == 0.0:
            cosine, sine = 1.0, 0.0
        x, y = self.scale * points[..., 0], self.scale * points[..., 1]
        return np.stack([self.x + cosine * x - sine * y, self.y + sine * x + cosine * y], axis=-1)

    def invert(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 2) in the frame, from m."""
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        x, y = points[..., 0] - self.x, points[..., 1] - self.y
        return np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1) / self.scale


class Area(NamedTuple):
    """Obstacles of a map before they become shapes, in the units of a frame."""

    occupied: Any
    """Union of all obstacles, a shapely geometry."""
    bounds: tuple[float, float, float, float]
    """Extent of the map: least x and y, largest x and y."""
    pose: Pose
    bordered: bool
    """True if the map is unknown beyond the bounds, as in a grid."""


def area_of(occupied: NDArray[np.bool_], pose: Pose) -> Area:
    """Area of a grid of cells (rows, columns), the first row at the bottom, in cells."""
    import shapely

    rows, columns = occupied.shape
    boxes = shapely.box(*_rectangles(occupied).T) if occupied.any() else []
    union = shapely.union_all(boxes)
    return Area(union, (0.0, 0.0, float(columns), float(rows)), pose, bordered=True)


def _rectangles(occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Disjoint rectangles that cover the occupied cells, (m, 4): x0, y0, x1, y1.

    Each is a horizontal run of cells that consecutive rows have in common.
    """
    edges = np.diff(np.pad(occupied, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    open_runs: dict[tuple[int, int], int] = {}
    found: list[tuple[int, int, int, int]] = []
    for row in range(len(edges) + 1):
        runs: set[tuple[int, int]] = set()
        if row < len(edges):
            starts, ends = np.flatnonzero(edges[row] == 1), np.flatnonzero(edges[row] == -1)
            runs = set(zip(starts.tolist(), ends.tolist(), strict=True))
        for run in [run for run in open_runs if run not in runs]:
            found.append((run[0], open_runs.pop(run), run[1], row))
        for run in runs:
            open_runs.setdefault(run, row)
    return np.array(found, dtype=np.int64).reshape(-1, 4)
