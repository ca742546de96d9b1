"""Shortest paths among obstacles, for oracles.

In the plane: Dijkstra's algorithm on the visibility graph of the corners of inflated obstacles. In
3-D the nodes are points on the surfaces of inflated obstacles, and paths are nearly optimal.
"""

import math

import numpy as np
import scipy.sparse
import scipy.spatial
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.obstacles.capsule import AXIS, CAPSULE, THICKNESS
from rendezvous_env.obstacles.obstacle_set import ObstacleSet, entry, outlines, world_of
from rendezvous_env.obstacles.polygon import POLYGON
from rendezvous_env.obstacles.shape import ABSENT, BOUND, MIDDLE, OWN
from rendezvous_env.physics.vectors import ORIGIN, combine, dot, load, norm, subtract

Array = NDArray[np.float64]
_QUARTER = 4  # corners that approximate a quarter circle
_ON_A_BALL = 24  # points that approximate a ball
_APART = 0.4  # rad; half the angle between two adjacent ones
_SPIKE = 1e3  # longest corner of a pointed obstacle, in clearances
_KEPT = 0.9  # fraction of the clearance to keep on paths: corners are at all of it, up to rounding
_MOST_SIDES = 16  # polygons with more corners are simplified, by less than half the clearance
MAX_CORNERS = 4_000
"""Maximum number of corners of a roadmap, since the graph is quadratic: 250 discs or 16-gons."""
_HALVINGS = 12
_ROUNDING = 1.0 + 1e-9
_TOUCH = 1e-7  # m; maximum depth of a path from the surface, less than that of a contact


class Roadmap:
    """Roadmap with a clearance, m, to the obstacles of one environment, (M, width).

    The clearance is reduced for a point that is closer to an obstacle.
    """

    def __init__(self, table: Array, clearance: float, dim: int = 2) -> None:
        self._world = world = world_of(table)
        self._clearance = clearance
        self._spikes = _spikes(world)
        corners = _corners(world, clearance) if dim == 2 else _points_around(table, clearance)
        if len(corners) > MAX_CORNERS:
            raise ValueError(
                f"the obstacles have {len(corners)} corners; the planner supports at most "
                f"{MAX_CORNERS}: give fewer obstacles, or polygons with fewer corners"
            )
        self.corners: Array = corners[self._margins(corners) == _KEPT * clearance]  # (C, d), m
        self._lengths = self.straight(self.corners, self.corners)

    def _margins(self, points: Array) -> Array:
        out = np.empty(len(points))
        around = self._spikes, self._nearest_first(points)
        _margins_at(self._world, around, points, _KEPT * self._clearance, out)
        return out

    def _nearest_first(self, points: Array) -> NDArray[np.int64]:
        """Obstacle indices sorted by distance to each point, (N, M)."""
        centres = self._world.shapes[:, MIDDLE : MIDDLE + points.shape[1]]
        gaps = scipy.spatial.distance.cdist(points, centres) - self._world.shapes[:, BOUND]
        return np.argsort(gaps, axis=1)

    def straight(self, points: Array, targets: Array) -> Array:
        """Lengths (N, K) of straight paths from points to targets, m; inf if blocked."""
        out = np.empty((len(points), len(targets)))
        around = self._spikes, self._nearest_first(points)
        _straight_lengths(self._world, around, points, targets, self._margins(points), out)
        return out

    def to_corners(self, points: Array) -> tuple[Array, NDArray[np.int32]]:
        """Lengths (N, C) of the shortest paths from points to corners, m, and predecessors.

        The predecessor of a corner on its path is negative for the first corner.
        """
        n, count = len(points), len(self.corners)
        lengths = np.full((n + count, n + count), np.inf)
        lengths[:n, n:], lengths[n:, n:] = self.straight(points, self.corners), self._lengths
        rows, columns = np.nonzero(np.isfinite(lengths))
        # two corners at one point also have an edge
        edges = np.maximum(lengths[rows, columns], np.finfo(float).tiny)
        graph = scipy.sparse.csr_array((edges, (rows, columns)), shape=lengths.shape)
        found, before = dijkstra(graph, indices=range(n), return_predecessors=True)
        return found[:, n:], before[:, n:] - n

    def distances(self, points: Array, to_corners: Array, places: Array) -> Array:
        """Lengths (N, K) of the shortest paths from points to targets, m; inf if unreachable.

        Path lengths to corners are given.
        """
        out, last = self.straight(points, places), self.straight(self.corners, places)
        if len(self.corners):
            for row, to_corner in zip(out, to_corners, strict=True):
                np.minimum(row, (to_corner[:, None] + last).min(axis=0), out=row)
        return out


class PathsTo:
    """Shortest paths to one target, (d,), m."""

    def __init__(self, roadmap: Roadmap, place: Array) -> None:
        self._roadmap, self._place = roadmap, place
        lengths, following = roadmap.to_corners(place[None])
        self._lengths, self._following = lengths[0], following[0]

    def way(self, point: Array) -> Array:
        """Waypoints from a point to the target, (P, d), m; the point itself without a path."""
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


def _corners(world: ObstacleSet, clearance: float) -> Array:
    """Corners of the inflated obstacles, (C, 2); round shapes are circumscribed by polygons."""
    import shapely  # slow to import, and only planners need it

    cores, radii = [], []
    outward = 1.0 / math.cos(math.pi / (4 * _QUARTER))
    for m in np.flatnonzero(world.kinds != ABSENT).tolist():
        kind, row = world.kinds[m], world.shapes[m]
        centre = row[MIDDLE : MIDDLE + 2]
        if kind == POLYGON:
            polygon = shapely.Polygon(_vertices(world, m))
            spare = 0.5 * clearance if world.corners[m] > _MOST_SIDES else 0.0
            cores.append(polygon.simplify(spare) if spare else polygon)
            radii.append(clearance + spare)
        elif kind == CAPSULE:
            half = row[AXIS : AXIS + 2]
            cores.append(shapely.LineString([centre - half, centre + half]))
            radii.append(outward * (row[THICKNESS] + clearance))
        else:
            cores.append(shapely.Point(centre))
            radii.append(outward * (row[BOUND] + clearance))
    options = {"quad_segs": _QUARTER, "join_style": "mitre", "mitre_limit": _SPIKE}
    inflated = shapely.buffer(np.array(cores, dtype=object), np.array(radii), **options)
    rings = [shapely.get_coordinates(polygon)[:-1] for polygon in inflated]
    return np.concatenate([np.empty((0, 2)), *rings])


def _points_around(table: Array, clearance: float) -> Array:
    """Points of Fibonacci lattices on balls that cover the inflated obstacles, (C, 3).

    The balls are large enough that straight paths between adjacent points keep the clearance.
    """
    k = np.arange(_ON_A_BALL) + 0.5
    height, azimuth = 1.0 - 2.0 * k / _ON_A_BALL, math.pi * (1.0 + math.sqrt(5.0)) * k
    aside = np.sqrt(1.0 - height**2)
    ways = np.stack([aside * np.cos(azimuth), aside * np.sin(azimuth), height], axis=-1)
    lattices = [
        ball.centre + (ball.radius + clearance) / math.cos(_APART) * ways
        for ball in outlines(table, 3)
    ]
    return np.concatenate([np.empty((0, 3)), *lattices])


def _vertices(world: ObstacleSet, m: int) -> Array:
    return world.shapes[m, OWN : OWN + 2 * world.corners[m]].reshape(-1, 2)


def _spikes(world: ObstacleSet) -> Array:
    """Corner distance of inflated obstacles relative to the inflation, (M,).

    1/sin(θ/2) for the sharpest angle θ of a polygon, 1 for round shapes.
    """
    out = np.ones(len(world.kinds))
    for m in np.flatnonzero(world.kinds == POLYGON).tolist():
        edges = np.diff(_vertices(world, m), axis=0, append=_vertices(world, m)[:1])
        bearings = np.arctan2(edges[:, 1], edges[:, 0])
        turns = np.diff(bearings, append=bearings[:1]) % (2 * math.pi)
        out[m] = 1.0 / np.cos(0.5 * turns).min()
    return out


@kernel
def _margins_at(world, around, points, most, out):
    """Feasible clearance of paths from points (N, d), m: ``most`` halved until it fits.

    ``around`` contains ``_spikes`` and the order of obstacles (N, M).
    """
    spikes, order = around
    for i in range(len(points)):
        out[i] = -_TOUCH
        for halving in range(_HALVINGS):
            margin = most * 0.5**halving
            if not _in_the_way(world, spikes, order[i], load(points[i]), ORIGIN, margin):
                out[i] = margin
                break


@inner_kernel
def _in_the_way(world, spikes, order, here, way, margin):
    """True if a path violates the clearance to an obstacle, with sharp polygon corners."""
    length = dot(way, way)
    for m in order:
        if world.kinds[m] == ABSENT:
            continue
        offset = subtract(load(world.shapes[m, MIDDLE : MIDDLE + 3]), here)
        share = min(max(dot(offset, way) / length, 0.0), 1.0) if length > 0.0 else 0.0
        offset = combine(1.0, offset, -share, way)
        bound = (world.shapes[m, BOUND] + abs(margin) * spikes[m]) * _ROUNDING
        if dot(offset, offset) <= bound * bound:
            if entry(world, m, here, way, -margin) < np.inf:
                return True
    return False


@kernel
def _straight_lengths(world, around, points, targets, margins, out):
    """``Roadmap.straight`` with clearances (N,), m; other arguments as ``_margins_at``."""
    spikes, order = around
    for i in range(len(points)):
        here = load(points[i])
        for k in range(len(targets)):
            way = subtract(load(targets[k]), here)
            out[i, k] = norm(way)
            if _in_the_way(world, spikes, order[i], here, way, margins[i]):
                out[i, k] = np.inf
