"""What an algorithm is; every file in ``algorithms`` is one."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from rendezvous_env.scenario.scenario import Scenario

from ..checks import UserError
from .playing import Player


@dataclass(frozen=True)
class Budget:
    """How much a learner may learn."""

    decisions: int
    """Of single robots."""
    num_teams: int = 64
    """Environments side by side."""


@dataclass(frozen=True)
class Algorithm:
    """One row of the leaderboard.

    A new one is a file in ``train/leaderboard/algorithms`` that ends with ``ALGORITHM``; its name
    is that of the file, with hyphens.
    """

    about: str
    """What it is, in a line."""
    safety: str
    """Its way of being safe, in a word or two."""
    guarantee: Literal["none", "heading", "tank"]
    """What is proven of it: nothing, theorem C or theorem D."""
    given: str
    """What it reads: "bearings", or what else."""
    learn: Callable[[Scenario, int, Budget], tuple[Callable[[int], Player], dict[str, Any]]]
    """From field, seed and budget: what makes a player of so many teams, and its settings as plain
    data. What does not learn makes the player at once."""
    fits: Callable[[Scenario], bool]
    """Whether it can be had on a field."""
    learns: bool = True
    """Whether its seed and budget matter; else one seed is played."""


@cache
def known() -> dict[str, Algorithm]:
    """All algorithms by name."""
    found = {}
    algorithms = importlib.import_module(f"{__package__}.algorithms")  # which import this file
    for module in pkgutil.iter_modules(algorithms.__path__):
        loaded = importlib.import_module(f"{algorithms.__name__}.{module.name}")
        if (own := getattr(loaded, "ALGORITHM", None)) is not None:
            found[module.name.replace("_", "-")] = own
    return found


def find(name: str) -> Algorithm:
    """The algorithm of a name.

    Raises:
        UserError: for an unknown one.
    """
    if name not in known():
        raise UserError(f"algorithm {name!r} is unknown; known are {', '.join(known())}")
    return known()[name]
