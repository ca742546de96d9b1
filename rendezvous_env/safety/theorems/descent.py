"""Theorems A, B and C: V falls under law (1), and under any headings that keep a margin.

**Assumptions.** Fixed, undirected, connected graph; robots whose action is their velocity; exact
bearings of all neighbours, inputs held over τ ≤ r/(2D̄) or velocities scaled by r/(2 D_i τ);
nothing in the way; neighbours merge at r, whatever is between them. A: law (1), ε = 1. B: law (4),
|h_iᵀf_i| ≥ ε‖f_i‖. C: certified headings.

**Promise.** V never rises between merges, never exceeds V0⁺ = V(0) + (n−1) r W, and

    T ≤ σ n V0⁺/(4 ε² a*²)      and      T ≤ σ V0⁺ max_m m/(4 ε² c_m²) + (n−1) τ,

σ = max(1, 2D̄τ/r) max(1, D̄/v_max); on a complete graph of equal weights a without obstacles,
T ≤ σ V(0)/(2 (n−1) ε² a²). With obstacles, V is bounded in motion without a contact; so is V of
nonholonomic robots under headings. As inequality (1) of the proofs is a sum over robots, V also
never rises where some of them stand still in a step (``Scenario.hold="stop"``).
Proof: docs/proofs.md, A to C.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...checks import raise_invalid
from ...scenario.scenario import Scenario
from ..settings import bounded_error, check_share
from . import assumptions as given
from . import constants as known
from .theorem import Asked, Bounds, Theorem

Array = NDArray[np.float64]


def time_bound(
    scenario: Scenario, initial_lyapunov: ArrayLike, *, min_alignment: float = 1.0
) -> Array:
    """Bound on the rendezvous time with zero-order hold, (...), s (theorems A and C).

    For V(0), (...), m²/s, on the scenario's graph; infinite where nothing is guaranteed.

    Raises:
        ValueError: for an ε outside (0, 1], or an invalid V(0).
    """
    check_share("min_alignment", min_alignment)
    if not isinstance(scenario, Scenario):
        raise_invalid("scenario", scenario, "a Scenario; scenarios.resolve() takes names and files")
    initial = known.checked("initial_lyapunov", initial_lyapunov, "m²/s")
    theorem = _A if min_alignment == 1 else _C
    error = bounded_error(scenario.sensing, scenario.dim)
    asked = Asked(theorem.by[0], min_alignment=min_alignment, error=error)
    if theorem.unmet(scenario, asked)[1]:
        return np.full(initial.shape, np.inf)
    n, a = scenario.n_robots, scenario.bottleneck_weight
    slowed = max(1.0, 2.0 * scenario.max_degree * scenario.tau / scenario.merge_radius)
    slowed *= max(1.0, scenario.max_degree / scenario.speed_limit)
    most, square = known.lyapunov_bound(scenario, initial), min_alignment**2
    bound = np.minimum(
        known.over_rate(n * most, 4.0 * square * a**2 / slowed),
        known.held_time(scenario, most, square * known.min_bearing_square(scenario) / slowed),
    )
    if known.merges_at_midpoints(scenario):
        alike = known.over_rate(initial, 2.0 * (n - 1) * square * a**2 / slowed)
        bound = np.minimum(bound, alike)
    return np.asarray(bound)


def lyapunov_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """V never increases between merges under law (1), certified headings or the gate."""
    return Bounds(lyapunov=float(known.lyapunov_bound(scenario)))


def time_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Time bounds of theorems A and C."""
    long = known.long_step(scenario)
    if asked.by == "law":
        words = "theorem 1: law (1) meets in finite time" + long * (
            ", with velocities scaled by r/(2 D_i τ) where that is below 1, as the policy "
            "bearing-only does here (theory 4)"
        )
    else:
        words = "theorems 2 and C: every policy under certified headings meets in finite time"
        words += " with velocities scaled to the long step" * long
    start = known.largest_lyapunov(scenario)
    time = float(time_bound(scenario, start, min_alignment=asked.min_alignment))
    return Bounds(words, True, time, lyapunov=float(known.lyapunov_bound(scenario)))


# The paper's laws for robots that turn, held, can raise V a little; certified ones cannot.
_HELD = given.certified_or_scaled, given.exact_bearings
_LAW_V = *given.LASTING_LINKS, given.merges_everywhere, given.velocity_inputs, *_HELD
_A = Theorem("A", ("law",), (*given.UNHINDERED, *_HELD), time_bounds)
_C = Theorem("C", ("heading",), (*given.UNHINDERED, given.exact_bearings), time_bounds)
THEOREMS = (
    _A,
    Theorem("V", ("law",), _LAW_V, lyapunov_bounds, False, "descent", ("stop",)),
    _C,
    Theorem("V", ("heading",), given.KEPT, lyapunov_bounds, False, "descent", ("stop",)),
)
