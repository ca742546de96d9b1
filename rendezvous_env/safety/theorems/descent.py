"""Theorems A, B and C: V falls under law (1), and under any headings that keep a margin.

**Assumptions.** Fixed, undirected, connected graph; robots whose action is their velocity; exact
bearings of all neighbours, inputs held over τ ≤ r/(2D̄), or velocities scaled by r/(2 D_i τ)
where that is less than 1; nothing in the way. A: law (1), ε = 1. B: law (4), |h_iᵀf_i| ≥ ε‖f_i‖.
C: any policy under certified headings, a margin ε that fades in the dead zone δ = a*/(2n).

**Promise.** V never rises between merges, never exceeds V0⁺ = V(0) + (n−1) r W, and all have met
by

    T ≤ σ n V0⁺/(4 ε² a*²)      and      T ≤ σ V0⁺ max_m m/(4 ε² c_m²) + (n−1) τ,

σ = max(1, 2D̄τ/r) max(1, D̄/v_max), c_m ≥ a* the least D_i while m robots are left; on a complete
graph of one weight a, no obstacles, T ≤ σ V(0)/(2 (n−1) ε² a²). The first two robots and rest of
a bound without (n−1) τ are paid for by what V still is at the last merge. In continuous time half
of that suffices.

Beside obstacles V alone is bounded, in motion without a contact and twice the rise per merge.
Of robots that turn V alone is bounded here, under headings; turning.py has the rest.

**Proof.** docs/proofs.md, A to C.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...checks import real, refuse
from ...scenario.scenario import Scenario
from ..enclosing_ball import smallest_enclosing_ball
from ..settings import SMALLEST_MARGIN
from . import assumptions as given
from .constants import (
    checked,
    largest_lyapunov,
    least_bearing_square,
    long_step,
    lyapunov_bound,
    merges_at_midpoints,
    over_rate,
)
from .gains import law_held_time
from .noise import held_size_bound
from .theorem import Asked, Bounds, Theorem

Array = NDArray[np.float64]


def time_bound(
    scenario: Scenario,
    initial_lyapunov: ArrayLike,
    *,
    min_alignment: float = 1.0,
    initial_size: ArrayLike | None = None,
) -> Array:
    """Time by which all robots have met with inputs held over the step, (...), s (theorems A and
    C).

    With L(0), m, and law (1): the bounds of theorems N and D1, if they are less. V(0), m²/s, is
    (...). Of the scenario's own graph: weights that a reset is given in its place may lose a bound
    for complete graphs and cycles. Infinite where nothing is guaranteed.

    Raises:
        ValueError: if ``min_alignment`` is not in (0, 1], or V(0) or L(0) not finite or negative.
    """
    check_margin(min_alignment)
    check_scenario(scenario)
    initial = checked("initial_lyapunov", initial_lyapunov, "m²/s")
    if not covered(scenario):
        return np.full(initial.shape, np.inf)
    bound = _by_descent(scenario, initial, min_alignment)
    if initial_size is not None and min_alignment == 1:
        bound = np.minimum(bound, held_size_bound(scenario, initial_size))
        bound = np.minimum(bound, law_held_time(scenario, initial_size))
    return np.asarray(bound)


def _by_descent(scenario: Scenario, initial: Array, margin: float) -> Array:
    """Theorems A and C with the factors of theory 4, s."""
    n, a = scenario.n_robots, scenario.bottleneck_weight
    slowed = max(1.0, 2.0 * scenario.max_degree * scenario.tau / scenario.merge_radius)
    slowed *= max(1.0, scenario.max_degree / scenario.speed_limit)
    most = lyapunov_bound(scenario, initial)
    slowest = margin**2 * least_bearing_square(scenario)
    bound = np.minimum(
        over_rate(n * most, 4.0 * margin**2 * a**2 / slowed),
        over_rate(most, slowest / slowed) + (n - 1) * scenario.tau,
    )
    if merges_at_midpoints(scenario):
        alike = over_rate(initial, 2.0 * (n - 1) * margin**2 * a**2 / slowed)
        bound = np.minimum(bound, alike)
    return np.asarray(bound)


def covered(scenario: Scenario) -> bool:
    """Whether theorems A and C bound the time: undirected links that last, connected, robots whose
    action is their velocity, nothing in the way.
    """
    needed = (given.undirected, given.connected, given.velocity_inputs)
    asked = Asked("law", 1.0, 0.0, None, None, 0.5, 0.0)
    return not given.walled(scenario) and not any(holds(scenario, asked) for holds in needed)


def rendezvous_time_lower_bound(scenario: Scenario, positions: ArrayLike) -> float:
    """No policy meets sooner from a start (n, d), m: T ≥ (R − (n − 1) r/2)/v_max, a number, s; (n −
    1) r with obstacles (theory 3).
    """
    _, radius = smallest_enclosing_ball(positions)
    share = 1.0 if scenario.obstacles else 0.5
    reach = (scenario.n_robots - 1) * scenario.merge_radius * share
    return max(0.0, radius - reach) / scenario.speed_limit


def check_scenario(scenario: object) -> None:
    """Refuse anything but a Scenario, in a ValueError."""
    if not isinstance(scenario, Scenario):
        refuse("scenario", scenario, "a Scenario; scenarios.resolve() takes names and files")


def check_margin(min_alignment: float) -> None:
    """Refuse a margin ε, a number without unit, unless 10⁻⁶ ≤ ε ≤ 1, in a ValueError."""
    if not SMALLEST_MARGIN <= real(min_alignment) <= 1:
        refuse("min_alignment", min_alignment, f"in (0, 1], and at least {SMALLEST_MARGIN:g}")


# ---- the theorems --------------------------------------------------------------------------------


def lyapunov_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """V never rises between merges, for any inputs that keep to law (1), a heading or a gate."""
    return Bounds(lyapunov=float(lyapunov_bound(scenario, largest_lyapunov(scenario))))


def law_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Theorem A."""
    words = "theorem 1: law (1) meets in finite time"
    if long_step(scenario):
        words += (
            ", with velocities scaled by r/(2 D_i τ) where that is below 1, as the policy "
            "bearing-only does here (theory 4)"
        )
    time = float(time_bound(scenario, largest_lyapunov(scenario)))
    return replace(lyapunov_bounds(scenario, asked), words=words, meets=True, time=time)


def heading_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Theorem C."""
    scaled = " with velocities scaled to the long step" if long_step(scenario) else ""
    start = largest_lyapunov(scenario)
    return Bounds(
        words=(
            f"theorems 2 and C: every policy under certified headings meets in finite time{scaled}"
        ),
        meets=True,
        time=float(time_bound(scenario, start, min_alignment=asked.min_alignment)),
    )


def velocities_keep_to_law(scenario: Scenario, asked: Asked) -> str:
    """The paper's laws for robots that turn, held, can raise V a little; certified ones cannot."""
    return "" if asked.by == "heading" else given.velocity_inputs(scenario, asked)


THEOREMS = (
    Theorem(
        "A",
        ("law",),
        (
            *given.LASTING_LINKS,
            given.velocity_inputs,
            given.nothing_in_the_way,
            given.certified_or_scaled,
            given.exact_bearings,
        ),
        law_bounds,
    ),
    Theorem(
        "V",
        ("law",),
        (
            *given.LASTING_LINKS,
            velocities_keep_to_law,
            given.certified_or_scaled,
            given.exact_bearings,
        ),
        lyapunov_bounds,
        rendezvous=False,
    ),
    Theorem(
        "C",
        ("heading",),
        (
            *given.LASTING_LINKS,
            given.nothing_in_the_way,
            given.velocity_inputs,
            given.exact_bearings,
        ),
        heading_bounds,
    ),
    Theorem("V", ("heading",), given.LASTING_LINKS, lyapunov_bounds, rendezvous=False),
)
