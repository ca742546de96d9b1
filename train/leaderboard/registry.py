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
    num_envs: int = 64  # number of parallel environments


@dataclass(frozen=True)
class Algorithm:
    """One row of the leaderboard.

    A new algorithm is a module in ``train/leaderboard/algorithms`` that defines ``ALGORITHM``,
    named as the file with hyphens, or ``ALGORITHMS``, a mapping by name.
    """

    about: str  # one-line description
    safety: str  # safety mechanism, in a word or two
    guarantee: Literal["none", "heading", "tank"]  # guarantee: none, theorem C or theorem D
    given: str  # inputs: "bearings", or others
    learn: Callable[
        [Scenario, int, Budget], tuple[Callable[[int], EvaluationSetup], dict[str, Any]]
    ]
    """(scenario, seed, budget) → (factory of a player for a number of environments, settings as
    plain data). An algorithm without training returns immediately."""
    fits: Callable[[Scenario], bool]  # whether it supports a scenario
    learns: bool = True  # whether seed and budget matter; otherwise one seed is run
    packages: tuple[str, ...] = ()  # required distributions; their versions are in its records

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
