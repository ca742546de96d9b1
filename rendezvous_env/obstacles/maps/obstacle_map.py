"""Obstacles of a map, and the region of initial positions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ...checks import counted, is_sequence, number, raise_invalid, to_float
from ...limits import MAX_OBSTACLES
from ..polygon import Polygon
from ..shape import LEAST_THICKNESS
from .convex import convex_pieces, grown, simplified
from .grid import Area

GROWTH = 2 * LEAST_THICKNESS
"""Length by which every shape exceeds its piece of the map along both axes, m: shapes overlap
without seams."""
_SEGMENTS = 2  # chords of a quarter circle
_SIMPLER = 0.25  # of the clearance; tolerance of the outline of a start region
_BORDER = 2.0  # thickness of the walls around a grid, cells


@dataclass(frozen=True, repr=False)
class ObstacleMap(Sequence[Polygon]):
    """Obstacles of a map, as a sequence of polygons for ``Scenario.obstacles``."""

    source: str
    """File of the map."""
    shapes: tuple[Polygon, ...]
    """Convex polygons, m; their union is the obstacles."""
    bounds: tuple[float, float, float, float]
    """Extent of the map: least x and y, largest x and y, m."""
    _area: Area = field(compare=False)

    @overload
    def __getitem__(self, index: int) -> Polygon: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Polygon, ...]: ...

    def __getitem__(self, index: int | slice) -> Polygon | tuple[Polygon, ...]:
        return self.shapes[index]

    def __len__(self) -> int:
        return len(self.shapes)

    def __repr__(self) -> str:
        return f"<ObstacleMap of {self.source}, {counted(len(self), 'shape')}>"

    @property
    def spawn_size(self) -> float:
        """Edge of the square about the origin that contains the map, m."""
        return 2.0 * max(map(abs, self.bounds))

    def free_region(
        self, clearance: float, near: tuple[float, float] | None = None
    ) -> tuple[Polygon, ...]:
        """One connected region for ``Scenario.start_region``, as disjoint convex polygons.

        Robots pass between any two of its points at a distance of ``clearance`` to all obstacles.

        Args:
            clearance: minimum distance to obstacles, m, positive.
            near: a point of the region, m; None selects the largest region.

        Raises:
            ValueError: if no such region exists.
        """
        least = number("clearance", clearance, LEAST_THICKNESS, unit="m")
        pieces = []
        for piece in convex_pieces(self._connected(least, near)):
            vertices = self._area.pose.apply(piece)
            if _is_thick(vertices):
                pieces.append(Polygon(tuple(map(tuple, vertices.tolist()))))
        return tuple(pieces)

    def scenario_fields(
        self, clearance: float, near: tuple[float, float] | None = None
    ) -> dict[str, Any]:
        """Fields of a scenario with these obstacles and this start region, see ``free_region``."""
        return {
            "obstacles": self.shapes,
            "start_region": self.free_region(clearance, near),
            "spawn_size": self.spawn_size,
        }

    def _connected(self, clearance: float, near: tuple[float, float] | None) -> Any:
        """Connected free area at a distance from obstacles, in the frame of the map."""
        import shapely

        area, scale = self._area, self._area.pose.scale
        # arcs are chords, and shapes are larger than the map by at most √2 GROWTH
        reach = (clearance + 2.0 * GROWTH) / scale
        radius = reach / math.cos(0.25 * math.pi / _SEGMENTS)
        blocked = shapely.buffer(area.occupied, radius, quad_segs=_SEGMENTS)
        blocked = simplified(blocked, _SIMPLER * clearance / scale)
        whole = shapely.box(*area.bounds)
        if area.bordered:
            whole = shapely.buffer(whole, -reach, join_style="mitre")
        free = shapely.difference(whole, blocked)
        regions = [part for part in shapely.get_parts(free) if part.area > 0.0]
        if not regions:
            raise ValueError(
                f"{self.source}: no point is clearance = {clearance:g} m away from obstacles; "
                "it must be smaller"
            )
        if near is None:
            return max(regions, key=lambda part: part.area)
        point = tuple(map(to_float, near)) if is_sequence(near) else ()
        if len(point) != 2 or not all(map(math.isfinite, point)):
            raise_invalid("near", near, "None or a point of two numbers, m")
        place = shapely.Point(*area.pose.invert(np.array(point)))
        for part in regions:
            if part.intersects(place):
                return part
        raise_invalid("near", near, f"a point at least {clearance:g} m from obstacles, in the map")


def _is_thick(vertices: NDArray[np.float64]) -> bool:
    """True if a piece is thick enough for a ``Polygon``; thinner ones are negligible."""
    import shapely

    return not shapely.Polygon(vertices).buffer(-2.0 * LEAST_THICKNESS).is_empty


def shapes_of(source: str, area: Area, tolerance: float, most: int) -> ObstacleMap:
    """Obstacles of an area, simplified within a tolerance, m; at most ``most`` shapes."""
    pose, scale = area.pose, area.pose.scale
    area = area._replace(occupied=simplified(area.occupied, tolerance / scale))
    pieces = convex_pieces(area.occupied)
    if area.bordered:
        pieces += _border(area.bounds)
    if len(pieces) > most:
        finer = max(2.0 * tolerance, (1.0 if area.bordered else 0.01) * scale)
        remedy = f"tolerance (now {tolerance:g} m) coarser, such as {finer:g} m"
        if most < MAX_OBSTACLES:
            remedy += f", or max_shapes larger, at most {MAX_OBSTACLES}"
        raise ValueError(
            f"{source}: the map has {len(pieces)} shapes, more than max_shapes = {most}; "
            f"make {remedy}"
        )
    outlines = (pose.apply(grown(piece, GROWTH / scale)) for piece in pieces)
    shapes = tuple(Polygon(_distinct(outline)) for outline in outlines)
    x0, y0, x1, y1 = area.bounds
    corners = pose.apply(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]))
    bounds = tuple(map(float, (*corners.min(axis=0), *corners.max(axis=0))))
    return ObstacleMap(source, shapes, bounds, area)  # type: ignore[arg-type]


def _border(bounds: tuple[float, float, float, float]) -> list[NDArray[np.float64]]:
    """Walls around a grid, beyond which the map is unknown."""
    x0, y0, x1, y1 = bounds
    w = _BORDER
    boxes = (
        (x0 - w, y0 - w, x1 + w, y0),
        (x0 - w, y1, x1 + w, y1 + w),
        (x0 - w, y0 - w, x0, y1 + w),
        (x1, y0 - w, x1 + w, y1 + w),
    )
    return [np.array([(a, b), (c, b), (c, d), (a, d)], np.float64) for a, b, c, d in boxes]


def _distinct(outline: NDArray[np.float64]) -> tuple[tuple[float, float], ...]:
    """Vertices of an outline without those that nearly repeat the one before.

    The outline then recedes by less than it has grown.
    """
    kept: list[Any] = []
    for vertex in outline:
        if not kept or np.hypot(*(vertex - kept[-1])) > LEAST_THICKNESS:
            kept.append(vertex)
    if len(kept) > 3 and np.hypot(*(kept[-1] - kept[0])) <= LEAST_THICKNESS:
        kept.pop()
    return tuple(tuple(vertex.tolist()) for vertex in kept)
