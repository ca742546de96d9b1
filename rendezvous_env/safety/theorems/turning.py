"""Theorems T, 3 and 4, and E2: robots that turn at a limited rate.

**T.** Fixed, undirected, connected graph, exact bearings of all neighbours, nothing in the way;
unicycles or 3-D nonholonomic robots under the gate of ``HeadingVectorWrapper``, inputs held over
the step, whatever turn rates are wished for. With ω the turn limit, or the wrapper's if that is
less (3 rad/s here), F = min_m 2c_m/m, s_min as in theorem D and

    p = min(ωτ, 0.7 τF, π/3),  K = ⌈1.25/p⌉ + 2,  θ = 1/10,
    in 3-D  p = min(ωτ, π/2),  K = ⌈π/(2p)⌉ + 2,  θ = min(1, p²)/10,
    q = min( τ s_min ε²F²/5,  θ²F²r²/(2.5 D̄²Kτ) ),

V falls by q in every K steps without a merge: T ≤ Kτ (V0⁺/q + n). It is very loose.

**3 and 4.** The paper's laws (7)(8) and (12)(17) meet in continuous time, by no known time.

**E2.** A fixed graph, directed or not, on which everybody always sees somebody. Each robot pursues
one that it sees until a merge: it turns towards it at ω_max and drives at c < ω_max r/2, only while
it points at it. In continuous time T ≤ L0/(2 c κ(n)) + n π/(ω_max − 2c/r), in 3-D n w0/(2c) in
the first term. Where links change a target may go out of sight at any time; a leader that rests
brings nobody together: there nothing is promised. No wrapper keeps it; policy ``pursuit`` does.

**Proof.** docs/proofs.md, T and E2.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...checks import refuse
from ...scenario.scenario import Scenario
from . import assumptions as given
from .constants import (
    DIRECTED,
    UNDIRECTED,
    checked,
    kind_of_links,
    largest_lyapunov,
    leaders,
    least_degrees,
    lyapunov_bound,
    over_rate,
    scale_bound,
)
from .gains import shrinking
from .theorem import Asked, Bounds, Theorem

Array = NDArray[np.float64]

_WRAPPER_TURN_RATE = 3.0
"""Of the wrapper, if it is given no other, rad/s."""

# ---- E2 ------------------------------------------------------------------------------------------


def everybody_always_sees_somebody(scenario: Scenario) -> bool:
    """Whether a fixed graph is connected, and no group of its robots sees nobody outside."""
    lasting = kind_of_links(scenario.sensing_graph) in (UNDIRECTED, DIRECTED)
    return lasting and [len(group) for group in leaders(scenario)] == [scenario.n_robots]


def pursuit_bound(scenario: Scenario, initial_size: ArrayLike, speed: float) -> Array:
    """Time by which pursuers of speed c, m/s, with a turn limit have met, (...), s, from L(0), m
    (theorem E2).

    Infinite on graphs that switch, go with distance, or have a leader.

    Raises:
        ValueError: for a speed at which a target can run out of sight, or a size that is none.
    """
    n, fastest = scenario.n_robots, scenario.turn_limit * scenario.merge_radius / 2.0
    if not 0 < speed < fastest:
        refuse("speed", speed, f"positive and less than ω_max r/2 = {fastest:.6g} m/s")
    spare = scenario.turn_limit - 2.0 * speed / scenario.merge_radius
    driving = checked("initial_size", initial_size, "m") / shrinking(n, scenario.dim, speed)
    if not everybody_always_sees_somebody(scenario):
        return np.full(driving.shape, np.inf)
    return np.asarray(driving + n * math.pi / spare)


# ---- T, 3 and 4 ----------------------------------------------------------------------------------


def gated_window(scenario: Scenario, min_alignment: float) -> tuple[int, float]:
    """K, a number of steps, and q, m²/s: V falls by q in K steps without a merge (theorem T)."""
    step, left = scenario.tau, np.arange(2.0, scenario.n_robots + 1.0)
    least = float((2.0 * least_degrees(scenario) / left).min())
    turned = min(scenario.turn_limit, _WRAPPER_TURN_RATE) * step
    if scenario.dim == 2:
        turned = min(turned, 0.7 * step * least, math.pi / 3.0)
        count, drift = math.ceil(1.25 / turned) + 2, 0.1
    else:
        turned = min(turned, math.pi / 2.0)
        count, drift = math.ceil(math.pi / (2.0 * turned)) + 2, min(1.0, turned**2) / 10.0
    strayed = (drift * least * scenario.merge_radius / scenario.max_degree) ** 2
    aligned = step * scale_bound(scenario) * (min_alignment * least) ** 2 / 5.0
    return count, min(aligned, strayed / (2.5 * count * step))


def gated_time(scenario: Scenario, initial_lyapunov: ArrayLike, min_alignment: float) -> Array:
    """Time by which robots under the gate have met, whatever is wished for, (...), s, from V(0),
    m²/s (theorem T).
    """
    count, fall = gated_window(scenario, min_alignment)
    windows = over_rate(lyapunov_bound(scenario, initial_lyapunov), fall) + scenario.n_robots
    return np.asarray(count * scenario.tau * windows)


def gate_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Theorem T."""
    return Bounds(
        words=(
            "theorem T: under the gate robots that turn meet in finite time, whatever turn rates "
            "are wished for; the bound is very loose"
        ),
        meets=True,
        time=float(gated_time(scenario, largest_lyapunov(scenario), asked.min_alignment)),
    )


def law_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """Theorems 3 and 4."""
    own = scenario.model.theorem
    return Bounds(words=f"{own}: the paper's law meets in continuous time; no bound", meets=True)


def robots_turn(scenario: Scenario, asked: Asked) -> str:
    """The robot model is one of the paper's that turn."""
    return "none: theorems 3 and 4 are for robots that turn" if scenario.model.bounded else ""


def exact_for_bodies(scenario: Scenario, asked: Asked) -> str:
    """Bearings are not wrong."""
    if asked.error == 0.0:
        return ""
    stays = "; V still never rises between merges" * (asked.by == "heading")
    return f"none: theorems T, 3 and 4 are for exact bearings{stays}"


_BODIES = (*given.LASTING_LINKS, given.nothing_in_the_way, robots_turn, exact_for_bodies)
THEOREMS = (
    Theorem("T", ("heading",), _BODIES, gate_bounds),
    Theorem("3 and 4", ("law",), _BODIES, law_bounds),
)
