"""Theorem D: the energy tank, any motion at all while each robot's own ledger lasts.

**Assumptions.** Fixed, undirected, connected graph, bearings of all neighbours, wrong by η at
most. Robot i is displaced by Δ_i in a step. With s_i = min(1, r/(2 D_i τ), v_max/‖f_i‖) its tank
A_i(0) = B_i ≥ 0 earns

    G_i = 2 f_i·Δ_i − (2/r) D_i ‖Δ_i‖² − ε² τ s_i ‖f_i‖²,

for wrong bearings less 2 e_i ‖Δ_i‖ and with τ s_i max(0, ε‖f̂_i‖ − e_i)² in place of the last
term. What is wanted is done while A_i + G_i ≥ 0, else law (4) along the wanted direction
projected onto the cap of ε.

**Promise.** V + ΣA_i does not rise in a step without merge or contact, so V ≤ V0⁺ + (n−1) r W +
ΣB_i; and without walls, for robots whose action is their velocity, with q = 2ε − 2(1+ε)ρ > 0,

    T ≤ n (V0⁺ + (n−1) r W + ΣB_i)/(a*² q² s_min) + (n−1) τ,      s_min = min(1, r/(2D̄τ), v_max/D̄),

and for exact bearings with max_m m/(4 ε² c_m²) in place of n/(4 ε² a*²), c_m as in theorem C.

**Proof.** docs/proofs.md, D.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...checks import real, refuse
from ...scenario.scenario import Scenario
from ..settings import check_bearing_error
from .assumptions import (
    all_neighbours_seen,
    bounded_errors,
    connected,
    known_bodies,
    nothing_in_the_way,
    undirected,
)
from .constants import (
    largest_lyapunov,
    least_degrees,
    lyapunov_bound,
    merge_rise_allowance,
    over_rate,
    scale_bound,
)
from .descent import check_margin, check_scenario, covered
from .noise import certified_share, certified_time, error_of_share, error_share, forgiven_share
from .theorem import Asked, Bounds, Theorem, too_wrong

Array = NDArray[np.float64]


def tank_lyapunov_bound(
    scenario: Scenario, initial_lyapunov: ArrayLike, *, budget: float = 0.0
) -> Array:
    """The most that V can ever be under an energy tank: V0⁺ + (n − 1) r W + ΣB_i.

    With obstacles in motion without a contact.

    Args:
        scenario: gives n, r, W, and how far a robot can go in a step.
        initial_lyapunov: V(0), (...), m²/s.
        budget: B_i that each robot's tank begins with, m²/s, at least 0.

    Returns:
        (...), m²/s.

    Raises:
        ValueError: if an argument is out of its range.
    """
    check_scenario(scenario)
    if not 0 <= real(budget) < np.inf:
        refuse("budget", budget, "finite and at least 0 m²/s")
    above = lyapunov_bound(scenario, initial_lyapunov, reach=scenario.speed_limit * scenario.tau)
    return above + merge_rise_allowance(scenario) + scenario.n_robots * real(budget)


def tank_time_bound(
    scenario: Scenario,
    initial_lyapunov: ArrayLike,
    *,
    min_alignment: float,
    budget: float = 0.0,
    bearing_error: float = 0.0,
) -> Array:
    """Time by which all robots have met under an energy tank, whatever is wanted, s (theorem D).

    Args:
        scenario: gives n, r, W, a*, c_m, D̄, τ and v_max.
        initial_lyapunov: V(0), (...), m²/s.
        min_alignment: ε in (0, 1], the margin of the law that an empty tank falls back to.
        budget: B_i that each robot's tank begins with, m²/s, at least 0.
        bearing_error: η, rad, that the tank allows for.

    Returns:
        (...), s; infinite where nothing is guaranteed.

    Raises:
        ValueError: if an argument is out of its range.
    """
    check_margin(min_alignment)
    error = check_bearing_error(bearing_error)
    most = tank_lyapunov_bound(scenario, initial_lyapunov, budget=budget)
    if not covered(scenario):
        return np.full(most.shape, np.inf)
    share = certified_share(min_alignment, error_share(scenario, error), 0.0)
    bound = certified_time(scenario, most, share)
    if error == 0.0:
        left = np.arange(2, scenario.n_robots + 1)
        slowest = 4.0 * min_alignment**2 * (least_degrees(scenario) ** 2 / left).min()
        exact = over_rate(most, slowest * scale_bound(scenario))
        bound = np.minimum(bound, exact + (scenario.n_robots - 1) * scenario.tau)
    return np.asarray(bound)


def bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """The time and V."""
    time = float(
        tank_time_bound(
            scenario,
            largest_lyapunov(scenario),
            min_alignment=asked.min_alignment,
            budget=asked.budget,
            bearing_error=asked.error,
        )
    )
    words = "theorem D: whatever is wanted, all robots meet in finite time while a tank keeps count"
    if asked.error > 0:
        words += f" and charges errors of {asked.error:.4g} rad"
    borne = error_of_share(scenario, forgiven_share(asked.min_alignment, 0.0))
    if math.isinf(time):
        words = too_wrong(asked, borne, "a tank of this margin") + "; V stays bounded even so"
    return Bounds(
        words=words,
        meets=math.isfinite(time),
        time=time,
        tolerated_bearing_error=borne,
    )


def lyapunov_bounds(scenario: Scenario, asked: Asked) -> Bounds:
    """V alone: with walls, and for robots that turn."""
    most = tank_lyapunov_bound(scenario, largest_lyapunov(scenario), budget=asked.budget)
    return Bounds(lyapunov=float(most))


def moved_by_velocity(scenario: Scenario, asked: Asked) -> str:
    """A robot's action is its velocity."""
    if scenario.model.bounded:
        return ""
    return (
        f"none: no time by which {scenario.model.name} robots meet under a tank is proven; "
        "theorem D still keeps V bounded"
    )


_COUNTED = (undirected, connected, known_bodies, bounded_errors, all_neighbours_seen)
THEOREMS = (
    Theorem("D", ("tank",), (*_COUNTED, nothing_in_the_way, moved_by_velocity), bounds),
    Theorem("D, the bound on V", ("tank",), _COUNTED, lyapunov_bounds, rendezvous=False),
)
