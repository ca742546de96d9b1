"""By when all robots have met, and before when none can have (theorems A, C and D)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..experiment.checks import floats, real, refuse
from ..experiment.scenario import Scenario
from .bearing_errors import check_bearing_error
from .degrees import uniform_complete
from .enclosing_ball import smallest_enclosing_ball
from .error_times import certified_share, error_share, wrong_certified_time
from .even_bounds import held_size_bound
from .kinds_of_links import UNDIRECTED, kind_of_links

Array = NDArray[np.float64]


def merge_rise_allowance(scenario: Scenario) -> float:
    """(n − 1) r W: no sequence of merges can raise V by more (theory 3 and 5).

    Args:
        scenario: gives n, r and W = Σ a_ij over its edges.

    Returns:
        A number, m²/s.
    """
    n, total = scenario.n_robots, scenario.sensing_graph.weight_sum(scenario.n_robots)
    return (n - 1) * scenario.merge_radius * total


def time_bound(
    scenario: Scenario,
    initial_lyapunov: ArrayLike,
    *,
    min_alignment: float = 1.0,
    initial_size: ArrayLike | None = None,
) -> Array:
    """Time by which all robots have met with inputs held over the step, s.

        A, law (1), and C, certified headings:   T ≤ n V0⁺ / (8 ε² a*²),   V0⁺ = V(0) + (n − 1) r W
        on a complete graph of one weight a:     T ≤ V(0) / (4 (n − 1) ε² a²)   if that is less

    times 2·max(1, 2D̄τ/r) for the held inputs and max(1, D̄/v_max) for the speed limit (theory 3 and
    4, guarantees 13). With L(0) and law (1): theorem N's bound, if that is less.

    Args:
        scenario: gives n, r, W, a*, D̄, τ and v_max, and its graph: weights that a reset is given
            in its place may lose a bound for complete graphs and cycles.
        initial_lyapunov: V(0), (...), m²/s.
        min_alignment: 1 for law (1), the margin ε < 1 for a certified heading.
        initial_size: L(0), (...), m, as ``Simulator.size`` measures it.

    Returns:
        (...), s; infinite where nothing is guaranteed.

    Raises:
        ValueError: if ``min_alignment`` is not in (0, 1], or a V(0) or L(0) is not finite or
            negative.
    """
    check_margin(min_alignment)
    check_scenario(scenario)
    initial = checked_lyapunov(initial_lyapunov)
    if not covered(scenario):
        return np.full(initial.shape, np.inf)
    bound = _by_descent(scenario, initial, min_alignment)
    if initial_size is not None and min_alignment == 1:
        bound = np.minimum(bound, held_size_bound(scenario, initial_size))
    return np.asarray(bound)


def _by_descent(scenario: Scenario, initial: Array, margin: float) -> Array:
    """Theorems A and C with the factors of theory 4, s."""
    n, a = scenario.n_robots, scenario.bottleneck_weight
    held = 2.0 * max(1.0, 2.0 * scenario.max_degree * scenario.tau / scenario.merge_radius)
    limited = max(1.0, scenario.max_degree / scenario.speed_limit)
    with np.errstate(divide="ignore", over="ignore"):  # a margin of almost nothing bounds nothing
        bound = n * lyapunov_bound(scenario, initial) / (8.0 * margin**2 * a**2)
        if uniform_complete(scenario) and not scenario.obstacles:
            bound = np.minimum(bound, initial / (4.0 * (n - 1) * margin**2 * a**2))
        return np.asarray(bound * held * limited)


def scale_bound(scenario: Scenario) -> float:
    """s_min = min(1, r/(2D̄τ), v_max/D̄): no robot is slowed down by more (theorem D).

    Args:
        scenario: gives D̄, τ, r and v_max.

    Returns:
        A number in (0, 1], without unit.
    """
    degree = scenario.max_degree
    held = scenario.merge_radius / (2.0 * degree * scenario.tau)
    return min(1.0, held, scenario.speed_limit / degree)


def share_of_errors(scenario: Scenario, error: float) -> float:
    """ρ = n D̄ sin(η/2)/a*, what errors of η take from Σ‖f_i‖ (theorem N1): ``error_share``.

    Args:
        scenario: gives n, D̄ and a*.
        error: η, rad.

    Returns:
        A number without unit.
    """
    n, a = scenario.n_robots, scenario.bottleneck_weight
    return float(error_share(n, scenario.max_degree, a, error))


def tank_time_bound(
    scenario: Scenario,
    initial_lyapunov: ArrayLike,
    *,
    min_alignment: float,
    budget: float = 0.0,
    bearing_error: float = 0.0,
) -> Array:
    """Time by which all robots have met under an energy tank, whatever is wanted, s (theorem D).

        T ≤ n (V0⁺ + (n − 1) r W + ΣB_i) / (a*² q² s_min) + (n − 1) τ,
        q = 2ε − 2(1 + ε)ρ > 0,     s_min = min(1, r/(2D̄τ), v_max/D̄)

    as Σ(ε‖f̂_i‖ − e_i)₊ ≥ a* q under a tank that charges errors (guarantees 11).

    Args:
        scenario: gives n, r, W, a*, D̄, τ and v_max.
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
    return wrong_certified_time(
        scenario.n_robots,
        most,
        bottleneck_weight=scenario.bottleneck_weight,
        share=certified_share(min_alignment, share_of_errors(scenario, error), 0.0),
        step=scenario.tau,
        slowest=scale_bound(scenario),
    )


def tank_lyapunov_bound(
    scenario: Scenario, initial_lyapunov: ArrayLike, *, budget: float = 0.0
) -> Array:
    """The most that V can ever be under an energy tank (theorem D).

        V ≤ V0⁺ + (n − 1) r W + ΣB_i

    With obstacles in motion without a contact.

    Args:
        scenario: gives n, r and W.
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
    stopped = merge_rise_allowance(scenario)
    return lyapunov_bound(scenario, initial_lyapunov) + stopped + scenario.n_robots * real(budget)


def lyapunov_bound(scenario: Scenario, initial_lyapunov: ArrayLike) -> Array:
    """The most that V can be if it never rises between merges: V0⁺ = V(0) + (n − 1) r W (theory 3).

    At obstacles robots may merge at one robot's place rather than at the midpoint, where V can rise
    by twice as much (theory 5).

    Args:
        scenario: gives n, r, W and whether there are obstacles.
        initial_lyapunov: V(0), (...), m²/s.

    Returns:
        (...), m²/s.

    Raises:
        ValueError: if a V(0) is not finite or negative.
    """
    places = 2.0 if scenario.obstacles else 1.0
    return checked_lyapunov(initial_lyapunov) + places * merge_rise_allowance(scenario)


def covered(scenario: Scenario) -> bool:
    """Whether theorems A and C bound the time: undirected links that last, connected, robots whose
    action is their velocity, nothing in the way.
    """
    mutual = kind_of_links(scenario.sensing_graph) == UNDIRECTED
    return mutual and connected(scenario) and scenario.model.bounded and not walled(scenario)


def walled(scenario: Scenario) -> bool:
    """Whether there are obstacles that robots cannot pass through."""
    return bool(scenario.obstacles) and scenario.obstacle_contact != "ignore"


def rendezvous_time_lower_bound(scenario: Scenario, positions: ArrayLike) -> float:
    """No policy meets sooner: T ≥ (R − (n − 1) r/2)/v_max; (n − 1) r with obstacles (theory 3).

    Args:
        scenario: gives n, r and v_max.
        positions: start, (n, d), m.

    Returns:
        A number, s.

    Raises:
        ValueError: if a position is not finite, or there is none.
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


def check_margin(min_alignment: Any) -> None:
    """Refuse a margin ε, a number without unit, unless 0 < ε ≤ 1 (theorem B).

    Raises:
        ValueError: saying what was given.
    """
    if not 0 < real(min_alignment) <= 1:
        refuse("min_alignment", min_alignment, "in (0, 1]")


def checked_lyapunov(initial_lyapunov: ArrayLike) -> Array:
    """V(0) as an array of numbers that a team can have: finite, V ≥ zero.

    Args:
        initial_lyapunov: V(0), (...), m²/s.

    Returns:
        The same, float64.

    Raises:
        ValueError: if one is not finite or negative.
    """
    initial = floats("initial_lyapunov", initial_lyapunov)
    if not (np.isfinite(initial) & (initial >= 0)).all():
        refuse("initial_lyapunov", initial_lyapunov, "finite and at least 0 m²/s")
    return initial


def connected(scenario: Scenario) -> bool:
    """Whether every robot is linked to every other, directly or through others."""
    return len(scenario.sensing_graph.components(scenario.n_robots)) == 1
