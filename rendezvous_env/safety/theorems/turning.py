"""Theorems T, 3 and 4: nonholonomic robots with a limited turn rate, and mixed teams.

**T.** Fixed, undirected, connected graph, exact bearings of all neighbours, no obstacles; unicycles
or 3-D nonholonomic robots under the gate of ``HeadingVectorWrapper``, zero-order hold, any desired
turn rates. With ω the turn limit (at most 3 rad/s; a wrapper must not use less), F = min_m 2c_m/m,
s_min as in theorem D and

    p = min(ωτ, 0.7 τF, π/3),  K = ⌈1.25/p⌉ + 2,  θ = 1/10,
    in 3-D  p = min(ωτ, π/2),  K = ⌈π/(2p)⌉ + 2,  θ = min(1, p²)/10,
    q = min( τ s_min ε²F²/5,  θ²F²r²/(2.5 D̄²Kτ) ),

V decreases by q in every K steps without a merge: T ≤ Kτ (V0⁺/q + n). Proof: docs/proofs.md, T.

**3 and 4.** Laws (7)(8) and (12)(17) of the paper achieve rendezvous in continuous time, without a
known time bound.

**Mixed teams.** Some robots are single integrators, the others unicycles (nonholonomic robots in
3-D). T has the same bound: single integrators under certified headings are productive in every step
that they begin with ‖f‖ ≥ 2δ. Theorem 3 holds where the single integrators move by law (1).
Proof: docs/proofs.md, Mixed teams.
"""

import math

from ...scenario.scenario import Scenario
from ..settings import MAX_TURN_RATE
from . import assumptions as given
from . import constants as known
from .theorem import Asked, Theorem, TheoremBounds

_LEAST_TURN = 2.0**-40  # rad


def turning_window(dim: int, turned: float) -> tuple[int, float]:
    """Numbers K (steps) and θ (rad) for a turn per step of p = ``turned``, rad (theorem T).

    One of K steps is productive if f rotates by less than θ in all.
    """
    if dim == 2:
        return math.ceil(1.25 / turned) + 2, 0.1
    return math.ceil(math.pi / (2.0 * turned)) + 2, min(1.0, turned**2) / 10.0


def _pull_and_turn(scenario: Scenario) -> tuple[float, float]:
    """F, m/s, and p, rad (theorem T)."""
    least = float((2.0 * known.min_degrees(scenario) / known.robots_left(scenario)).min())
    most = (0.7 * scenario.tau * least, math.pi / 3.0) if scenario.dim == 2 else (math.pi / 2.0,)
    return least, min(min(scenario.min_turn_limit, MAX_TURN_RATE) * scenario.tau, *most)


def turns_outlast_rounding(scenario: Scenario, asked: Asked) -> str:
    """The turn per step is at least 2⁻⁴⁰ rad, well above float64 rounding (2⁻⁵² rad)."""
    _, turned = _pull_and_turn(scenario)
    if turned >= _LEAST_TURN:
        return ""
    return (
        f"none: a step may turn robots by as little as {turned:.3g} rad, below the rounding error "
        f"of their angles; it must be {_LEAST_TURN:.3g} rad or more: make time_step or "
        "max_turn_rate "
        "larger"
    )


def gated_window(scenario: Scenario, min_alignment: float) -> tuple[int, float]:
    """Numbers K (steps) and q, m²/s: V decreases by q in K steps without a merge (theorem T)."""
    step, r = scenario.tau, scenario.merge_radius
    least, turned = _pull_and_turn(scenario)
    count, drift = turning_window(scenario.dim, turned)
    strayed = (drift * least * r / scenario.max_degree) ** 2 / (2.5 * count * step)
    aligned = step * known.scale_bound(scenario) * (min_alignment * least) ** 2 / 5.0
    return count, min(aligned, strayed)


def gate_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Theorem T."""
    count, fall = gated_window(scenario, asked.min_alignment)
    windows = known.over_rate(known.lyapunov_bound(scenario), fall) + scenario.n_robots
    words = (
        "theorem T: under the gate nonholonomic robots meet in finite time, for any desired turn "
        "rates"
    )
    if scenario.mixes_models:
        words = (
            "theorem T, mixed teams: under certified headings and the gate all robots meet in "
            "finite time, for any desired headings and turn rates"
        )
    words += (
        "; the bound is very loose and needs a wrapper that allows "
        f"{min(scenario.min_turn_limit, MAX_TURN_RATE):g} rad/s"
    )
    return TheoremBounds(words, meets=True, time=float(count * scenario.tau * windows))


def planar_if_mixed(scenario: Scenario, asked: Asked) -> str:
    """A mixed team moves in the plane, where its laws have no singularity."""
    if not scenario.mixes_models or scenario.dim == 2:
        return ""
    return (
        "none: law (17) is singular where a robot points up or down, and no theorem covers it in a "
        'mixed team; by="heading" has one'
    )


def law_bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Theorems 3 and 4."""
    words = f"{scenario.model.theorem}: the paper's law meets in continuous time; no bound"
    if scenario.mixes_models:
        words = (
            "theorems 1 and 3, mixed teams: the law of each robot's model meets in continuous "
            "time; no bound"
        )
    return TheoremBounds(words, meets=True)


_LASTS = given.outlasts_rounding, turns_outlast_rounding
THEOREMS = (
    Theorem("T", ("heading",), (*given.TURNING, *_LASTS), gate_bounds),
    Theorem("3 and 4", ("law",), (*given.TURNING, planar_if_mixed), law_bounds),
)
