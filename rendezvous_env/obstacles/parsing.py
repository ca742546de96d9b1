"""Parse obstacles of a scenario from any description, and convert them to plain data."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any, get_args

from ..checks import choice, raise_invalid, short_repr
from ..field_checks import known_fields
from . import obstacle_set
from .disc import Disc, Sphere
from .fields import Field, ObstacleField
from .moving import Moving
from .obstacle_set import Obstacle
from .shape import DETAILS
from .walls import WallField

Obstacles = tuple[Obstacle, ...] | Field
_KINDS: dict[str, Callable[..., Obstacle | Field]] = {
    **{shape.__name__.lower(): shape for shape in get_args(Obstacle)},
    "field": ObstacleField,
    "walls": WallField,
}


def parse(value: Any, dim: int) -> Obstacles:
    """Parse obstacles of 2 or 3 dimensions.

    Accepts an obstacle, a field, the plain data of ``to_plain`` for one, or a sequence of obstacles
    and their plain data.
    """
    if isinstance(value, Mapping):
        value = _from_plain(value, dim)
    if isinstance(value, Field):
        value.check_dim(dim)
        return value
    listed = [value] if isinstance(value, Obstacle) else value
    if not isinstance(listed, Sequence) or isinstance(listed, str | bytes):
        raise_invalid("obstacles", value, "a sequence of obstacles, or an ObstacleField")
    return tuple(_parse_entry(f"obstacles[{k}]", entry, dim) for k, entry in enumerate(listed))


def _parse_entry(field: str, entry: Any, dim: int) -> Obstacle:
    if isinstance(entry, Mapping):
        entry = _from_plain(entry, dim)
    if isinstance(entry, Field):
        raise ValueError(f"{field}: a random field must be given alone, not in a list")
    if not isinstance(entry, Obstacle):
        wanted = "a Disc, Polygon, Capsule, Sphere or Moving, such as rv.Disc((0.0, 0.0), 1.0)"
        raise_invalid(field, entry, f"{wanted}, or a dict of its fields")
    if entry.dim != dim:
        fitting = "Disc, Polygon or Capsule" if dim == 2 else "Sphere or Capsule"
        raise ValueError(f"{field}: {short_repr(entry)} is {entry.dim}-D; in {dim}-D use {fitting}")
    return entry


def _from_plain(plain: Mapping[str, Any], dim: int) -> Obstacle | Field:
    values = dict(plain)
    kind = values.pop("kind", None)
    if kind is None:  # the kind with the most matching keys
        kinds = (kind for kind in _KINDS if kind != ("sphere" if dim == 2 else "disc"))
        kind = max(kinds, key=lambda kind: len(values.keys() & _keys(kind).keys()))
    keys = _keys(choice("obstacles: kind", kind, _KINDS))
    known_fields(values, (*keys, "kind"), f"obstacles: a {kind}", "key")
    if missing := [key for key, needed in keys.items() if needed and key not in values]:
        raise ValueError(f"obstacles: a {kind} needs {missing[0]}")
    if kind == "moving" and isinstance(values["shape"], Mapping):
        values["shape"] = _from_plain(values["shape"], dim)
    return _KINDS[kind](**values)


def _keys(kind: str) -> dict[str, bool]:
    """Keys of a kind in files, and whether each is required."""
    return {field.name: field.default is MISSING for field in fields(_KINDS[kind])}  # type: ignore[arg-type]


def to_plain(value: Obstacles) -> dict[str, Any] | list[dict[str, Any]]:
    """Plain data for TOML, from which ``parse`` restores an equal value."""
    return _plain(value) if isinstance(value, Field) else [_plain(obstacle) for obstacle in value]


def _plain(value: Obstacle | Field) -> dict[str, Any]:
    if isinstance(value, Moving):
        given = {key: getattr(value, key) for key in _keys("moving")}
        default = {"repeat": True, "interval": Moving.interval}
        kept = {k: v for k, v in given.items() if v is not None and v != default.get(k)}
        kept["shape"] = _plain(value.shape)
        return {"kind": "moving"} | {key: _as_lists(entry) for key, entry in kept.items()}
    kind = next(name for name, made in _KINDS.items() if type(value) is made)
    return {"kind": kind} | {key: _as_lists(getattr(value, key)) for key in _keys(kind)}


def _as_lists(value: Any) -> Any:
    return [_as_lists(entry) for entry in value] if isinstance(value, tuple) else value


def max_count(value: Obstacles) -> int:
    """Maximum number of obstacles in an episode."""
    return value.most if isinstance(value, Field) else len(value)


def row_width(value: Obstacles) -> int:
    """Number of table columns of a scenario's obstacles: the minimum for the largest."""
    if isinstance(value, Field):
        return DETAILS + value.numbers
    return obstacle_set.row_width(value)


def only_balls(value: Obstacles) -> bool:
    """True if a scenario's obstacles are discs or spheres, sampled or given."""
    if isinstance(value, Field):
        return value.only_balls
    shapes = (one.shape if isinstance(one, Moving) else one for one in value)
    return all(isinstance(shape, Disc | Sphere) for shape in shapes)
