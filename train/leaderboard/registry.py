"""What an algorithm is; the files in ``algorithms`` have them."""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import Distribution
from typing import Any, Literal

from rendezvous_env.scenario.scenario import Scenario

from ..checks import UserError, unknown
from .playing import Player


@dataclass(frozen=True)
class Budget:
    """How much a learner may learn."""

    decisions: int  # of single robots
    num_teams: int = 64  # environments side by side


@dataclass(frozen=True)
class Algorithm:
    """One row of the leaderboard.

    A new one is a file in ``train/leaderboard/algorithms`` that ends with ``ALGORITHM`` and has its
    name, with hyphens; or with ``ALGORITHMS``, several by name.
    """

    about: str  # what it is, in a line
    safety: str  # its way of being safe, in a word or two
    guarantee: Literal["none", "heading", "tank"]  # proven: nothing, theorem C or theorem D
    given: str  # what it reads: "bearings", or what else
    learn: Callable[[Scenario, int, Budget], tuple[Callable[[int], Player], dict[str, Any]]]
    """From field, seed and budget: what makes a player of so many teams, and its settings as plain
    data. What does not learn makes the player at once."""
    fits: Callable[[Scenario], bool]  # whether it can be had on a field
    learns: bool = True  # whether its seed and budget matter; else one seed is played
    packages: tuple[str, ...] = ()  # distributions it needs; their versions are on its cards

    @property
    def missing(self) -> list[str]:
        """Those of its packages that are not installed."""
        return [name for name in self.packages if not any(Distribution.discover(name=name))]


@cache
def known() -> dict[str, Algorithm]:
    """All algorithms by name."""
    found: dict[str, Algorithm] = {}
    algorithms = importlib.import_module(f"{__package__}.algorithms")  # which import this file
    for module in pkgutil.iter_modules(algorithms.__path__):
        loaded: Any = importlib.import_module(f"{algorithms.__name__}.{module.name}")
        one = {module.name.replace("_", "-"): getattr(loaded, "ALGORITHM", None)}
        found |= getattr(loaded, "ALGORITHMS", one)
    return {name: found[name] for name in sorted(found)}


def find(name: str) -> Algorithm:
    """The algorithm of a name; a UserError for an unknown one, or if a package is missing."""
    if name not in known():
        raise unknown("algorithm", name, known())
    if missing := known()[name].missing:
        raise UserError(
            f"algorithm {name!r} needs {', '.join(missing)}; pip install {' '.join(missing)}"
        )
    return known()[name]
