"""Discs, convex polygons and spheres; random fields of them; their packed rows."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from ..equations.geometry import (
    ABSENT,
    CENTRE,
    COUNT,
    RADIUS,
    ROUND,
    centre_distance,
    obstacle_distance,
)
from ..equations.random_streams import uniform
from .obstacle_checks import (
    check_count,
    check_length,
    check_point,
    check_polygon,
    check_radius,
    check_radius_range,
    twice_area,
)

_TRIES_PER_OBSTACLE = 1000


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


Obstacle = Disc | Sphere | Polygon


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

    def __post_init__(self) -> None:
        low, high = check_count(self.count)
        object.__setattr__(self, "count", low if isinstance(self.count, int) else (low, high))
        object.__setattr__(self, "radius", check_radius_range(self.radius))
        object.__setattr__(self, "region", check_length("region", self.region))
        object.__setattr__(self, "keep_out", check_length("keep_out", self.keep_out))
        if not isinstance(self.overlap, bool):
            raise ValueError(
                f"obstacles: overlap {self.overlap!r} of an ObstacleField must be True or False"
            )

    @property
    def count_range(self) -> tuple[int, int]:
        """Least and largest number of obstacles."""
        return (self.count, self.count) if isinstance(self.count, int) else self.count


Obstacles = tuple[Obstacle, ...] | ObstacleField


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
    if isinstance(value, ObstacleField):
        return value
    listed = [value] if isinstance(value, Obstacle) else value
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        raise ValueError(
            f"obstacles: {value!r} must be a sequence of obstacles, or an ObstacleField"
        )
    return tuple(_parse_entry(k, entry, dim) for k, entry in enumerate(listed))


def to_plain(value: Obstacles) -> dict[str, Any] | list[dict[str, Any]]:
    """Plain data for TOML; ``parse`` turns it back into an equal value."""
    if isinstance(value, ObstacleField):
        return _plain(value)
    return [_plain(obstacle) for obstacle in value]


def max_count(value: Obstacles) -> int:
    """Largest number of obstacles that an episode can have."""
    return value.count_range[1] if isinstance(value, ObstacleField) else len(value)


def row_width(value: Obstacles, dim: int) -> int:
    """Width of the packed rows: 2 + d + 2 · (most vertices of a polygon)."""
    polygons = [] if isinstance(value, ObstacleField) else value
    return (
        2 + dim + 2 * max((len(p.vertices) for p in polygons if isinstance(p, Polygon)), default=0)
    )


def check_outside(field: str, positions: NDArray[np.float64], value: Sequence[Obstacle]) -> None:
    """Refuse positions inside obstacles.

    Args:
        field: what the message calls the positions.
        positions: (n, d), m.
        value: obstacles.

    Raises:
        ValueError: naming the first robot and its obstacle.
    """
    positions = np.asarray(positions, dtype=np.float64)
    rows = pack(value, positions.shape[1], len(value))
    for i, position in enumerate(positions):
        for obstacle, row in zip(value, rows, strict=True):
            if (distance := obstacle_distance(row, position)) < 0:
                raise ValueError(
                    f"{field}: robot_{i} at {position.tolist()} is {-distance:.6g} m inside "
                    f"{obstacle}; it must be outside"
                )


def pack(
    obstacles: Sequence[Obstacle], dim: int, slots: int, width: int | None = None
) -> NDArray[np.float64]:
    """Obstacles as an array for the kernels; what a row holds is told in ``geometry``.

    Args:
        obstacles: at most ``slots``.
        dim: dimension of the space.
        slots: M, rows of the array; those left over are absent.
        width: of a row; as narrow as possible if not given.

    Returns:
        (M, width) array.

    Raises:
        ValueError: if there are more obstacles, or more vertices, than there is room for.
    """
    obstacles = tuple(obstacles)
    needed = row_width(obstacles, dim)
    width = needed if width is None else width
    if len(obstacles) > slots:
        raise ValueError(f"obstacles: {len(obstacles)} were given, there is room for {slots}")
    if needed > width:
        raise ValueError(
            f"obstacles: a polygon has {(needed - 2 - dim) // 2} vertices, "
            f"there is room for {(width - 2 - dim) // 2}"
        )
    rows = np.zeros((slots, width))
    rows[:, COUNT] = ABSENT
    for row, obstacle in zip(rows, obstacles, strict=False):
        _pack_one(row, obstacle)
    return rows


def _pack_one(row: NDArray[np.float64], obstacle: Obstacle) -> None:
    if isinstance(obstacle, Polygon):
        centre, corners = np.array(obstacle.centroid), np.array(obstacle.vertices)
        row[COUNT] = len(corners)
        row[RADIUS] = np.linalg.norm(corners - centre, axis=1).max()
        row[CENTRE : CENTRE + 2] = centre
        row[CENTRE + 2 : CENTRE + 2 + corners.size] = corners.ravel()
    else:
        row[COUNT], row[RADIUS] = ROUND, obstacle.radius
        row[CENTRE : CENTRE + obstacle.dim] = obstacle.centre


_KINDS: dict[str, Callable[..., Obstacle | ObstacleField]] = {
    "disc": Disc,
    "sphere": Sphere,
    "polygon": Polygon,
    "field": ObstacleField,
}
_KEYS = {
    "disc": ("centre", "radius"),
    "sphere": ("centre", "radius"),
    "polygon": ("vertices",),
    "field": ("count", "radius", "region", "keep_out", "overlap"),
}
_OPTIONAL_KEYS = {"overlap"}


def _plain(value: Obstacle | ObstacleField) -> dict[str, Any]:
    kind = next(name for name, made in _KINDS.items() if type(value) is made)
    return {"kind": kind} | {key: _as_lists(getattr(value, key)) for key in _KEYS[kind]}


def _as_lists(value: Any) -> Any:
    return [_as_lists(entry) for entry in value] if isinstance(value, tuple) else value


def _as_tuples(value: Any) -> Any:
    return tuple(_as_tuples(entry) for entry in value) if isinstance(value, list) else value


def _from_plain(plain: Mapping[str, Any], dim: int) -> Obstacle | ObstacleField:
    """One obstacle or field; the kind may be left out, the keys tell it."""
    values = dict(plain)
    kind = values.pop("kind", None) or _kind_of(values, dim)
    if kind not in _KINDS:
        raise ValueError(f"obstacles: kind {kind!r} must be one of {', '.join(_KINDS)}")
    for key in values:
        if key not in _KEYS[kind]:
            raise ValueError(_unknown_key(key, kind))
    if missing := [key for key in _KEYS[kind] if key not in values and key not in _OPTIONAL_KEYS]:
        raise ValueError(f"obstacles: a {kind} needs {missing[0]}")
    return _KINDS[kind](**{key: _as_tuples(value) for key, value in values.items()})


def _kind_of(values: Mapping[str, Any], dim: int) -> str:
    if "vertices" in values:
        return "polygon"
    if values.keys() & {"count", "region", "keep_out", "overlap"}:
        return "field"
    return "disc" if dim == 2 else "sphere"


def _unknown_key(key: str, kind: str) -> str:
    known = (*_KEYS[kind], "kind")
    nearest = difflib.get_close_matches(key, known, n=1)
    hint = f"did you mean {nearest[0]!r}?" if nearest else f"known keys are {', '.join(known)}"
    return f"obstacles: unknown key {key!r} of a {kind}; {hint}"


def _parse_entry(k: int, entry: Any, dim: int) -> Obstacle:
    if isinstance(entry, Mapping):
        entry = _from_plain(entry, dim)
    if isinstance(entry, ObstacleField):
        raise ValueError(f"obstacles[{k}]: an ObstacleField stands alone, not in a list")
    if not isinstance(entry, Obstacle):
        raise ValueError(f"obstacles[{k}]: {entry!r} must be a Disc, Polygon or Sphere")
    if entry.dim != dim:
        fitting = "Disc or Polygon" if dim == 2 else "Sphere"
        raise ValueError(f"obstacles[{k}]: {entry} is {entry.dim}-D; in {dim}-D use {fitting}")
    return entry


@kernel
def draw_field(
    key,
    count_low,
    count_high,
    radius_low,
    radius_high,
    region,
    keep_out,
    overlap,
    starts,
    n_starts,
    out,
):
    """Draw the discs or spheres of one episode.

    A draw that comes too near to a start, or overlaps where it must not, is replaced by another.

    Args:
        key: random stream, uint64.
        count_low: least number of obstacles.
        count_high: largest number, at most M.
        radius_low: least radius, m.
        radius_high: largest radius, m.
        region: edge length of the square or cube about the origin that holds the centres, m.
        keep_out: least distance of a start from a surface, m.
        overlap: whether obstacles may overlap.
        starts: (n, d) start positions, m; only the first ``n_starts`` count.
        n_starts: number of starts to keep clear of.
        out: (M, width) array for the packed rows.

    Returns:
        False if an obstacle found no place in 1000 tries; the rows from there on are then absent.
    """
    d = starts.shape[1]
    out[:] = 0.0
    out[:, COUNT] = ABSENT
    count = count_low + int(uniform(key, 0) * (count_high - count_low + 1))
    counter = 1
    for m in range(count):
        placed = False
        for _ in range(_TRIES_PER_OBSTACLE):
            _draw_ball(key, counter, radius_low, radius_high, region, d, out[m])
            counter += 1 + d
            if _keeps_out(out[m], starts, n_starts, keep_out) and (overlap or _apart(out, m, d)):
                placed = True
                break
        if not placed:
            out[m, COUNT] = ABSENT
            return False
    return True


@kernel
def _draw_ball(key, counter, radius_low, radius_high, region, d, row):
    row[COUNT] = ROUND
    row[RADIUS] = radius_low + (radius_high - radius_low) * uniform(key, counter)
    for k in range(d):
        row[CENTRE + k] = region * (uniform(key, counter + 1 + k) - 0.5)


@kernel
def _keeps_out(row, starts, n_starts, keep_out):
    for i in range(n_starts):
        if obstacle_distance(row, starts[i]) < keep_out:
            return False
    return True


@kernel
def _apart(rows, m, d):
    """Whether ball m overlaps none of those before it."""
    centre = rows[m, CENTRE : CENTRE + d]
    for other in range(m):
        if centre_distance(rows[other], centre) < rows[m, RADIUS] + rows[other, RADIUS]:
            return False
    return True
