"""Theorems N, N1 and N1': bounded bearing errors.

**N.** All Σ_j c_ij equal c, every bearing error is at most η < π/n, in 3-D tan η < 1/√(n(n−2)). On
any graph on which every robot has a visible neighbour, in continuous time,

    T ≤ L0 sin(π/n)/(2 c κ(n) sin(π/n − η)),      in 3-D  w0/(2c [cos η/n − sin η √(1 − 2/n)]).

Zero-order hold counts as an error: η_m = η + asin(2 c_m τ/r), T ≤ L0 / min_m shrinking(m, c_m, η_m)
+ (n−1) τ. L0 includes the growth of the hull in steps with a merge.

**N1.** Law (1), undirected connected graph, τ ≤ r/(2D̄), no velocity scaling. With e_i = 2
sin(η/2) D_i, c_m ≤ D_i ≤ D̄_m for m active robots, and ρ_m = m D̄_m sin(η/2)/c_m < 1:

    V(t+τ) ≤ V(t) − τ Σ(‖f_i‖² − e_i²) between merges,
    T ≤ (V0⁺ + (n−1) τ Σ e_i²) max_m m/(4c_m²(1 − ρ_m²)) + (n−1) τ.

**N1'.** Under headings certified for f̂ with speed max(0, h·f̂_i − e_i), V never increases between
merges. If all q_m are positive, with β = ½,

    T ≤ V0⁺ max_m m/(q_m² s_min) + (n−1) τ,     q_m = 2ε c_m − ε β a* m/n − 2 (1+ε) m D̄_m sin(η/2).

If V/(m−1) never increases at merges, V(0)/(n−1) and q_m²/(m−1) may
replace V0⁺ and q_m².

Proofs: docs/proofs.md, N to N1'.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...scenario.scenario import Scenario
from ..gains import gain_range
from ..settings import error_chord
from . import assumptions as given
from . import constants as known
from .gains import shrinking
from .theorem import Asked, Theorem, TheoremBounds, bounds_with_errors

Array = NDArray[np.float64]

DEAD_ZONE = 0.5  # β of the dead zone δ = βa*/n of certified headings


def largest_error(n: ArrayLike, dim: int) -> Array:
    """Supremum of errors tolerated by theorem N: π/n, in 3-D arctan(1/√(n(n − 2))), (...), rad."""
    m = np.asarray(n, dtype=np.float64)
    return np.asarray(np.pi / m if dim == 2 else np.arctan2(1.0, np.sqrt(m * (m - 2.0))))


def held_error(gain: ArrayLike, duration: ArrayLike, merge_radius: float) -> Array:
    """Error of a bearing held or delayed by ``duration``, s: asin(2 c duration/r), (...), rad.

    See theorem N. It is π if a neighbour can be overtaken; c is the maximum speed, m/s.
    """
    sine = 2.0 * np.asarray(gain) * np.asarray(duration) / merge_radius
    return np.where(sine < 1.0, np.arcsin(np.minimum(sine, 1.0)), np.pi)


def equal_gains(scenario: Scenario, asked: Asked) -> Array | None:
    """Common Σ_j c_ij = c_m, an array (n − 1,), m/s, if all are equal and no velocity is scaled."""
    if asked.by == "gains":
        least, most = gain_range(scenario, asked.min_gain, asked.max_gain)
        gains, even = np.full(scenario.n_robots - 1, least), least == most
    else:
        even = known.degrees_stay_equal(scenario) and not scenario.scales_velocity
        gains = known.min_degrees(scenario)
    return gains if even and scenario.min_speed_limit >= gains.max(initial=0.0) else None


def gains_are_equal(scenario: Scenario, asked: Asked) -> str:
    """All active robots have equal Σ_j c_ij at any time, and a visible neighbour."""
    if equal_gains(scenario, asked) is not None and not known.led(scenario):
        return ""
    return (
        f"none: bearings may err by {asked.error:.4g} rad; theorem N needs equal sums of gains, "
        "and a visible neighbour of every robot"
    )


def equal_gain_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Theorem N with zero-order hold."""
    gains = equal_gains(scenario, asked)
    assert gains is not None  # an assumption
    left, dim, error = known.robots_left(scenario), scenario.dim, asked.error
    strayed = 2.0 * gains.max() * scenario.tau * math.sin(error / 2.0)
    extent = known.largest_size(scenario) + known.hull_growth(scenario)
    extent += (scenario.n_robots - 1) * (2.0 * math.pi * (dim - 1)) * strayed
    late_by = held_error(gains, scenario.tau, scenario.merge_radius)
    tolerated = max(0.0, float((largest_error(left, dim) - late_by).min()))
    if lost := given.errors_outlasted(scenario, asked, tolerated):
        return TheoremBounds(lost, tolerated_bearing_error=tolerated)
    if error == 0.0:  # two robots with exact bearings move on one line
        late_by = np.where(left == 2, 0.0, late_by)
    time = float(known.held_time(scenario, extent, shrinking(left, dim, gains, error + late_by)))
    who = "law (1)" if asked.by == "law" else "every policy that weighs neighbours"
    words = f"theorem N: {who} meets in finite time with bearing errors of {error:.4g} rad"
    hull = extent if math.isfinite(time) else math.inf
    return bounds_with_errors(asked, time, tolerated, words, who, hull=hull)


def tolerated_error(
    scenario: Scenario, margin: float | None = None, dead_zone: float = 0.0
) -> float:
    """Supremum of η, rad, for a time bound by N1, or by N1' with a margin ε.

    N1    sin(η/2) < min_m c_m/(m D̄_m)
    N1'   sin(η/2) < min_m ε (2c_m − β a* m/n)/(2 (1+ε) m D̄_m),      β = ``dead_zone``
    """
    left, share = known.robots_left(scenario), known.min_degrees(scenario)
    if margin is not None:
        faded = dead_zone * scenario.bottleneck_weight * left / scenario.n_robots
        share = margin * (2.0 * share - faded) / (2.0 * (1.0 + margin))
    sine = (share / (left * known.max_degrees(scenario))).min()
    return float(2.0 * np.arcsin(min(sine, 1.0)))


def law_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Theorem N1; no time bound for a long step or limited speed."""
    n, left, chord = scenario.n_robots, known.robots_left(scenario), error_chord(asked.error)
    as_it_is = scenario.min_speed_limit >= scenario.max_degree and not known.long_step(scenario)
    most = known.lyapunov_bound(scenario)
    most += (n - 1) * scenario.tau * n * (chord * scenario.max_degree) ** 2
    feigned = left * (chord * known.max_degrees(scenario)) ** 2
    rates = 4.0 * known.min_degrees(scenario) ** 2 / left - feigned
    time = known.held_time(scenario, most, rates) if as_it_is else math.inf
    tolerated = tolerated_error(scenario) if as_it_is else 0.0
    words = f"law (1) meets in finite time with bearing errors of {asked.error:.4g} rad"
    return bounds_with_errors(asked, time, tolerated, f"theorem N1: {words}", "law (1)")


def certified_bounds(
    scenario: Scenario, asked: Asked, most: float, each: float | None, dead_zone: float, *words: str
) -> TheoremBounds:
    """Numbers for velocities certified with measured bearings, if all q_m > 0 (theorems N1', D).

    ``most`` is V0⁺ or its substitute, m²/s; ``each`` a bound on V/(m − 1), if known; ``words`` are
    those of ``bounds_with_errors``.
    """
    left, margin = known.robots_left(scenario), asked.min_alignment
    faded = dead_zone * scenario.bottleneck_weight * left / scenario.n_robots
    wrong = left * error_chord(asked.error) * known.max_degrees(scenario)
    tolerated = tolerated_error(scenario, margin, dead_zone)
    pull = 2.0 * known.min_degrees(scenario)
    q = margin * (pull - faded) - (1.0 + margin) * wrong
    sure = asked._replace(min_alignment=float((q / pull).min()))
    if lost := given.errors_outlasted(scenario, sure, tolerated):
        return TheoremBounds(lost, tolerated_bearing_error=tolerated)
    rates, slowest = np.maximum(q, 0.0) ** 2 / left, known.scale_bound(scenario)
    time = known.held_time(scenario, most, rates * slowest)
    if each is not None:
        alike = known.held_time(scenario, each, rates / (left - 1.0) * slowest)
        time = np.minimum(time, alike)
    return bounds_with_errors(asked, time, tolerated, *words)


def heading_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Theorem N1'."""
    most, each, long = float(known.lyapunov_bound(scenario)), None, known.long_step(scenario)
    if known.merges_at_midpoints(scenario):
        each = known.largest_lyapunov(scenario) / (scenario.n_robots - 1)
    words = (
        "theorem N1': every policy under certified headings that allow for errors of "
        f"{asked.error:.4g} rad meets in finite time"
    ) + " with velocities scaled to the long step" * long
    who, even_so = "a heading of this alignment", "; V still never rises between merges"
    return certified_bounds(scenario, asked, most, each, DEAD_ZONE, words, who, even_so)


_SEEN = given.bounded_errors, given.all_neighbours_visible, given.no_obstacles
THEOREMS = (
    Theorem("N", ("law", "gains"), (*given.JOINED, *_SEEN, gains_are_equal), equal_gain_bounds),
    Theorem("N1", ("law",), (*given.TEAM, *_SEEN, given.certified_or_scaled), law_bounds),
    Theorem("N1'", ("heading",), (*given.TEAM, *_SEEN), heading_bounds),
)
