"""By when all robots have met, and before when none can have (theorems A and C, theory 3 to 5)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..experiment.checks import floats, real, refuse, shown
from ..experiment.scenario import Scenario
from .enclosing_ball import smallest_enclosing_ball

Array = NDArray[np.float64]


def merge_rise_allowance(scenario: Scenario) -> float:
    """(n − 1) r W, m²/s: no sequence of merges can raise V by more (theory 3 and 5)."""
    n, total = scenario.n_robots, scenario.sensing_graph.weight_sum(scenario.n_robots)
    return (n - 1) * scenario.merge_radius * total


def time_bound(
    scenario: Scenario, initial_lyapunov: ArrayLike, *, min_alignment: float = 1.0
) -> Array:
    """Time by which all robots have met, s (theorems A and C with the factors of theory 4).

        A, law (1):              T ≤ n V0⁺ / (8 a*²)
        C, certified heading:    T ≤ n V0⁺ / (2 ε² a*²),      V0⁺ = V(0) + (n − 1) r W

    times 2·max(1, 2D̄τ/r) for the held inputs and max(1, D̄/v_max) for the speed limit.

    Args:
        scenario: gives n, r, W, a*, D̄, τ and v_max.
        initial_lyapunov: V(0), (...), m²/s.
        min_alignment: 1 for law (1), the margin ε < 1 for a certified heading.

    Returns:
        (...), s; infinite where nothing is guaranteed.

    Raises:
        ValueError: if ``min_alignment`` is not in (0, 1].
    """
    if not 0 < real(min_alignment) <= 1:
        raise ValueError(f"min_alignment is {shown(min_alignment)}; it must be in (0, 1]")
    check_scenario(scenario)
    initial = floats("initial_lyapunov", initial_lyapunov)
    if not (np.isfinite(initial) & (initial >= 0)).all():
        refuse("initial_lyapunov", initial_lyapunov, "finite and at least 0 m²/s")
    if not covered(scenario):
        return np.full(initial.shape, np.inf)
    n, a = scenario.n_robots, scenario.bottleneck_weight
    divisor = 8.0 if min_alignment == 1 else 2.0 * min_alignment**2
    held = 2.0 * max(1.0, 2.0 * scenario.max_degree * scenario.tau / scenario.merge_radius)
    limited = max(1.0, scenario.max_degree / scenario.speed_limit)
    with np.errstate(divide="ignore", over="ignore"):  # a margin of almost nothing bounds nothing
        bound = n * (initial + merge_rise_allowance(scenario)) / (divisor * a**2)
        return np.asarray(bound * held * limited)


def covered(scenario: Scenario) -> bool:
    """Whether theorems A and C bound the time: connected, robots whose action is their velocity,
    nothing in the way.
    """
    in_the_way = bool(scenario.obstacles) and scenario.obstacle_contact != "ignore"
    return connected(scenario) and scenario.model.bounded and not in_the_way


def rendezvous_time_lower_bound(scenario: Scenario, positions: ArrayLike) -> float:
    """No policy meets sooner: T ≥ (R − (n − 1) r/2)/v_max, s; (n − 1) r with obstacles (theory 3).

    Args:
        scenario: gives n, r and v_max.
        positions: start, (n, d), m.
    """
    _, radius = smallest_enclosing_ball(positions)
    share = 1.0 if scenario.obstacles else 0.5
    reach = (scenario.n_robots - 1) * scenario.merge_radius * share
    return max(0.0, radius - reach) / scenario.speed_limit


def check_scenario(scenario: Any) -> None:
    """Refuse anything but a Scenario.

    Raises:
        ValueError: saying what was given.
    """
    if not isinstance(scenario, Scenario):
        refuse("scenario", scenario, "a Scenario; scenarios.resolve() takes names and files")


def connected(scenario: Scenario) -> bool:
    """Whether every robot is linked to every other, directly or through others."""
    return len(scenario.sensing_graph.components(scenario.n_robots)) == 1
