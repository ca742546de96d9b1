"""Convex pieces of areas, and their outlines: simplified outwards, and grown to overlap.

Distances are in the units of the area. ``simplified`` never shrinks an area:

    A ⊆ simplified(A, t) ⊆ A ⊕ B(t)

It moves the outline outwards by d, with mitred corners of at most √2 d, and then removes vertices
within d (Douglas and Peucker), d = t/(1 + √2).
"""

import math
from collections import defaultdict
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_CORNERS = 12
"""Maximum number of corners of a piece before it grows; all rows of a table are equally long."""
_SHARE = 1.0 / (1.0 + math.sqrt(2.0))
_FLAT = 1e-12  # of an area: pieces whose hull is larger by less are convex together
Ring = list[tuple[float, float]]


def simplified(area: Any, tolerance: float) -> Any:
    """A valid area with fewer vertices that contains the given one, within a tolerance."""
    import shapely

    if tolerance == 0.0 or area.is_empty:
        return shapely.simplify(area, 0.0)
    share = _SHARE * tolerance
    grown = shapely.buffer(area, share, join_style="mitre", mitre_limit=math.sqrt(2.0))
    simple = shapely.simplify(grown, share)
    return simple if simple.covers(area) else shapely.union(simple, area)


def convex_pieces(area: Any) -> list[NDArray[np.float64]]:
    """Convex pieces (k, 2), counterclockwise, that have the area as their union.

    They are the triangles of a constrained Delaunay triangulation, united over their longest edges
    first while two pieces are convex together (after Hertel and Mehlhorn).
    """
    import shapely

    found = shapely.get_parts(shapely.constrained_delaunay_triangles(area))
    rings: list[Ring] = [[(x, y) for x, y in ring.tolist()] for ring in _triangles(found)]
    areas = [_area(ring) for ring in rings]
    parent = list(range(len(rings)))

    def piece_of(k: int) -> int:
        while parent[k] != k:
            parent[k] = parent[parent[k]]
            k = parent[k]
        return k

    for one, other in _shared_edges(rings):
        k, m = piece_of(one), piece_of(other)
        if k == m:
            continue
        hull, together = _hull(rings[k] + rings[m]), areas[k] + areas[m]
        if len(hull) <= MAX_CORNERS and _area(hull) <= together * (1.0 + _FLAT):
            parent[m] = k
            rings[k], areas[k] = hull, together
    return [np.array(rings[k]) for k in range(len(rings)) if parent[k] == k]


def _triangles(found: Any) -> NDArray[np.float64]:
    """Vertices of triangles, (m, 3, 2)."""
    import shapely

    return np.asarray(shapely.get_coordinates(found).reshape(-1, 4, 2)[:, :3])


def _shared_edges(rings: list[Ring]) -> list[tuple[int, int]]:
    """Pairs of triangles with a common edge, those with the longest edge first."""
    sides = defaultdict(list)
    for k, ring in enumerate(rings):
        for a, b in pairwise([*ring, ring[0]]):
            sides[min(a, b), max(a, b)].append(k)
    shared = [(math.dist(a, b), owners) for (a, b), owners in sides.items() if len(owners) == 2]
    shared.sort(key=lambda one: (-one[0], one[1]))
    return [(owners[0], owners[1]) for _, owners in shared]


def _area(ring: Ring) -> float:
    x0, y0 = ring[0]
    doubled = sum(
        (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0) for (x1, y1), (x2, y2) in pairwise(ring[1:])
    )
    return 0.5 * abs(doubled)


def _hull(points: Ring) -> Ring:
    """Convex hull, counterclockwise, without collinear vertices (monotone chain)."""
    ordered = sorted(set(points))
    halves = []
    for half in (ordered, ordered[::-1]):
        chain: Ring = []
        for x, y in half:
            while len(chain) > 1:
                (x1, y1), (x2, y2) = chain[-2:]
                if (x2 - x1) * (y - y1) - (x - x1) * (y2 - y1) > 0.0:
                    break
                chain.pop()
            chain.append((x, y))
        halves += chain[:-1]
    return halves


def grown(piece: NDArray[np.float64], margin: float) -> NDArray[np.float64]:
    """Convex sum of a piece (k, 2) and a square of half the edge ``margin``, counterclockwise."""
    corners = margin * np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    points = (piece[:, None] + corners).reshape(-1, 2)
    return np.array(_hull([(x, y) for x, y in points.tolist()]), np.float64)
