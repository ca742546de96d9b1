"""The claims of theorems G, N and C4, on any graph: directed, switching, never connected at once
(guarantees 10 and 11).
"""

from __future__ import annotations

import numpy as np

from rendezvous_env.guarantee.error_times import held_error, largest_error, wrong_bearings_time
from rendezvous_env.guarantee.graph_bounds import cone_time, gains_time, led_time, windows_time
from rendezvous_env.guarantee.size_bounds import shrinking

from .cases import BATCH
from .flow_claim import FlowClaim, hull_is_nested, shrinks_by
from .flow_laws import in_cones, in_polygons, misled, now_and_then, with_gains
from .flow_starts import draw_polygons, draw_teams
from .free_flow import Trial

Random = np.random.Generator

_FINE = 0.2
"""Step over r/(2C) where continuous time is meant, C the largest gain."""
_STRONGEST = 2.0
"""C over c."""


def _gains(random: Random) -> tuple[float, float]:
    least = random.uniform(0.5, 2.0)
    return least, _STRONGEST * least


def draw_gains(random: Random, batch: int, least_margin: float) -> Trial:
    """Any gains."""
    teams, gains = draw_teams(random, batch), _gains(random)
    n = teams.active.shape[1]
    return Trial(
        teams,
        with_gains(teams, random, gains),
        _FINE * teams.merge_radius / (2.0 * gains[1]),
        gains_time(n, teams.dim, teams.size(), gains[0]),
        hull_is_nested(teams),
    )


def draw_led(random: Random, batch: int, least_margin: float) -> Trial:
    """Any gains, but one robot rests."""
    teams, gains = draw_teams(random, batch), _gains(random)
    n = teams.active.shape[1]
    return Trial(
        teams,
        with_gains(teams, random, gains, led=True),
        _FINE * teams.merge_radius / (2.0 * gains[1]),
        led_time(n, teams.dim, teams.size(), gains[0]),
        hull_is_nested(teams),
    )


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
        wrong_bearings_time(n, teams.dim, teams.size(), gain, total),
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


FLOW = (
    FlowClaim(
        "gains",
        "any gains ≥ 0, Σ_j c_ij ≥ c, on any graph: hull nested, T ≤ L0/(2cκ(n)), 3-D n w0/(2c)",
        draw_gains,
    ),
    FlowClaim(
        "gains-leader",
        "the same where one robot rests: T ≤ L0/(2cκ₁(n)), 3-D 2(n−1)w0/c",
        draw_led,
    ),
    FlowClaim(
        "gains-windows",
        "gains from c to C for τ_d in every T_w: hull nested, T ≤ T_w (n + L0/ΔL)",
        draw_windows,
    ),
    FlowClaim(
        "wrong-bearings",
        "Σ_j c_ij = c, bearings off by η: L falls at N's rate; 0.9 of π/n, 3-D 0.9 of enough",
        draw_misled,
    ),
    FlowClaim(
        "beyond-N",
        "regular polygons misled by 1.02 π/n grow",
        draw_growing,
        meets=False,
    ),
    FlowClaim(
        "cone-headings",
        "headings of cone{g}, h·f ≥ ε‖f‖, any graph: hull nested, T ≤ n²L0/(16εd), 3-D n²w0/(4εd)",
        draw_cones,
    ),
)
