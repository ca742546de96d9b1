"""Obstacles: shapes, their union, random fields, and obstacles from maps (``from_map``)."""

from importlib import import_module as _import_module
from typing import Any as _Any


def __getattr__(name: str) -> _Any:
    """Load ``from_map`` and ``ObstacleMap`` on first use; maps need other libraries."""
    if name in ("from_map", "ObstacleMap"):
        return getattr(_import_module(f"{__name__}.maps"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
