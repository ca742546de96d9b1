"""What a theorem is here: what it assumes, in predicates that say what fails, and its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from ...scenario.scenario import Scenario

CHOICES = ("law", "heading", "tank", "gains", "links")
"""What keeps the guarantee: law (1) itself, certified headings, an energy tank, gains that are not
negative, or velocities that lengthen no link."""


class Asked(NamedTuple):
    """The arguments of a certificate besides the scenario."""

    by: str
    min_alignment: float
    """ε, without unit."""
    budget: float
    """B_i, m²/s."""
    min_gain: float | None
    max_gain: float | None
    share: float
    """λ, without unit."""
    error: float
    """η, rad, the larger of the argument and of the scenario's sensor."""


@dataclass(frozen=True)
class Bounds:
    """What a theorem promises of a scenario; a number is infinite where it promises none."""

    words: str = ""
    """The promise, its theorem first; or why there is none for this error."""
    meets: bool = False
    """Whether a rendezvous is promised."""
    time: float = math.inf
    """When one robot is left, s, inputs held over the scenario's step."""
    continuous_time: float = math.inf
    """The same where velocities follow the bearings in continuous time, s."""
    expected_time: float = math.inf
    """Of the mean time to rendezvous, s."""
    lyapunov: float = math.inf
    """Of V at any time, m²/s; with obstacles in motion without a contact."""
    hull: float = math.inf
    """Of L at any time, m."""
    link_growth: float = math.inf
    """Of how much longer a link ever is than at the start, m."""
    tolerated_bearing_error: float = 0.0
    """η, rad: any less leaves a finite time."""


def too_wrong(asked: Asked, tolerated: float, what: str) -> str:
    """Why nothing is promised of bearings that are wrong by η: ``what`` tolerates less, rad."""
    return (
        f"none: bearings may err by {asked.error:.4g} rad, and {what} is known to tolerate less "
        f"than {tolerated:.4g} rad here (guarantees 11)"
    )


Assumption = Callable[[Scenario, Asked], str]
"""A named predicate: empty if a scenario meets it, else in words why it does not."""


@dataclass(frozen=True)
class Theorem:
    """A statement with its assumptions and its bounds."""

    name: str
    """As docs/guarantees.md calls it."""
    by: tuple[str, ...]
    """What keeps the guarantee: some of CHOICES."""
    assumptions: tuple[Assumption, ...]
    """All of them must hold."""
    bounds: Callable[[Scenario, Asked], Bounds]
    """Its promise for a scenario that meets them all."""
    rendezvous: bool = True
    """Whether it can promise one, and not only that something stays bounded."""

    def unmet(self, scenario: Scenario, asked: Asked) -> tuple[int, str]:
        """How many assumptions hold before the first that fails, and that one in words; the words
        are empty if the theorem applies.
        """
        for met, holds in enumerate(self.assumptions):
            if words := holds(scenario, asked):
                return met, words
        return len(self.assumptions), ""
