"""Theorem E1: law (1) with delayed bearings.

**Assumptions.** Fixed, undirected, connected graph; law (1) with exact bearings delayed by k steps,
(k+1) τ ≤ r/(2D̄), also at merges; single integrators with fixed frames; no obstacles.

**Promise**, s = min(1, v_max/D̄):

    T ≤ V_late max_m m/(4 s c_m²) + (n−1)(k+1) τ,      V ≤ V_late = V0⁺ + (n−1)(2 r W + n r D̄/2).

Proof, and other ages: docs/proofs.md, E1.
"""

from ...scenario.scenario import Scenario
from . import assumptions as given
from . import constants as known
from .theorem import Asked, Bounds, Theorem


def small_delay(scenario: Scenario, asked: Asked) -> str:
    """(k+1) τ ≤ r/(2D̄): the age of delayed and held bearings is small enough."""
    age = (scenario.delay_steps + 1) * scenario.tau
    oldest = scenario.merge_radius / (2.0 * scenario.max_degree)
    if age <= oldest * (1 + 1e-12):
        return ""
    return (
        f"none: late and held, bearings are up to {age:.4g} s old, and theorem E1 needs no more "
        f"than r/(2D̄) = {oldest:.4g} s"
    )


def bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Bounds on the time and on V."""
    n, degree, late = scenario.n_robots, scenario.max_degree, scenario.delay_steps
    meanwhile = (n - 1) * n * scenario.merge_radius * degree / 2.0
    most = float(known.lyapunov_bound(scenario))
    most += 2.0 * known.merge_rise_allowance(scenario) + meanwhile
    slowest = min(1.0, scenario.min_speed_limit / degree) * known.min_bearing_square(scenario)
    time = float(known.over_rate(most, slowest) + (n - 1) * (late + 1) * scenario.tau)
    words = f"theorem E1: law (1) meets in finite time on bearings that are {late} steps late"
    return Bounds(words, meets=True, time=time, lyapunov=most)


_late = given.flawed_by("delay", "theorem E1 is for bearings that are late and nothing else")
_LATE = *given.TEAM, _late, given.no_obstacles, small_delay, given.frames_stay
THEOREMS = (Theorem("E1", ("law",), _LATE, bounds),)
