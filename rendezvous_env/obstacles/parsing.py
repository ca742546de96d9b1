"""Obstacles of a scenario from whatever describes them, and back as plain data for files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any

from ..checks import known_fields, shown
from . import obstacle_set, shape
from .disc import Disc, Sphere
from .fields import Field, ObstacleField
from .obstacle_set import SHAPES, Obstacle
from .walls import BOX, WallField

Obstacles = tuple[Obstacle, ...] | Field
_KINDS: dict[str, Callable[..., Obstacle | Field]] = {
    **SHAPES,
    "field": ObstacleField,
    "walls": WallField,
}


def parse(value: Any, dim: int) -> Obstacles:
    """Obstacles of a space of 2 or 3 dimensions from whatever describes them: an obstacle, a field,
    the plain data of ``to_plain`` for one, or a sequence of obstacles and their plain data.

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


def row_width(value: Obstacles) -> int:
    """Columns of the table of a scenario's obstacles: as few as the largest of them needs."""
    if isinstance(value, WallField):
        return shape.DETAILS + BOX
    return obstacle_set.row_width(() if isinstance(value, Field) else value)


def only_balls(value: Obstacles) -> bool:
    """Whether a scenario's obstacles are discs or spheres, however they are drawn."""
    if isinstance(value, Field):
        return isinstance(value, ObstacleField)
    return all(isinstance(obstacle, Disc | Sphere) for obstacle in value)


def _keys(kind: str) -> dict[str, bool]:
    """Keys of a kind in files, and whether each is needed."""
    return {field.name: field.default is MISSING for field in fields(_KINDS[kind])}  # type: ignore[arg-type]


def _plain(value: Obstacle | Field) -> dict[str, Any]:
    kind = next(name for name, made in _KINDS.items() if type(value) is made)
    return {"kind": kind} | {key: _as_lists(getattr(value, key)) for key in _keys(kind)}


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
    kind = values.pop("kind", None)
    if kind is None:
        kind = _kind_of(values, dim)
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ValueError(f"obstacles: kind {shown(kind)} must be one of {', '.join(_KINDS)}")
    keys = _keys(kind)
    known_fields(values, (*keys, "kind"), f"obstacles: a {kind}", "key")
    if missing := [key for key, needed in keys.items() if needed and key not in values]:
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


def _parse_entry(k: int, entry: Any, dim: int) -> Obstacle:
    if isinstance(entry, Mapping):
        entry = _from_plain(entry, dim)
    if isinstance(entry, Field):
        raise ValueError(f"obstacles[{k}]: a random field stands alone, not in a list")
    if not isinstance(entry, Obstacle):
        raise ValueError(
            f"obstacles[{k}]: {shown(entry)} must be a Disc, Polygon, Capsule or Sphere, such as "
            "rv.Disc((0.0, 0.0), 1.0), or a dict of its fields"
        )
    if entry.dim != dim:
        fitting = "Disc, Polygon or Capsule" if dim == 2 else "Sphere or Capsule"
        raise ValueError(
            f"obstacles[{k}]: {shown(entry)} is {entry.dim}-D; in {dim}-D use {fitting}"
        )
    return entry
