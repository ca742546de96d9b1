"""Comparison of policies on the same initial conditions: evaluation, statistics, tables.

``Config``, ``run``, ``plan`` and the other names of the command are imported on first access.
"""

from importlib import import_module
from typing import Any

_NAMES = ("Config", "Job", "Played", "plan", "play_job", "run", "summary")


def __getattr__(name: str) -> Any:
    """Import a name of the command from ``compare.compare``."""
    if name in _NAMES:
        return getattr(import_module(f"{__name__}.compare"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
