"""What a claim is, what is measured of it, and what is found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous_env import Scenario, Simulator
from rendezvous_env.trajectory import Policy, Step

from .cases import Case

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass
class Record:
    """What was measured of a batch; all arrays (B,)."""

    case: Case
    start: Array
    """V(0), m²/s."""
    limit: Array
    """Time by which the team must have met, s."""
    times: Array
    """Of the rendezvous, s; inf without."""
    slack: Array
    """Least of what V fell in a step beyond what is promised, over V(0)."""
    fell: Mask
    """Whether V kept the promise in every step, rounding aside."""
    excess: Array
    """Largest rise of V at a merge beyond its bound, over V(0)."""
    left: NDArray[np.int64]
    """Robots left at the end."""
    total: Array
    """Σ‖u_i‖ at the start over 2 max a_ij; u_i are the speeds the law chose."""
    watched: Array
    """Least of what the claim's watch has found; inf without one."""


Verdict = tuple[Array, Mask]
"""Margin of each team (negative is bad, rounding aside), and whether the claim held."""
Draw = Callable[[np.random.Generator, int, float], Case]
Law = Callable[[Case, int, np.random.Generator], Policy]
"""(case, B, random numbers) → policy."""
Bound = Callable[[Case, Simulator], Array]
"""(case, teams at their start) → time limits (B,), s."""
Judge = Callable[[Record], Verdict]
Promise = Callable[[Scenario, Step], Array]
"""(scenario, step) → what V must fall in it (B,), m²/s, if nobody merges."""
Watch = Callable[[Simulator, Case], Callable[[Step], Array]]
"""(teams at their start, case) → what is asked after every step: by how much each keeps a promise
of its own, (B,); negative where it is broken, rounding aside."""


@dataclass(frozen=True)
class Claim:
    """One row of the table."""

    name: str
    statement: str
    draw: Draw
    law: Law
    bound: Bound
    judges: tuple[Judge, ...]
    """The first one's margin is reported; a team that fails any violates the claim."""
    promise: Promise
    """What V must fall in each step."""
    timed: bool = False
    """Whether ``bound`` is a theorem's, so that T/bound is worth reporting."""
    watch: Watch | None = None
    """What else is measured in every step, for the judge ``keeps``."""
    patience: float = 1.0
    """Times ``bound`` for which teams are waited for: more than 1 where it bounds a mean."""


@dataclass(frozen=True)
class Finding:
    """What one batch says about a claim, or several."""

    trials: int
    margin: float
    """Worst over the teams."""
    time_over_bound: float
    """Worst over the teams; NaN where the claim names no time."""
    violations: int


def worst(findings: Sequence[Finding]) -> Finding:
    """What several batches say together."""
    return Finding(
        trials=sum(finding.trials for finding in findings),
        margin=min(finding.margin for finding in findings),
        time_over_bound=max(finding.time_over_bound for finding in findings),
        violations=sum(finding.violations for finding in findings),
    )
