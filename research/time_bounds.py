"""Rendezvous time bounds beyond certificates: general graphs, pursuit, and a lower bound.

**C4.** Law (4) with headings in the cone of the bearings, h_i ∈ cone{g_ij} and h·f ≥ ε‖f‖. On any
graph on which every robot has a neighbour, the hull is nested and T ≤ n² L0/(16 ε d_min). In 3-D, T
≤ n² w0/(4 ε d_min). d_min is the minimum of Σ_j a_ij. (Law (4) without the cone lets teams on
switching graphs grow without end for ε < 0.277.)

**Windows**, in the plane, all pairs merge. Every window of duration T_w contains, for *each robot*,
an interval of at least τ_d with a visible neighbour and gains in [c, C]. Joint connectivity alone
is not sufficient. Then

    T ≤ T_w (n + L0/ΔL),      ΔL = (π/n)(c/3) s min(τ_d, r s/(4C)),      s = sin(π/(2n)).

**E2.** A fixed graph, directed or not, on which every robot always has a neighbour. Each robot
pursues one neighbour until a merge: it turns towards it at ω_max and drives at c < ω_max r/2, only
while it points at it. In continuous time T ≤ L0/(2 c κ(n)) + n π/(ω_max − 2c/r); in 3-D the first
term is n w0/(2c). There is no guarantee for switching links or a stationary root. No wrapper
implements it; the policy ``pursuit`` does.

**Lower bound** (theory 3). No policy meets before its robots can reach a common point.

**Proof.** docs/proofs.md, C4, windows and E2.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.references.enclosing_ball import smallest_enclosing_ball
from rendezvous_env import Scenario
from rendezvous_env.checks import raise_invalid
from rendezvous_env.safety.theorems import constants as known
from rendezvous_env.safety.theorems.gains import shrinking, shrinking_to_leader

Array = NDArray[np.float64]


def gains_time(n: int, dim: int, initial_size: ArrayLike, gain: ArrayLike) -> Array:
    """T for any gains c_ij ≥ 0 with Σ_j c_ij ≥ c, m/s, on any graph, (...), s, from L0, (...), m.

    It holds in continuous time.
    """
    return np.asarray(np.asarray(initial_size) / shrinking(n, dim, gain))


def led_time(n: int, dim: int, initial_size: ArrayLike, gain: ArrayLike) -> Array:
    """As ``gains_time`` with one stationary root, which needs no neighbour, s."""
    return np.asarray(np.asarray(initial_size) / shrinking_to_leader(n, dim, gain))


def links_time(
    n: int,
    lyapunov_bound: ArrayLike,
    *,
    least_degree: float,
    step: float,
    share: float = 1.0,
    error: ArrayLike = 0.0,
) -> Array:
    """T under connectivity maintenance with limited sensing range, (...), s.

    Inputs are held over τ ≤ r/(2D̄), without a speed limit. Arguments are V_tot, m²/s, d, m/s, τ,
    s, λ in (0, 1], and η, rad; T is infinite from η = π/(2n) on.
    """
    left = np.maximum(1.0 - 2.0 * n * np.asarray(error) / np.pi, 0.0)
    rate = 4.0 * share * least_degree**2 * left**2
    return known.over_rate(n * np.asarray(lyapunov_bound), rate) + (n - 1) * step


def windows_time(
    n: int,
    initial_size: ArrayLike,
    *,
    least_gain: float,
    most_gain: float,
    window: float,
    least_duration: float,
    merge_radius: float,
) -> Array:
    """T in the plane if each robot has a neighbour in every time window, (...), s.

    Arguments are L0, (...), m, c and C, m/s, T_w and τ_d, s, and r, m.
    """
    s = np.sin(np.pi / (2.0 * n))
    lasting = min(least_duration, merge_radius * s / (4.0 * most_gain))
    least_fall = np.pi / n * least_gain / 3.0 * s * lasting
    return np.asarray(window * (n + np.asarray(initial_size) / least_fall))


def cone_time(
    n: int, dim: int, initial_size: ArrayLike, least_degree: ArrayLike, min_alignment: ArrayLike
) -> Array:
    """T of law (4) with headings in the cone of the bearings, (...), s (C4).

    Arguments are L0, m, d_min, m/s, and ε in (0, 1].
    """
    factor = 16.0 if dim == 2 else 8.0 * np.pi
    rate = factor * np.asarray(min_alignment) * np.asarray(least_degree)
    return np.asarray(n**2 * np.asarray(initial_size) / rate)


def pursuit_bound(scenario: Scenario, initial_size: ArrayLike, speed: float) -> Array:
    """Rendezvous time bound of pursuers of speed c, m/s, with a turn limit, (...), s (theorem E2).

    The bound is computed from L(0), m. It is infinite on graphs that switch, depend on distance, or
    have a stationary root. A ValueError names a speed at which a target can leave the visible
    range, or an invalid perimeter.
    """
    n, fastest = scenario.n_robots, scenario.turn_limit * scenario.merge_radius / 2.0
    if not 0 < speed < fastest:
        raise_invalid("speed", speed, f"positive and less than ω_max r/2 = {fastest:.6g} m/s")
    spare = scenario.turn_limit - 2.0 * speed / scenario.merge_radius
    driving = known.checked("initial_size", initial_size, "m") / shrinking(n, scenario.dim, speed)
    lasting = known.kind_of_links(scenario.sensing_graph) in (known.UNDIRECTED, known.DIRECTED)
    if not lasting or [len(group) for group in known.leaders(scenario)] != [n]:
        return np.full(driving.shape, np.inf)
    return np.asarray(driving + n * math.pi / spare)


def rendezvous_time_lower_bound(scenario: Scenario, positions: ArrayLike) -> float:
    """Lower bound on the rendezvous time of any policy from positions (n, d), m, a number, s.

    T ≥ (R − (n − 1) r/2)/v_max; with obstacles (n − 1) r replaces (n − 1) r/2 (theory 3).
    """
    _, radius = smallest_enclosing_ball(positions)
    reach = (scenario.n_robots - 1) * scenario.merge_radius * (1.0 if scenario.obstacles else 0.5)
    return max(0.0, radius - reach) / scenario.speed_limit
