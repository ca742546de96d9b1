"""Shortest ways among obstacles of the plane, for policies that may know the map.

A shortest way runs straight from corner to corner of the obstacles, made fatter by a clearance:
corners that see one another are the nodes of a graph (a visibility graph), and Dijkstra's algorithm
finds the ways in it.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from rendezvous_env.equations.obstacles import ABSENT, CAPSULE, POLYGON
from rendezvous_env.experiment import packing

from .straight_ways import margins_at, straight_ways

Array = NDArray[np.float64]
_QUARTER = 4
"""Corners that stand for a quarter of a circle."""
_SPIKE = 1e3
"""Longest corner of a pointed obstacle, in clearances."""
_KEPT = 0.9
"""Share of the clearance that a way must keep: corners lie at all of it, up to rounding."""


class Roadmap:
    """Ways that keep a clearance from the obstacles of one team.

    Args:
        table: obstacles, (M, width), see ``experiment.packing``.
        clearance: m. A way from a point that is nearer to an obstacle keeps less.
    """

    def __init__(self, table: Array, clearance: float) -> None:
        self._world = packing.world_of(table)
        self._clearance = clearance
        corners = _corners(table, clearance)
        self.corners: Array = corners[self._margins(corners) == _KEPT * clearance]
        """(C, 2), m."""
        self._lengths = self.straight(self.corners, self.corners)

    def _margins(self, points: Array) -> Array:
        out = np.empty(len(points))
        margins_at(self._world, points, _KEPT * self._clearance, out)
        return out

    def straight(self, points: Array, targets: Array) -> Array:
        """Lengths of straight ways, (N, K), m; inf where an obstacle is in the way.

        Args:
            points: (N, 2), m.
            targets: (K, 2), m.
        """
        out = np.empty((len(points), len(targets)))
        straight_ways(self._world, points, targets, self._margins(points), out)
        return out

    def to_corners(self, points: Array) -> tuple[Array, NDArray[np.int32]]:
        """Lengths of the shortest ways from points to all corners, (N, C), m; and the corner before
        each on that way, negative if it is the first.

        Args:
            points: (N, 2), m.
        """
        n, count = len(points), len(self.corners)
        first = self.straight(points, self.corners)
        lengths = np.full((n + count, n + count), np.inf)
        lengths[:n, n:], lengths[n:, n:] = first, self._lengths
        found, before = dijkstra(_sparse(lengths), indices=range(n), return_predecessors=True)
        return found[:, n:], before[:, n:] - n

    def distances(self, points: Array, to_corners: Array, places: Array) -> Array:
        """Lengths of the shortest ways, (N, K), m; inf where there is none.

        Args:
            points: (N, 2), m.
            to_corners: from there, (N, C), m.
            places: (K, 2), m.
        """
        out, last = self.straight(points, places), self.straight(self.corners, places)
        if len(self.corners):
            for row, to_corner in zip(out, to_corners, strict=True):
                np.minimum(row, (to_corner[:, None] + last).min(axis=0), out=row)
        return out


class WaysTo:
    """The shortest way from anywhere to one place.

    Args:
        roadmap: of the team.
        place: (2,), m.
    """

    def __init__(self, roadmap: Roadmap, place: Array) -> None:
        self._roadmap, self._place = roadmap, place
        lengths, following = roadmap.to_corners(place[None])
        self._lengths, self._following = lengths[0], following[0]

    def way(self, point: Array) -> Array:
        """Where the way from a point turns, and the place at its end, (P, 2), m; the point itself
        if there is no way.
        """
        if math.isfinite(self._roadmap.straight(point[None], self._place[None])[0, 0]):
            return self._place[None]
        over = self._roadmap.straight(point[None], self._roadmap.corners)[0] + self._lengths
        if not np.isfinite(over).any():
            return point[None]
        turns, corner = [], int(np.argmin(over))
        while corner >= 0:
            turns.append(self._roadmap.corners[corner])
            corner = int(self._following[corner])
        return np.array([*turns, self._place])


def _sparse(lengths: Array) -> scipy.sparse.csr_array:
    """The edges that there are; two corners in one place are still joined by one."""
    rows, columns = np.nonzero(np.isfinite(lengths))
    kept = np.maximum(lengths[rows, columns], np.finfo(float).tiny)
    return scipy.sparse.csr_array((kept, (rows, columns)), shape=lengths.shape)


def _corners(table: Array, clearance: float) -> Array:
    """Corners of the obstacles made fatter, (C, 2); round ones become polygons about them."""
    import shapely  # slow to import, and only planners need it

    cores, radii = [], []
    outward = 1.0 / math.cos(math.pi / (4 * _QUARTER))
    for row in table[table[:, packing.KIND] != ABSENT]:
        centre = row[packing.CENTRE : packing.CENTRE + 2]
        if row[packing.KIND] == POLYGON:
            vertices = row[packing.DETAILS : packing.DETAILS + 2 * int(row[packing.CORNERS])]
            cores.append(shapely.Polygon(vertices.reshape(-1, 2)))
            radii.append(clearance)
        elif row[packing.KIND] == CAPSULE:
            half = row[packing.AXIS : packing.AXIS + 2]
            cores.append(shapely.LineString([centre - half, centre + half]))
            radii.append(outward * (row[packing.THICKNESS] + clearance))
        else:
            cores.append(shapely.Point(centre))
            radii.append(outward * (row[packing.RADIUS] + clearance))
    fatter = shapely.buffer(
        np.array(cores, dtype=object),
        np.array(radii),
        quad_segs=_QUARTER,
        join_style="mitre",
        mitre_limit=_SPIKE,
    )
    rings = [shapely.get_coordinates(polygon)[:-1] for polygon in fatter]
    return np.concatenate(rings) if rings else np.empty((0, 2))
