"""Claims of theorems G, N and C4 on any graph (guarantees 10 and 11).

Graphs may be directed, switching, or never connected at once.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from adversarial_graphs import draw_polygons, draw_teams
from continuous_time import ROUNDING, Array, Batch, ContinuousTrial, Look, integrate
from continuous_time_laws import in_cones, in_polygons, misled, now_and_then, with_gains
from time_bounds import cone_time, gains_time, led_time, windows_time

from rendezvous_env.safety.theorems.gains import shrinking
from rendezvous_env.safety.theorems.noise import held_error, largest_error
from train.verify.claims import BATCH
from train.verify.falsification import Tally
from train.verify.monitors import directions, extents

_NOW_AND_THEN = 100
"""Number of calls between two evaluations of expensive quantities."""


@dataclass(frozen=True)
class ContinuousTimeClaim:
    """Claim about teams of the continuous-time integrator, one row of the table."""

    name: str
    statement: str
    draw: Callable[[np.random.Generator, int, float], ContinuousTrial]
    """(random numbers, batch index, minimum alignment ε) → teams, law, limits."""
    meets: bool = True
    """Whether it claims rendezvous in time."""


def check(
    claim: ContinuousTimeClaim, seed: int, batch: int, trials: int, least_margin: float = 0.3
) -> Tally:
    """Run one batch of a claim, and evaluate the requested number of its teams."""
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


def hull_is_nested(teams: Batch) -> Look:
    """Relative amount of L(0) by which the hull recedes in every direction."""
    along, start = directions(teams.dim), teams.size()
    latest = extents(teams.positions, teams.active, along)

    def look(teams: Batch) -> Array:
        nonlocal latest
        before, latest = latest, extents(teams.positions, teams.active, along)
        return np.asarray((before - latest).min(axis=-1) / start)

    return look


def shrinks_by(teams: Batch, rate: float) -> Look:
    """Relative amount of L(0) by which the perimeter is below L(0) − rate·t.

    With a negative rate it is the growth beyond −rate·t. It is evaluated at intervals.
    """
    start, calls = teams.size(), 0

    def look(teams: Batch) -> Array:
        nonlocal calls
        calls += 1
        if calls % _NOW_AND_THEN:
            return np.full(len(start), np.inf)
        below = start - rate * teams.time - teams.size()
        return np.asarray((below if rate > 0 else -below) / start)

    return look


def stays_below(teams: Batch, bound: Array) -> Look:
    """Relative amount by which V is below a bound, (B,), m²/s."""
    return lambda teams: np.asarray(1.0 - teams.lyapunov() / bound)


Random = np.random.Generator

_FINE = 0.2
"""Step over r/(2C) that represents continuous time, with C the largest gain."""
_STRONGEST = 2.0
"""Ratio C/c."""


def _gains(random: Random) -> tuple[float, float]:
    least = random.uniform(0.5, 2.0)
    return least, _STRONGEST * least


def draw_gains(
    random: Random, batch: int, least_margin: float, led: bool = False
) -> ContinuousTrial:
    """Sample arbitrary gains, with or without one stationary robot."""
    teams, gains = draw_teams(random, batch), _gains(random)
    limit = (led_time if led else gains_time)(
        teams.active.shape[1], teams.dim, teams.size(), gains[0]
    )
    step = _FINE * teams.merge_radius / (2.0 * gains[1])
    law = with_gains(teams, random, gains, led=led)
    return ContinuousTrial(teams, law, step, limit, hull_is_nested(teams))


def draw_windows(random: Random, batch: int, least_margin: float) -> ContinuousTrial:
    """Sample robots with a visible neighbour at times."""
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
    # an interval that begins late because of held inputs also ends late
    law = now_and_then(teams, random, gains, window, duration + step)
    return ContinuousTrial(teams, law, step, limit, hull_is_nested(teams))


def draw_misled(random: Random, batch: int, least_margin: float) -> ContinuousTrial:
    """Sample bearing errors of 0.9 of the tolerance of theorem N, including that of held inputs."""
    teams, gain = draw_teams(random, batch, radii=(0.25, 0.4)), random.uniform(0.5, 2.0)
    n = teams.active.shape[1]
    total = 0.9 * float(largest_error(n, teams.dim))
    step = random.uniform(0.03, 0.1) * teams.merge_radius * np.sin(total) / gain
    error = total - float(held_error(gain, step, teams.merge_radius))
    rate = float(shrinking(n, teams.dim, gain, total))
    return ContinuousTrial(
        teams,
        misled(teams, random, gain, error),
        step,
        teams.size() / rate,
        shrinks_by(teams, rate),
    )


def draw_growing(
    random: Random, batch: int, least_margin: float, share: float = 1.02
) -> ContinuousTrial:
    """Regular polygons with bearing errors above the tolerance of theorem N.

    Adjacent robots are at π/n from the tangent, so L' = 2 n c sin(π/n) sin(η − π/n); the claim is
    nine tenths of that.
    """
    teams, gain = draw_polygons(random, batch), random.uniform(0.5, 2.0)
    n = teams.active.shape[1]
    error = share * np.pi / n
    grows = 2.0 * n * gain * np.sin(np.pi / n) * np.sin(abs(share - 1.0) * np.pi / n)
    step = 1e-3 / gain
    law = in_polygons(random, gain, error)
    return ContinuousTrial(
        teams, law, step, np.full(BATCH, 200 * step), shrinks_by(teams, -0.9 * grows)
    )


def draw_cones(
    random: Random, batch: int, least_margin: float, most: float = 1.5
) -> ContinuousTrial:
    """Sample law (4) with headings in the cone of the bearings."""
    teams = draw_teams(random, batch)
    margin = random.uniform(least_margin, max(least_margin, 0.9), BATCH)
    return ContinuousTrial(
        teams,
        in_cones(teams, random, margin, most),
        teams.merge_radius / (12.0 * most),  # no robot passes its targets
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
