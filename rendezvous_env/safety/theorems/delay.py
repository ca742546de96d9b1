"""Theorems E1 and E3: law (1) with delayed bearings, or with commands held by the robots' clocks.

**E1.** Fixed, undirected, connected graph; law (1) with exact bearings delayed by k steps, or by at
most k if robots differ, (k+1) τ ≤ r/(2D̄), also at merges; single integrators with fixed frames; no
obstacles.

With s = min(1, v_max/D̄):

    T ≤ V_late max_m m/(4 s c_m²) + (n−1)(k+1) τ,      V ≤ V_late = V0⁺ + (n−1)(2 r W + n r D̄/2).

**E3.** As E1 with current bearings, but each robot takes a new command at least once in every k
steps (``Scenario.activation``). With θ = 2D̄τ/r:

* ``hold="command"``, θ + (k−1)² θ² ≤ 1, so τ ≤ θ_k r/(2D̄), θ_k = 2/(1 + √(1 + 4(k−1)²)):

    T ≤ V_held max_m m/(4 s c_m²) + (nk − 1) τ,
    V ≤ V_held = V0⁺ + (n−1)(2kθ r W + (k−1)³θ³ n r D̄/2).

* ``hold="stop"``, law (1) as in theorem A, s = min(1, r/(2D̄τ), v_max/D̄): V never rises between
  merges, V ≤ V0⁺, and

    T ≤ k (1/√s + θ√(k−1))² V0⁺ max_m m/(4 c_m²) + n k τ;

  active at random with probability p in each step (no k), the mean time is

    E[T] ≤ (V0⁺ + (n−1) n θ r D̄/2) max_m m/(4 p s c_m²).

Proof: docs/proofs.md, E1 and E3.
"""

import math

from ...checks import counted
from ...scenario.scenario import Scenario
from . import assumptions as given
from . import constants as known
from .theorem import Asked, Theorem, TheoremBounds, at_least


def small_delay(scenario: Scenario, asked: Asked) -> str:
    """(k+1) τ ≤ r/(2D̄): the age of delayed and held bearings is small enough."""
    age = (scenario.delay_steps + 1) * scenario.tau
    oldest = scenario.merge_radius / (2.0 * scenario.max_degree)
    if age <= oldest * (1 + 1e-12):
        return ""
    return (
        f"none: delayed and held bearings are up to {age:.4g} s old, and theorem E1 needs at most "
        f"r/(2D̄) = {oldest:.4g} s"
    )


def bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Bounds on the time and on V."""
    n, degree, late = scenario.n_robots, scenario.max_degree, scenario.delay_steps
    meanwhile = (n - 1) * n * scenario.merge_radius * degree / 2.0
    most = float(known.lyapunov_bound(scenario))
    most += 2.0 * known.merge_rise_allowance(scenario) + meanwhile
    slowest = min(1.0, scenario.min_speed_limit / degree) * known.min_bearing_square(scenario)
    time = float(known.over_rate(most, slowest) + (n - 1) * (late + 1) * scenario.tau)
    most_late = "up to " * bool({"delay", "delay_time"} & {*scenario.sensing.per_robot})
    steps = f"{most_late}{counted(late, 'step')}"
    words = f"theorem E1: law (1) meets in finite time with bearings delayed by {steps}"
    return TheoremBounds(words, meets=True, time=time, lyapunov=most)


def asynchronous(scenario: Scenario, asked: Asked) -> str:
    """Some robots skip steps."""
    synchronous = "none: theorem E3 is for asynchronous activation; these robots are synchronous"
    return synchronous if scenario.activation.synchronous else ""


def bounded_wait(scenario: Scenario, asked: Asked) -> str:
    """Each robot is active at least once in a known number of steps."""
    if math.isfinite(scenario.activation.longest_wait):
        return ""
    mean = "; see expected_time_bound for the mean" * (scenario.hold == "stop")
    return f"none: random activation has no bound on the time without a new command{mean}"


def drawn_activation(scenario: Scenario, asked: Asked) -> str:
    """Robots are active at random."""
    if scenario.activation.kind == "random":
        return ""
    return "none: the mean time is known for random activation only"


def longest_held_step(scenario: Scenario) -> float:
    """Longest time step, s, for commands held for up to k steps: θ_k r/(2D̄) (theorem E3)."""
    waits = scenario.activation.longest_wait - 1.0
    return 2.0 / (1.0 + math.sqrt(1.0 + 4.0 * waits**2)) * scenario.certified_step


def short_hold(scenario: Scenario, asked: Asked) -> str:
    """θ + (k−1)² θ² ≤ 1: commands are held for a short time."""
    longest = longest_held_step(scenario)
    if scenario.tau <= longest * (1 + 1e-12):
        return ""
    steps = int(scenario.activation.longest_wait)
    return (
        f"none: commands are held for up to {steps} steps of {scenario.tau:.4g} s, and theorem E3 "
        f"needs a time_step of at most {at_least(longest, 6)} s then; or take hold='stop'"
    )


def _degree_of_step(scenario: Scenario) -> float:
    """θ = 2D̄τ/r, without unit: 1 for the certified step."""
    return 2.0 * scenario.max_degree * scenario.tau / scenario.merge_radius


def held_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Bounds of E3 on the time and on V, with held commands."""
    n, degree, k = scenario.n_robots, scenario.max_degree, scenario.activation.longest_wait
    theta, most = _degree_of_step(scenario), float(known.lyapunov_bound(scenario))
    most += 2.0 * k * theta * known.merge_rise_allowance(scenario)
    most += (n - 1) * ((k - 1.0) * theta) ** 3 * n * scenario.merge_radius * degree / 2.0
    slowest = min(1.0, scenario.min_speed_limit / degree) * known.min_bearing_square(scenario)
    time = float(known.over_rate(most, slowest) + (n * k - 1) * scenario.tau)
    words = f"theorem E3: law (1) meets in finite time with commands held for up to {k:.0f} steps"
    return TheoremBounds(words, meets=True, time=time, lyapunov=most)


def stopped_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Bounds of E3 on the time and on V, if inactive robots do not move."""
    k, most = scenario.activation.longest_wait, float(known.lyapunov_bound(scenario))
    slow = 1.0 / math.sqrt(known.scale_bound(scenario))
    slow += _degree_of_step(scenario) * math.sqrt(k - 1.0)
    fall = known.min_bearing_square(scenario) / (k * slow**2)
    time = float(known.over_rate(most, fall) + scenario.n_robots * k * scenario.tau)
    words = f"theorem E3: law (1) meets in finite time, each robot active once in {k:.0f} steps"
    return TheoremBounds(words, meets=True, time=time, lyapunov=most)


def drawn_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Bound of E3 on the mean time under random activation."""
    n, chance = scenario.n_robots, scenario.activation.probability or 0.0
    most = float(known.lyapunov_bound(scenario))
    cut = _degree_of_step(scenario) * scenario.merge_radius * scenario.max_degree / 2.0
    fall = chance * known.scale_bound(scenario) * known.min_bearing_square(scenario)
    return TheoremBounds(expected_time=float(known.over_rate(most + (n - 1) * n * cut, fall)))


_LATE = *given.TEAM, given.only_late, given.no_obstacles, small_delay, given.frames_stay
_ACTED = asynchronous, *given.UNHINDERED, given.exact_bearings
_HELD = *_ACTED, given.frames_stay, bounded_wait, short_hold
_STOPPED = *_ACTED, given.certified_or_scaled
_WAITED, _DRAWN = (*_STOPPED, bounded_wait), (*_STOPPED, drawn_activation)
THEOREMS = (
    Theorem("E1", ("law",), _LATE, bounds),
    Theorem("E3", ("law",), _HELD, held_bounds, clocks=("command",)),
    Theorem("E3, standing still", ("law",), _WAITED, stopped_bounds, clocks=("stop",)),
    Theorem("E3, the mean", ("law",), _DRAWN, drawn_bounds, rendezvous=False, clocks=("stop",)),
)
