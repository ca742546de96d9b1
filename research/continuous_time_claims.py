"""The claims of theorems G, N and C4, on any graph: directed, switching, never connected at once
(guarantees 10 and 11).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from adversarial_graphs import draw_polygons, draw_teams
from continuous_time import ROUNDING, Array, Look, Teams, Trial, integrate
from continuous_time_laws import in_cones, in_polygons, misled, now_and_then, with_gains
from time_bounds import cone_time, gains_time, led_time, windows_time

from rendezvous_env.safety.theorems.gains import shrinking
from rendezvous_env.safety.theorems.noise import held_error, largest_error
from train.verify.claims import BATCH
from train.verify.falsification import Tally
from train.verify.monitors import directions, extents

_NOW_AND_THEN = 100
"""Calls between two looks at what is slow to measure."""


@dataclass(frozen=True)
class ContinuousTimeClaim:
    """One row of the table, of teams that the free integrator moves."""

    name: str
    statement: str
    draw: Callable[[np.random.Generator, int, float], Trial]
    """(random numbers, number of the batch, least margin ε) → teams, law, limits."""
    meets: bool = True
    """Whether it claims that all have met in time."""


def check(
    claim: ContinuousTimeClaim, seed: int, batch: int, trials: int, least_margin: float = 0.3
) -> Tally:
    """Run one batch of a claim, and count as many of its teams as are wanted."""
    random = np.random.default_rng([seed, zlib.crc32(claim.name.encode()), batch])
    trial = claim.draw(random, batch, least_margin)
    times, kept = (found[:trials] for found in integrate(trial))
    limit = trial.limit[:trials]
    held = kept >= -ROUNDING
    if not claim.meets:
        margin, violations = float(kept.min()), int(np.sum(~held))
        return Tally(len(held), margin=margin, violations=violations)
    held &= times <= limit
    ratio, violations = float(np.max(times / limit)), int(np.sum(~held))
    worst = {claim.name: ratio}
    return Tally(len(held), margin=1.0 - ratio, violations=violations, ratio=worst)


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


Random = np.random.Generator

_FINE = 0.2
"""Step over r/(2C) where continuous time is meant, C the largest gain."""
_STRONGEST = 2.0
"""C over c."""


def _gains(random: Random) -> tuple[float, float]:
    least = random.uniform(0.5, 2.0)
    return least, _STRONGEST * least


def draw_gains(random: Random, batch: int, least_margin: float, led: bool = False) -> Trial:
    """Any gains, or all but of one robot, which rests."""
    teams, gains = draw_teams(random, batch), _gains(random)
    limit = (led_time if led else gains_time)(
        teams.active.shape[1], teams.dim, teams.size(), gains[0]
    )
    step = _FINE * teams.merge_radius / (2.0 * gains[1])
    law = with_gains(teams, random, gains, led=led)
    return Trial(teams, law, step, limit, hull_is_nested(teams))


def draw_windows(random: Random, batch: int, least_margin: float) -> Trial:
    """Robots that see somebody now and then."""
    teams, gains = draw_teams(random, batch, dims=(2,)), _gains(random)
    step = _FINE * teams.merge_radius / (2.0 * gains[1])
    duration = random.uniform(1.0, 10.0) * step
    window = random.uniform(1.5, 5.0) * duration + step
    limit = windows_time(
        teams.active.shape[1],
        teams.size(),
        least_gain=gains[0],
        most_gain=gains[1],
        window=window,
        least_duration=duration,
        merge_radius=teams.merge_radius,
    )
    # what begins late for being held ends late too
    law = now_and_then(teams, random, gains, window, duration + step)
    return Trial(teams, law, step, limit, hull_is_nested(teams))


def draw_misled(random: Random, batch: int, least_margin: float) -> Trial:
    """Bearings that are off by 0.9 of what N forgives, what is held included."""
    teams, gain = draw_teams(random, batch, radii=(0.25, 0.4)), random.uniform(0.5, 2.0)
    n = teams.active.shape[1]
    total = 0.9 * float(largest_error(n, teams.dim))
    step = random.uniform(0.03, 0.1) * teams.merge_radius * np.sin(total) / gain
    error = total - float(held_error(gain, step, teams.merge_radius))
    rate = float(shrinking(n, teams.dim, gain, total))
    return Trial(
        teams,
        misled(teams, random, gain, error),
        step,
        teams.size() / rate,
        shrinks_by(teams, rate),
    )


def draw_growing(random: Random, batch: int, least_margin: float, share: float = 1.02) -> Trial:
    """Regular polygons whose robots are misled by more than N forgives.

    The sides see each other at π/n from the tangent, so L' = 2 n c sin(π/n) sin(η − π/n); nine
    tenths of that are claimed.
    """
    teams, gain = draw_polygons(random, batch), random.uniform(0.5, 2.0)
    n = teams.active.shape[1]
    error = share * np.pi / n
    grows = 2.0 * n * gain * np.sin(np.pi / n) * np.sin(abs(share - 1.0) * np.pi / n)
    step = 1e-3 / gain
    law = in_polygons(random, gain, error)
    return Trial(teams, law, step, np.full(BATCH, 200 * step), shrinks_by(teams, -0.9 * grows))


def draw_cones(random: Random, batch: int, least_margin: float, most: float = 1.5) -> Trial:
    """Law (4) with headings in the cones of what is seen."""
    teams = draw_teams(random, batch)
    margin = random.uniform(least_margin, max(least_margin, 0.9), BATCH)
    return Trial(
        teams,
        in_cones(teams, random, margin, most),
        teams.merge_radius / (12.0 * most),  # nobody passes those it follows
        cone_time(teams.active.shape[1], teams.dim, teams.size(), 1.0, margin),
        hull_is_nested(teams),
    )


CONTINUOUS_TIME = (
    ContinuousTimeClaim(
        "gains",
        "any gains ≥ 0, Σ_j c_ij ≥ c, on any graph: hull nested, T ≤ L0/(2cκ(n)), 3-D n w0/(2c)",
        draw_gains,
    ),
    ContinuousTimeClaim(
        "gains-leader",
        "the same where one robot rests: T ≤ L0/(2cκ₁(n)), 3-D 2(n−1)w0/c",
        partial(draw_gains, led=True),
    ),
    ContinuousTimeClaim(
        "gains-windows",
        "gains from c to C for τ_d in every T_w: hull nested, T ≤ T_w (n + L0/ΔL)",
        draw_windows,
    ),
    ContinuousTimeClaim(
        "wrong-bearings",
        "Σ_j c_ij = c, bearings off by η: L falls at N's rate; 0.9 of π/n, 3-D 0.9 of enough",
        draw_misled,
    ),
    ContinuousTimeClaim(
        "beyond-N",
        "regular polygons misled by 1.02 π/n grow",
        draw_growing,
        meets=False,
    ),
    ContinuousTimeClaim(
        "cone-headings",
        "headings of cone{g}, h·f ≥ ε‖f‖, any graph: hull nested, T ≤ n²L0/(16εd), 3-D n²w0/(4εd)",
        draw_cones,
    ),
)
