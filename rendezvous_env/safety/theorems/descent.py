"""Theorems A, B, C and N2: V decreases under law (1), and under headings with a minimum alignment.

**Assumptions.** Fixed, undirected, connected graph; robots whose action is their velocity; exact
bearings of all neighbours, inputs held over τ ≤ r/(2D̄) or velocities scaled by r/(2 D_i τ);
no obstacles; neighbours always merge at r. A: law (1), ε = 1. B: law (4),
|h_iᵀf_i| ≥ ε‖f_i‖. C: certified headings.

**Promise.** V never rises between merges, never exceeds V0⁺ = V(0) + (n−1) r W, and

    T ≤ σ n V0⁺/(4 ε² a*²)      and      T ≤ σ V0⁺ max_m m/(4 ε² c_m²) + (n−1) τ,

σ = max(1, 2D̄τ/r) max(1, D̄/v_max), v_max of the slowest robot; on a complete graph of equal
weights a without obstacles, T ≤ σ V(0)/(2 (n−1) ε² a²). With obstacles, V is bounded in motion
without a contact; so is V of nonholonomic robots under headings. As inequality (1) of the proofs is
a sum over robots, V also never rises if some of them do not move in a step
(``Scenario.hold="stop"``). Proof: docs/proofs.md, A to C.

**N2.** Law (1) as in theorem A with failures and disturbances (``Scenario.events``): sensors fail
until a time t_f, robots execute a share of at least s of f_i, and a velocity of at most w is added.
With w > 0 no sensor fails, v_max ≥ D̄ and τ ≤ r/(2D̄). Then s = 1 − slip, else (1 − slip) times
min(1, r/(2D̄τ), v_max/D̄). If w < s min_m 2c_m/m,

    V ≤ V_w = V0⁺ + (n−1) τ n w²/s,
    T ≤ t_f + V_w/min_m(4 s c_m²/m − m w²/s) + (n−1) τ.

Proof: docs/proofs.md, N2.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...checks import raise_invalid
from ...scenario.scenario import Scenario
from ..settings import bounded_error, check_share
from . import assumptions as given
from . import constants as known
from .theorem import Asked, Theorem, TheoremBounds, at_least

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
    slowed *= max(1.0, scenario.max_degree / scenario.min_speed_limit)
    most, square = known.lyapunov_bound(scenario, initial), min_alignment**2
    bound = np.minimum(
        known.over_rate(n * most, 4.0 * square * a**2 / slowed),
        known.held_time(scenario, most, square * known.min_bearing_square(scenario) / slowed),
    )
    if known.merges_at_midpoints(scenario):
        alike = known.over_rate(initial, 2.0 * (n - 1) * square * a**2 / slowed)
        bound = np.minimum(bound, alike)
    return np.asarray(bound)


def lyapunov_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """V never increases between merges under law (1), certified headings or the gate."""
    return TheoremBounds(lyapunov=float(known.lyapunov_bound(scenario)))


def time_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Time bounds of theorems A and C."""
    long = known.long_step(scenario)
    if asked.by == "law":
        words = "theorem 1: law (1) meets in finite time" + long * (
            ", with velocities scaled by min(1, r/(2 D_i τ)), as in the policy bearing-only "
            "(theory 4)"
        )
    else:
        words = "theorems 2 and C: every policy under certified headings meets in finite time"
        words += " with velocities scaled to the long step" * long
    start = known.largest_lyapunov(scenario)
    time = float(time_bound(scenario, start, min_alignment=asked.min_alignment))
    return TheoremBounds(words, True, time, lyapunov=float(known.lyapunov_bound(scenario)))


def _disturbed_rates(scenario: Scenario) -> tuple[float, Array]:
    """s, without unit, and s 4c_m²/m − m w²/s, an array (n − 1,), (m/s)² (theorem N2)."""
    events, left = scenario.events, known.robots_left(scenario)
    share = 1.0 - events.slip
    if events.disturbance == 0.0:
        share *= known.scale_bound(scenario)
    if share <= 0.0:
        return 0.0, np.zeros(len(left))
    pull = share * 4.0 * known.min_degrees(scenario) ** 2 / left
    return share, pull - left * events.disturbance**2 / share


def has_events(scenario: Scenario, asked: Asked) -> str:
    """There are failures or disturbances."""
    return "none: theorem N2 is for failures and disturbances" if scenario.events.none else ""


def small_disturbance(scenario: Scenario, asked: Asked) -> str:
    """Bound w < s min_m 2c_m/m, and robots without a working sensor are not disturbed."""
    events, left = scenario.events, known.robots_left(scenario)
    if events.disturbance > 0.0 and "blind" in events.kinds:
        return "none: a robot whose sensor has failed drifts with the disturbance"
    share = 1.0 - events.slip
    most = share * float((2.0 * known.min_degrees(scenario) / left).min())
    if share > 0.0 and (events.disturbance == 0.0 or events.disturbance < most):
        return ""
    if share <= 0.0:
        return "none: with slip = 1 robots may never move; it must be less"
    return (
        f"none: events.disturbance is {events.disturbance:.4g} m/s, and theorem N2 tolerates less "
        f"than {at_least(most)} m/s here: from there on it can move robots as fast as law (1)"
    )


def unlimited_if_disturbed(scenario: Scenario, asked: Asked) -> str:
    """With a disturbance: v_max ≥ D̄ and τ ≤ r/(2D̄)."""
    slow = scenario.min_speed_limit < scenario.max_degree * (1 - 1e-12)
    if scenario.events.disturbance == 0.0 or not (slow or known.long_step(scenario)):
        return ""
    return (
        "none: with a disturbance theorem N2 needs max_speed of at least "
        f"{scenario.max_degree:.6g} m/s and time_step of at most {scenario.certified_step:.6g} s"
    )


def progress_outlasts_rounding(scenario: Scenario, asked: Asked) -> str:
    """As ``outlasts_rounding``, for the progress reduced by disturbances."""
    share, rates = _disturbed_rates(scenario)
    pull = 4.0 * known.min_degrees(scenario) ** 2 / known.robots_left(scenario)
    left = min(share, float((rates / pull).min()))
    return given.outlasts_rounding(scenario, asked._replace(min_alignment=left))


def last_failure(scenario: Scenario) -> float:
    """Time from which all sensors work and no more robots crash, s, or 0 (theorem N2)."""
    events, tau = scenario.events, scenario.tau
    if events.n_blind + events.n_crashed > 0:
        return (scenario.max_steps + 1) * tau
    ends = [0.0, *(end for _, _, end in events.sensor_failures)]
    ends += [time for _, time in events.crashes]
    return max(ends) + tau * (max(ends) > 0.0)  # an event waits for the next step


def disturbed_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Bounds of theorem N2 on the time and on V."""
    n, (share, rates) = scenario.n_robots, _disturbed_rates(scenario)
    reach = max(scenario.merge_radius / 2.0, scenario.speed_limit * scenario.tau)
    disturbed = scenario.events.disturbance > 0.0
    most = float(known.lyapunov_bound(scenario, reach=reach if disturbed else None))
    most += (n - 1) * scenario.tau * n * scenario.events.disturbance**2 / share
    time = last_failure(scenario) + float(known.held_time(scenario, most, rates))
    words = f"theorem N2: law (1) meets in finite time with {scenario.events}"
    return TheoremBounds(words, meets=True, time=time, lyapunov=most)


# With zero-order hold the paper's nonholonomic laws can increase V slightly; certified ones cannot.
_HELD = given.certified_or_scaled, given.exact_bearings
_LAW_V = *given.LASTING_LINKS, given.merges_everywhere, given.velocity_inputs, *_HELD
_SLOW = "crash", "blind", "slip"  # robots do not move, or move less; (1) is a sum over them
_DISTURBED = (
    *(has_events, *given.UNHINDERED, *_HELD),
    *(small_disturbance, unlimited_if_disturbed, progress_outlasts_rounding),
)
_A = Theorem("A", ("law",), (*given.UNHINDERED, *_HELD), time_bounds)
_C = Theorem("C", ("heading",), (*given.UNHINDERED, given.exact_bearings), time_bounds)
THEOREMS = (
    _A,
    Theorem("V", ("law",), _LAW_V, lyapunov_bounds, False, "descent", ("stop",), _SLOW),
    _C,
    Theorem("V", ("heading",), given.KEPT, lyapunov_bounds, False, "descent", ("stop",), _SLOW[:2]),
    Theorem("N2", ("law",), _DISTURBED, disturbed_bounds, events=("blind", "slip", "disturbance")),
)
