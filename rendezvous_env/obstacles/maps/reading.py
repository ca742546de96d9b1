"""Obstacles from map files: ``from_map``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ...checks import check_int, choice, number, positive, raise_invalid, short_repr, text
from ...limits import MAX_OBSTACLES
from . import movingai, polygons, ros
from .grid import Area
from .obstacle_map import ObstacleMap, shapes_of

ENDINGS = {
    ".yaml": "a ROS map_server map",
    ".yml": "a ROS map_server map",
    ".map": "a MovingAI map",
    ".wkt": "WKT polygons",
    ".geojson": "GeoJSON polygons",
    ".json": "GeoJSON polygons",
}
"""Endings of map files, and their formats."""
MAX_SHAPES = 2000
"""Default of ``max_shapes``."""
OPTIONS = ("tolerance", "unknown", "min_occupancy", "cell_size", "passable", "max_shapes")
"""Options of ``from_map``."""


def from_map(
    path: str | os.PathLike[str],
    *,
    tolerance: float = 0.0,
    unknown: str = "occupied",
    min_occupancy: float = 50.0,
    cell_size: float = 1.0,
    passable: str = ".GS",
    max_shapes: int = MAX_SHAPES,
) -> ObstacleMap:
    """Obstacles of a map file, as few convex polygons that overlap slightly.

    The format follows from the ending: ``.yaml`` or ``.yml`` for ROS maps, ``.map`` for MovingAI
    maps, ``.wkt``, and ``.geojson`` or ``.json``. Polygons of the last two are obstacles, in
    metres. A wall closes the border of a grid.

    Simplification is conservative: obstacles contain everything that is occupied in the map, and
    are larger by at most ``tolerance`` + 0.03 mm. Passages narrower than twice that may close.

    Args:
        path: the map file.
        tolerance: maximum distance by which simplified outlines exceed the map, m.
        unknown: "occupied" or "free": meaning of unknown cells of ROS maps.
        min_occupancy: occupancy in percent from which cells of ROS maps in the modes scale and raw
            are obstacles.
        cell_size: edge of a cell of a MovingAI map, m.
        passable: characters of a MovingAI map that are no obstacles.
        max_shapes: maximum number of polygons.

    Raises:
        FileNotFoundError: if the file does not exist.
        ValueError: for an invalid file, with the line or field, its value and a remedy; or if there
            are more shapes than ``max_shapes``.
        ImportError: for a ROS map without the extra ``maps``.
    """
    if not isinstance(path, str | os.PathLike):
        raise_invalid("path", path, f"the path of a map: {', '.join(ENDINGS)}")
    margin = number("tolerance", tolerance, 0.0, unit="m")
    most = check_int("max_shapes", max_shapes, 1, MAX_OBSTACLES)
    options = {
        "unknown": choice("unknown", unknown, ("occupied", "free")),
        "min_occupancy": number("min_occupancy", min_occupancy, 1e-6, 100.0, "percent"),
        "cell_size": positive("cell_size", cell_size, "m"),
        "passable": text("passable", passable),
    }
    return shapes_of(str(path), _area(Path(path), options), margin, most)


def _area(path: Path, options: dict[str, Any]) -> Area:
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        known = ", ".join(ENDINGS)
        remedy = "give the YAML file of the image" if ending in (".pgm", ".png") else ""
        remedy = remedy or f"known endings are {known}"
        raise ValueError(f"path is {short_repr(str(path))}; {remedy}")
    if ending in (".yaml", ".yml"):
        return ros.read(path, options["unknown"], options["min_occupancy"])
    if ending == ".map":
        return movingai.read(path, options["cell_size"], options["passable"])
    return polygons.read(path)
