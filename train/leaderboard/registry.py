"""Interface of an algorithm; the modules in ``algorithms`` provide them."""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import Distribution
from typing import Any, Literal

from rendezvous_env.scenario.scenario import Scenario

from ..checks import UserError, current_policy, unknown_name
from .playing import EvaluationSetup


@dataclass(frozen=True)
class Budget:
    """Training budget."""

    decisions: int  # of single robots
    num_envs: int = 64  # environments side by side


@dataclass(frozen=True)
class Algorithm:
    """One row of the leaderboard.

    A new algorithm is a module in ``train/leaderboard/algorithms`` that defines ``ALGORITHM``,
    named as the file with hyphens, or ``ALGORITHMS``, a mapping by name.
    """

    about: str  # what it is, in a line
    safety: str  # its way of being safe, in a word or two
    guarantee: Literal["none", "heading", "tank"]  # proven: nothing, theorem C or theorem D
    given: str  # what it reads: "bearings", or what else
    learn: Callable[
        [Scenario, int, Budget], tuple[Callable[[int], EvaluationSetup], dict[str, Any]]
    ]
    """(scenario, seed, budget) → (factory of a player for a number of environments, settings as
    plain data). An algorithm without training returns immediately."""
    fits: Callable[[Scenario], bool]  # whether it can be had on a field
    learns: bool = True  # whether its seed and budget matter; else one seed is played
    packages: tuple[str, ...] = ()  # distributions it needs; their versions are in its records

    @property
    def missing(self) -> list[str]:
        """Required packages that are not installed."""
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
    """Algorithm by name, also a deprecated one.

    Raises:
        UserError: if it is unknown or a package is missing.
    """
    name = current_policy(name)
    if name not in known():
        raise unknown_name("algorithm", name, known())
    if missing := known()[name].missing:
        raise UserError(
            f"algorithm {name!r} needs {', '.join(missing)}; pip install {' '.join(missing)}"
        )
    return known()[name]
