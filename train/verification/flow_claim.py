"""Claims that are tried in the free integrator, and what is watched there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .claim import Finding
from .flow_sights import directions, extents
from .free_flow import ROUNDING, Array, Look, Teams, Trial, integrate

_NOW_AND_THEN = 100
"""Calls between two looks at what is slow to measure."""


@dataclass(frozen=True)
class FlowClaim:
    """One row of the table, of teams that the free integrator moves."""

    name: str
    statement: str
    draw: Callable[[np.random.Generator, int, float], Trial]
    """(random numbers, number of the batch, least margin ε) → teams, law, limits."""
    meets: bool = True
    """Whether it claims that all have met in time."""

    @property
    def timed(self) -> bool:
        """Whether there is a worst T/bound."""
        return self.meets


def check_flow(
    claim: FlowClaim, random: np.random.Generator, batch: int, trials: int, least_margin: float
) -> Finding:
    """Run one batch of a claim, and count as many of its teams as are wanted."""
    trial = claim.draw(random, batch, least_margin)
    times, kept = (found[:trials] for found in integrate(trial))
    limit = trial.limit[:trials]
    held = kept >= -ROUNDING
    if not claim.meets:
        return Finding(len(held), float(kept.min()), float("nan"), int(np.sum(~held)))
    held &= times <= limit
    ratio = float(np.max(times / limit))
    return Finding(len(held), 1.0 - ratio, ratio, int(np.sum(~held)))


def hull_is_nested(teams: Teams) -> Look:
    """By what share of L(0) the hull draws back in every direction."""
    along, start = directions(teams.dim), teams.size()
    latest = extents(teams.positions, teams.active, along)

    def look(teams: Teams) -> Array:
        nonlocal latest
        before, latest = latest, extents(teams.positions, teams.active, along)
        return np.asarray((before - latest).min(axis=-1) / start)

    return look


def shrinks_by(teams: Teams, rate: float) -> Look:
    """By what share of L(0) the size is below L(0) − rate·t; with a negative rate, how much more
    than −rate·t it has grown. Looked at now and then.
    """
    start, calls = teams.size(), 0

    def look(teams: Teams) -> Array:
        nonlocal calls
        calls += 1
        if calls % _NOW_AND_THEN:
            return np.full(len(start), np.inf)
        below = start - rate * teams.time - teams.size()
        return np.asarray((below if rate > 0 else -below) / start)

    return look


def stays_below(teams: Teams, bound: Array) -> Look:
    """By what share V is below a bound, (B,), m²/s."""
    return lambda teams: np.asarray(1.0 - teams.lyapunov() / bound)
