"""What claims watch in every step beside V; shares of a length, negative where it is broken."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rendezvous_env import Simulator
from rendezvous_env.trajectory import Step

from .cases import Case
from .claim import Array, Watch
from .flow_sights import directions, extents

_FLOAT32 = 2.0**-20
"""Share of a displacement that is lost or won by rounding rows and actions, at most."""


def hull_shrinks(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """By what share of L(0) L falls in a step."""
    start = latest = teams.size()

    def look(step: Step) -> Array:
        nonlocal latest
        before, latest = latest, teams.size()
        return (before - latest) / start

    return look


def hull_draws_back(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """By what share of L(0) the hull draws back in a step, least over directions all round; what
    rounding of rows and actions to float32 can do is allowed.
    """
    scenario = case.scenario
    along, start = directions(scenario.dim), teams.size()
    latest = extents(teams.positions, teams.active, along)
    rounded = _FLOAT32 * scenario.max_degree * scenario.tau

    def look(step: Step) -> Array:
        nonlocal latest
        before, latest = latest, extents(teams.positions, teams.active, along)
        return np.asarray(((before - latest).min(axis=-1) + rounded) / start)

    return look


def bodies(radius: float) -> Watch:
    """A watch on bodies of a radius, given over r: by what share of r the nearest two are apart
    beyond touching, at any moment of a step.

    Robots that merge in a step are left out of it, being two bodies in one place afterwards.
    """

    def watch(teams: Simulator, case: Case) -> Callable[[Step], Array]:
        places, active = teams.positions, teams.active
        merge_radius = teams.scenario.merge_radius

        def look(step: Step) -> Array:
            nonlocal places, active
            before, places = places, teams.positions
            went, active = active & ~teams.active, teams.active
            into = teams.merged_into
            docked = np.zeros_like(active)
            for team, robot in np.argwhere(went):
                docked[team, into[team, robot]] = True
            nearest = _nearest_in_a_step(before, places, active & ~docked)
            return nearest / merge_radius - 2.0 * radius

        return look

    return watch


bodies_stay_apart = bodies(0.5)
"""Bodies of radius r/2, which all pairs dock at r to spare."""


def _nearest_in_a_step(before: Array, after: Array, counted: Array) -> Array:
    """Least distance of two counted robots that moved on straight lines, (B,), m; inf without
    two.
    """
    offsets = before[:, None] - before[:, :, None]
    moved = (after - before)[:, None] - (after - before)[:, :, None]
    square = np.sum(moved**2, axis=-1)
    along = -np.sum(offsets * moved, axis=-1)
    moment = np.clip(np.divide(along, square, out=np.zeros_like(square), where=square > 0), 0, 1)
    distance = np.linalg.norm(offsets + moment[..., None] * moved, axis=-1)
    pairs = counted[:, None] & counted[:, :, None] & ~np.eye(counted.shape[1], dtype=bool)
    least: Array = np.min(distance, axis=(1, 2), where=pairs, initial=np.inf)
    return least
