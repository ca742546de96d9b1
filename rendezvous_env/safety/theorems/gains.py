"""Theorem G: weighted sums of bearings on any graph, in continuous and in sampled time.

**Assumptions.** ṗ_i = Σ_j c_ij g_ij, any gains c_ij ≥ 0 with c ≤ Σ_j c_ij ≤ C (law (1): a_ij);
single integrators, exact bearings, no obstacles. The graph may be directed and may switch, if at
any time all robots but one, the stationary root, have a visible neighbour.

**Promise**, L0 = L(0) the hull perimeter (``Simulator.size``): in continuous time T ≤ L0/(2 c
κ(n)), in 3-D n w0/(2c), w0 = L0/2π; with a stationary root κ₁, 2(n−1) w0/c. With zero-order hold
over τ, τ C < r (D1):

    T ≤ L0/(c k K(n)) + (n − 1) τ,       k = (r − τC)/(r − τC + 2τc),
    K(n) = 2n (1 − cos(π/n)),   in 3-D nπ (sin φ − φ cos φ) with φ = π/n,

and with a stationary root that of n − 1 robots in the directions within 75° of one, times 0.78.

For τ C ≤ r the hull does not grow in a step that begins with linked robots r or more apart. Any
robots may rest in it. L0 includes the growth in other steps. A robot that crashes is a stationary
root from then on, on an undirected graph too. Proof: docs/proofs.md, G and D1.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...scenario.scenario import Scenario
from ..gains import gain_range
from . import assumptions as given
from . import constants as known
from .descent import last_failure
from .theorem import TWO_CRASHED, Asked, Theorem, TheoremBounds

Array = NDArray[np.float64]

_WIDE = 5.0 * np.pi / 12.0  # maximum angle to another robot's direction at which the root is deep
_DEEP = 0.78  # times 0.172 sin 75° r, the largest step of the others, is less than cos 75° r/2


def kappa(n: ArrayLike) -> Array:
    """min{Σ sin²x_i : Σx_i = π, 0 ≤ x_i ≤ π/2}, (...), without unit (proofs, G), which is min( n
    sin²(π/n), 1 + (n − 1) sin²(π/(2(n − 1))) ).
    """
    m = np.asarray(n, dtype=np.float64)
    one_flat = 1.0 + (m - 1.0) * np.sin(np.pi / (2.0 * (m - 1.0))) ** 2
    return np.asarray(np.minimum(m * np.sin(np.pi / m) ** 2, one_flat))


def shrinking(n: ArrayLike, dim: int, gain: ArrayLike, error: ArrayLike = 0.0) -> Array:
    """Minimum decrease rate −L' of n robots with gains Σ_j c_ij ≥ c, (...), m/s.

        2-D:   2 c κ(n) sin(π/n − η)/sin(π/n)                           (theorem G; N for η > 0)
        3-D:   4π c [cos η/n − sin η √(1 − 2/n)]

    With an error η, rad, all Σ_j c_ij must equal c; 0 if the error is too large.
    """
    m, c, eta = np.asarray(n, dtype=np.float64), np.asarray(gain), np.asarray(error)
    if dim == 2:
        rate = 2.0 * c * kappa(m) * (np.sin(np.pi / m - eta) / np.sin(np.pi / m))
    else:
        rate = 4.0 * np.pi * c * (np.cos(eta) / m - np.sin(eta) * np.sqrt(1.0 - 2.0 / m))
    return np.where(eta < np.pi / m, np.maximum(rate, 0.0), 0.0)


def shrinking_to_leader(n: ArrayLike, dim: int, gain: ArrayLike) -> Array:
    """As ``shrinking`` with a stationary root, (...), m/s.

    2-D:   2 c κ₁(n),   κ₁(n) = (n − 1) sin²(π/(2(n − 1)));      3-D:   π c/(n − 1)
    """
    others, c = np.asarray(n, dtype=np.float64) - 1.0, np.asarray(gain)
    if dim == 2:
        return np.asarray(2.0 * c * others * np.sin(np.pi / (2.0 * others)) ** 2)
    return np.asarray(np.pi * c / others)


def _gains(scenario: Scenario, asked: Asked) -> tuple[Array, float]:
    """c_m, (n − 1,), and C, m/s; for law (1) a_ij, scaled as its velocities (theory 4)."""
    gains, most = np.ones(scenario.n_robots - 1), scenario.max_degree
    if asked.by == "gains":
        least, most = gain_range(scenario, asked.min_gain, asked.max_gain)
        return gains * min(least, scenario.min_speed_limit), most
    if given.nearest_always_visible(scenario):
        # all but the nearest may be occluded, and its link may be the lightest
        gains *= known.lightest_link(scenario)
    elif known.kind_of_links(scenario.sensing_graph) == known.UNDIRECTED:
        gains = known.min_degrees(scenario)
    else:
        gains *= scenario.bottleneck_weight
    if scenario.scales_velocity:
        slow = scenario.merge_radius / (2.0 * scenario.tau)
        gains, most = np.minimum(gains, slow), min(most, slow)
    return np.minimum(gains, scenario.min_speed_limit), most


def hull_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Bound on L alone, without visibility assumptions."""
    return TheoremBounds(hull=known.largest_size(scenario) + known.hull_growth(scenario))


def depth_gained(n: ArrayLike, dim: int, led: bool) -> Array:
    """Minimum Σ_i ∫ sin x du over the normal cones N_i, x the angle from u to the edge, (...), rad.

        2-D:   2 n (1 − cos(π/n)),                      3-D:   n π (sin φ − φ cos φ),   φ = π/n

    With a stationary root n − 1 robots share the directions within 75° of one, and the fraction
    0.78 keeps the root deep enough (docs/proofs.md, D1).
    """
    m = np.asarray(n, dtype=np.float64) - led
    angle = np.pi / m
    if led:
        angle = (_WIDE if dim == 2 else np.pi * (1.0 - math.cos(_WIDE)) / 2.0) / m
    total = 2.0 * m * (1.0 - np.cos(angle))
    if dim == 3:
        total = m * np.pi * (np.sin(angle) - angle * np.cos(angle))
    return np.asarray(total * (_DEEP if led else 1.0))


def one_crash(scenario: Scenario, asked: Asked) -> str:
    """One robot crashes, and all others reach it along links."""
    count = len(scenario.events.crashes) + scenario.events.n_crashed
    if count > 1:
        return TWO_CRASHED
    return "" if count else "none: no robot crashes"


def crashed_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Bounds after one robot has crashed: it is then a stationary root."""
    after = last_failure(scenario)
    found = bounds(scenario, asked, led=True)
    words = f"theorem G: the others meet at the crashed robot, from {after:.4g} s on"
    time = after + found.time
    return replace(found, words=words, time=time, continuous_time=math.inf)


def bounds(scenario: Scenario, asked: Asked, led: bool | None = None) -> TheoremBounds:
    """Bounds on both times and on L, with a stationary root if ``led``; None is as on the graph."""
    (gains, most), m, dim = _gains(scenario, asked), known.robots_left(scenario), scenario.dim
    led = known.led(scenario) if led is None else led
    hull = hull_bounds(scenario, asked).hull
    spare = max(scenario.merge_radius - scenario.tau * most, 0.0)
    held = gains * depth_gained(m, dim, led) * spare / (spare + 2.0 * scenario.tau * gains)
    followed = (shrinking_to_leader if led else shrinking)(m, dim, gains).min()
    who, first = "every policy that weighs neighbours", "theorem G"
    if asked.by == "law":
        mutual = known.kind_of_links(scenario.sensing_graph) == known.UNDIRECTED
        first = (
            "theorems 1 and G" if mutual and not given.nearest_always_visible(scenario) else first
        )
        who = "law (1)" + ", with velocities scaled to the step," * scenario.scales_velocity
    words = (
        f"{first}: {who} meets in finite time, and the hull does not grow while linked robots are "
        "r or more apart"
    )
    time = float(known.held_time(scenario, hull, held))
    continuous = float(known.over_rate(known.largest_size(scenario), followed))
    return TheoremBounds(words, meets=True, time=time, continuous_time=continuous, hull=hull)


_HULL = given.velocity_inputs, given.bounded_errors, given.no_obstacles
_WITHIN = given.within_neighbours, given.exact_bearings
_NESTED = *_WITHIN, given.outlasts_rounding  # or robots may leave the hull by any distance
_SEEN = given.bounded_errors, given.some_neighbour_visible, given.no_obstacles
_SLOW = "crash", "blind", "slip"
_CRASHED = one_crash, *given.TEAM, *_SEEN, *_WITHIN
_LAW_HULL = *_HULL, given.all_neighbours_visible, *_NESTED
THEOREMS = (
    Theorem("G", ("law", "gains"), (*given.JOINED, *_SEEN, *_WITHIN), bounds, every_step="nested"),
    Theorem(
        "G, the hull",
        ("gains",),
        (*_HULL, *_NESTED),
        hull_bounds,
        False,
        "nested",
        ("stop",),
        _SLOW,
    ),
    Theorem("G, the hull", ("law",), _LAW_HULL, hull_bounds, False, "nested", ("stop",), _SLOW),
    Theorem("G, one crash", ("law", "gains"), _CRASHED, crashed_bounds, events=_SLOW[:2]),
)
