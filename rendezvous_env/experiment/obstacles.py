"""Discs, convex polygons, capsules and spheres; random fields of discs, spheres or walls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from .checks import is_whole, nearest_word, shown
from .obstacle_checks import (
    check_count,
    check_ends,
    check_length,
    check_point,
    check_polygon,
    check_radius,
    check_range,
    twice_area,
)
from .walls import WallField


@dataclass(frozen=True)
class Disc:
    """A round obstacle in the plane."""

    centre: tuple[float, float]
    """m."""
    radius: float
    """m."""
    dim = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", check_point("Disc", "centre", self.centre, 2))
        object.__setattr__(self, "radius", check_radius("Disc", self.radius))


@dataclass(frozen=True)
class Sphere:
    """A round obstacle in space."""

    centre: tuple[float, float, float]
    """m."""
    radius: float
    """m."""
    dim = 3

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", check_point("Sphere", "centre", self.centre, 3))
        object.__setattr__(self, "radius", check_radius("Sphere", self.radius))


@dataclass(frozen=True)
class Polygon:
    """A convex obstacle in the plane.

    Compose other shapes of several convex ones, and let them overlap: a robot is a point and finds
    its way along a seam.
    """

    vertices: tuple[tuple[float, float], ...]
    """Corners in m, kept counter-clockwise; the last is joined to the first."""
    dim = 2

    def __post_init__(self) -> None:
        vertices = check_polygon(self.vertices)
        if twice_area(vertices) < 0:
            vertices = (vertices[0], *reversed(vertices[1:]))
        object.__setattr__(self, "vertices", vertices)

    @property
    def centroid(self) -> tuple[float, float]:
        """Centre of the area, m."""
        (x0, y0), doubled = self.vertices[0], twice_area(self.vertices)
        x = y = 0.0
        for (x1, y1), (x2, y2) in pairwise(self.vertices[1:]):
            triangle = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
            x += triangle * (x1 - x0 + x2 - x0)
            y += triangle * (y1 - y0 + y2 - y0)
        return x0 + x / (3 * doubled), y0 + y / (3 * doubled)


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a segment, in the plane or in space: a wall with round ends, a
    fallen trunk.
    """

    ends: tuple[tuple[float, ...], tuple[float, ...]]
    """Both ends of the segment, m."""
    radius: float
    """m."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", check_ends(self.ends))
        object.__setattr__(self, "radius", check_radius("Capsule", self.radius))

    @property
    def dim(self) -> int:
        """Dimension of the space it is in."""
        return len(self.ends[0])


Obstacle = Disc | Sphere | Polygon | Capsule


@dataclass(frozen=True)
class ObstacleField:
    """Discs (in the plane) or spheres (in space), drawn anew for every episode."""

    count: int | tuple[int, int]
    """How many; a pair is an inclusive range to draw from."""
    radius: tuple[float, float]
    """Range that each radius is drawn from, m."""
    region: float
    """Edge length of the square or cube about the origin in which the centres lie, m."""
    keep_out: float
    """No robot starts nearer than this to a surface, m."""
    overlap: bool = True
    """Whether obstacles may overlap."""
    passage: float = 0.0
    """Every robot can reach every other through gaps at least this wide, m: a start where some are
    walled in is drawn again. 0, and always in space: that is not looked at."""

    def __post_init__(self) -> None:
        low, high = check_count(self.count)
        object.__setattr__(self, "count", low if is_whole(self.count) else (low, high))
        object.__setattr__(self, "radius", check_range("ObstacleField", "radius", self.radius))
        for field in ("region", "keep_out", "passage"):
            value = check_length("ObstacleField", field, getattr(self, field))
            object.__setattr__(self, field, value)
        if self.passage > 2 * self.keep_out:
            raise ValueError(
                f"obstacles: passage {shown(self.passage)} of an ObstacleField must be at most "
                f"twice keep_out, {2 * self.keep_out:g} m, or a start may lie within a gap"
            )
        if not isinstance(self.overlap, bool):
            raise ValueError(
                f"obstacles: overlap {shown(self.overlap)} of an ObstacleField must be True or "
                "False"
            )

    @property
    def count_range(self) -> tuple[int, int]:
        """Least and largest number of obstacles."""
        return (self.count, self.count) if isinstance(self.count, int) else self.count


Field = ObstacleField | WallField
"""What draws the obstacles of every episode."""
Obstacles = tuple[Obstacle, ...] | Field


def parse(value: Any, dim: int) -> Obstacles:
    """Obstacles of a scenario from whatever describes them.

    Args:
        value: an obstacle, a field, the plain data of ``to_plain`` for one, or a sequence of
            obstacles and their plain data.
        dim: dimension of the space, 2 or 3.

    Raises:
        ValueError: naming what is wrong and what would be right.
    """
    if isinstance(value, Mapping):
        value = _from_plain(value, dim)
    if isinstance(value, Field):
        return _checked_field(value, dim)
    listed = [value] if isinstance(value, Obstacle) else value
    if not isinstance(listed, Sequence) or isinstance(listed, str | bytes):
        raise ValueError(
            f"obstacles: {shown(value)} must be a sequence of obstacles, or an ObstacleField"
        )
    return tuple(_parse_entry(k, entry, dim) for k, entry in enumerate(listed))


def _checked_field(field: Field, dim: int) -> Field:
    if dim == 2:
        return field
    if isinstance(field, WallField):
        raise ValueError(f"obstacles: {shown(field)} is 2-D; in {dim}-D use an ObstacleField")
    if field.passage > 0:
        raise ValueError(
            f"obstacles: passage {field.passage:g} of an ObstacleField must be 0 in {dim}-D; who "
            "is walled in is known in the plane only"
        )
    return field


def to_plain(value: Obstacles) -> dict[str, Any] | list[dict[str, Any]]:
    """Plain data for TOML; ``parse`` turns it back into an equal value."""
    if isinstance(value, Field):
        return _plain(value)
    return [_plain(obstacle) for obstacle in value]


def max_count(value: Obstacles) -> int:
    """Largest number of obstacles that an episode can have."""
    if isinstance(value, WallField):
        return value.boxes
    return value.count_range[1] if isinstance(value, ObstacleField) else len(value)


_KINDS: dict[str, Callable[..., Obstacle | Field]] = {
    "disc": Disc,
    "sphere": Sphere,
    "polygon": Polygon,
    "capsule": Capsule,
    "field": ObstacleField,
    "walls": WallField,
}
_KEYS = {
    "disc": ("centre", "radius"),
    "sphere": ("centre", "radius"),
    "polygon": ("vertices",),
    "capsule": ("ends", "radius"),
    "field": ("count", "radius", "region", "keep_out", "overlap", "passage"),
    "walls": ("layout", "size", "opening", "thickness", "region", "keep_out"),
}
_OPTIONAL_KEYS = {"overlap", "passage"}


def _plain(value: Obstacle | Field) -> dict[str, Any]:
    kind = next(name for name, made in _KINDS.items() if type(value) is made)
    return {"kind": kind} | {key: _as_lists(getattr(value, key)) for key in _KEYS[kind]}


def _as_lists(value: Any) -> Any:
    return [_as_lists(entry) for entry in value] if isinstance(value, tuple) else value


def _as_tuples(value: Any, depth: int = 3) -> Any:
    """Lists of lists of lists as tuples; nothing that describes an obstacle is nested deeper."""
    if not isinstance(value, list) or depth == 0:
        return value
    return tuple(_as_tuples(entry, depth - 1) for entry in value)


def _from_plain(plain: Mapping[str, Any], dim: int) -> Obstacle | Field:
    """One obstacle or field; the kind may be left out, the keys tell it."""
    values = dict(plain)
    kind = values.pop("kind", None) or _kind_of(values, dim)
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ValueError(f"obstacles: kind {shown(kind)} must be one of {', '.join(_KINDS)}")
    for key in values:
        if key not in _KEYS[kind]:
            raise ValueError(_unknown_key(key, kind))
    if missing := [key for key in _KEYS[kind] if key not in values and key not in _OPTIONAL_KEYS]:
        raise ValueError(f"obstacles: a {kind} needs {missing[0]}")
    return _KINDS[kind](**{key: _as_tuples(value) for key, value in values.items()})


def _kind_of(values: Mapping[str, Any], dim: int) -> str:
    if "vertices" in values:
        return "polygon"
    if "ends" in values:
        return "capsule"
    if values.keys() & {"layout", "size", "opening", "thickness"}:
        return "walls"
    if values.keys() & {"count", "region", "keep_out", "overlap", "passage"}:
        return "field"
    return "disc" if dim == 2 else "sphere"


def _unknown_key(key: Any, kind: str) -> str:
    known = (*_KEYS[kind], "kind")
    nearest = nearest_word(key, known)
    hint = f"did you mean {nearest!r}?" if nearest else f"known keys are {', '.join(known)}"
    return f"obstacles: unknown key {shown(key)} of a {kind}; {hint}"


def _parse_entry(k: int, entry: Any, dim: int) -> Obstacle:
    if isinstance(entry, Mapping):
        entry = _from_plain(entry, dim)
    if isinstance(entry, Field):
        raise ValueError(f"obstacles[{k}]: a random field stands alone, not in a list")
    if not isinstance(entry, Obstacle):
        raise ValueError(
            f"obstacles[{k}]: {shown(entry)} must be a Disc, Polygon, Capsule or Sphere"
        )
    if entry.dim != dim:
        fitting = "Disc, Polygon or Capsule" if dim == 2 else "Sphere or Capsule"
        raise ValueError(
            f"obstacles[{k}]: {shown(entry)} is {entry.dim}-D; in {dim}-D use {fitting}"
        )
    return entry
