"""By when all have met although bearings are wrong, and how wrong they may be (theorems N, R d)."""

from __future__ import annotations

import math

import numpy as np

from ..experiment.scenario import Scenario
from .bounds import merge_rise_allowance
from .degrees import degrees_stay_equal, least_degrees
from .size_bounds import shrinking


def share_of_errors(scenario: Scenario, error: float) -> float:
    """ρ = n D̄ sin(η/2)/a*: what errors can feign, Σ e_i, as a share of 2 a* (theorem N1).

    Args:
        scenario: gives n, D̄ and a*.
        error: η, rad.

    Returns:
        A number without unit.
    """
    n, degree = scenario.n_robots, scenario.max_degree
    return n * degree * math.sin(error / 2.0) / scenario.bottleneck_weight


def _error_of_share(scenario: Scenario, share: float) -> float:
    """The η with that ρ, rad."""
    sine = share * scenario.bottleneck_weight / (scenario.n_robots * scenario.max_degree)
    return 2.0 * math.asin(min(sine, math.sin(math.pi / 4.0)))


def slowdown(scenario: Scenario) -> float:
    """1/s_min = max(1, 2D̄τ/r, D̄/v_max): by how much a long step or a speed limit slow robots down.

    Args:
        scenario: gives D̄, τ, r and v_max.

    Returns:
        A number without unit.
    """
    degree = scenario.max_degree
    longer = 2.0 * degree * scenario.tau / scenario.merge_radius
    return max(1.0, longer, degree / scenario.speed_limit)


# ---- law (1) -------------------------------------------------------------------------------------


def law_time_bound(scenario: Scenario, start: float, error: float) -> float:
    """Theorem N1's T for law (1) as it is, inputs held, s.

        T ≤ n (V0⁺ + (n − 1) τ Σ e_i²) / (4 a*² (1 − ρ²)) + (n − 1) τ,      e_i = 2 sin(η/2) D_i

    Args:
        scenario: undirected and connected, with a step that is certified.
        start: V(0), m²/s.
        error: η, rad.

    Returns:
        A number, s; infinite for ρ ≥ 1, or if robots can be slowed down.
    """
    n, a, tau = scenario.n_robots, scenario.bottleneck_weight, scenario.tau
    rho = share_of_errors(scenario, error)
    if rho >= 1.0 or scenario.speed_limit < scenario.max_degree:
        return math.inf
    feigned = n * (2.0 * math.sin(error / 2.0) * scenario.max_degree) ** 2
    above = start + merge_rise_allowance(scenario) + (n - 1) * tau * feigned
    return n * above / (4.0 * a**2 * (1.0 - rho**2)) + (n - 1) * tau


def law_error_borne(scenario: Scenario) -> float:
    """The η that law (1) bears on an undirected graph, rad: ρ < 1 (theorem N1)."""
    return _error_of_share(scenario, 1.0)


def even_time_bound(
    scenario: Scenario, size: float, error: float, *, held: bool, gain: float | None = None
) -> float:
    """Theorem N's T for robots whose gains add up to the same, s.

        η' = η + asin(2cτ/r) if held,     T ≤ L0/min_m shrinking(m, c_m, η') (+ (n − 1) τ)

    Args:
        scenario: gives n, the dimension, r, τ and the graph.
        size: L(0), m.
        error: η, rad.
        held: whether inputs are held over the step.
        gain: c, m/s; None takes the degrees of law (1), which must stay equal.

    Returns:
        A number, s; infinite where η' is too large.
    """
    left, gains = np.arange(2, scenario.n_robots + 1), _gains(scenario, gain)
    late_by = _held_error(scenario, gains) if held else np.zeros(len(left))
    if error == 0.0:
        late_by[0] = 0.0  # two robots move on one line
    errors = error + late_by
    slowest = float(shrinking(left, scenario.dim, gains, errors).min())
    late = (scenario.n_robots - 1) * scenario.tau if held else 0.0
    return size / slowest + late if slowest > 0.0 else math.inf


def even_error_borne(scenario: Scenario, gain: float | None = None) -> float:
    """The η that robots bear whose gains add up to the same, inputs held (theorem N).

        π/n − asin(2cτ/r);      in space atan(1/√(n(n − 2))) − asin(2cτ/r)

    Args:
        scenario: gives n, the dimension, r and τ.
        gain: c, m/s; None takes the degrees of law (1).

    Returns:
        A number, rad, at least 0.
    """
    m, gains = np.arange(2.0, scenario.n_robots + 1), _gains(scenario, gain)
    with np.errstate(divide="ignore"):
        bears = np.pi / m if scenario.dim == 2 else np.arctan(1.0 / np.sqrt(m * (m - 2.0)))
    return max(0.0, float((bears - _held_error(scenario, gains)).min()))


def _gains(scenario: Scenario, gain: float | None) -> np.ndarray:
    """c_m for m = 2 … n robots that are left, m/s."""
    return least_degrees(scenario) if gain is None else np.full(scenario.n_robots - 1, gain)


def _held_error(scenario: Scenario, gains: np.ndarray) -> np.ndarray:
    """asin(2cτ/r), rad, π/2 at most: by how much a bearing is wrong that is held for a step."""
    sine = np.minimum(2.0 * gains * scenario.tau / scenario.merge_radius, 1.0)
    return np.asarray(np.arcsin(sine))


def evenly_moved(scenario: Scenario) -> bool:
    """Whether law (1) gives all robots the same gains at any time, and nobody is slowed down."""
    fast = scenario.speed_limit >= least_degrees(scenario).max(initial=0.0)
    return degrees_stay_equal(scenario) and bool(fast)


def expected_time_bound(scenario: Scenario, start: float) -> float:
    """E[T] of law (1) under unbiased noise that is drawn anew for every bearing and step, s.

        E[T] ≤ n (V0⁺ + n (n − 1) r θ D̄) / (4 a*² [γ(2 − θγ) − θν]),      θ = 2D̄τ/r,
        γ = E cos ξ = exp(−σ²/2),   ν = n (1 − γ²) Σ_i Σ_j a_ij² / (4 a*²)

    Args:
        scenario: undirected and connected; gives n, r, τ, D̄, a* and σ.
        start: V(0), m²/s.

    Returns:
        A number, s; infinite if the step is too long for this noise, or robots can be slowed down.
    """
    n, a, degree = scenario.n_robots, scenario.bottleneck_weight, scenario.max_degree
    theta = 2.0 * degree * scenario.tau / scenario.merge_radius
    gamma = math.exp(-0.5 * scenario.sensing.noise**2)
    weights = scenario.sensing_graph.links(n)[2] * scenario.sensing_graph.weight_range[1]
    nu = n * (1.0 - gamma**2) * 2.0 * float(weights @ weights) / (4.0 * a**2)
    rate = gamma * (2.0 - theta * gamma) - theta * nu
    if rate <= 0.0 or scenario.speed_limit < degree:
        return math.inf
    above = start + merge_rise_allowance(scenario)
    above += n * (n - 1) * scenario.merge_radius * theta * degree
    return n * above / (4.0 * a**2 * rate)


# ---- headings and tanks --------------------------------------------------------------------------

DEAD_ZONE_SHARE = 0.5
"""β of the dead zone δ = βa*/n in use."""


def heading_time_bound(
    scenario: Scenario, start: float, error: float, min_alignment: float
) -> float:
    """Theorem N1''s T for certified headings that allow for errors, inputs held, s.

        T ≤ n V0⁺/(a*² q²) + (n − 1) τ,      q = ε(2 − β) − 2(1 + ε)ρ > 0

    times ``slowdown``, and β the share of ``DEAD_ZONE_SHARE``.

    Args:
        scenario: undirected and connected.
        start: V(0), m²/s.
        error: η, rad.
        min_alignment: ε.

    Returns:
        A number, s; infinite for q ≤ 0.
    """
    q = min_alignment * (2.0 - DEAD_ZONE_SHARE)
    q -= 2.0 * (1.0 + min_alignment) * share_of_errors(scenario, error)
    above = start + merge_rise_allowance(scenario)
    return _by_descent(scenario, above, q)


def heading_error_borne(scenario: Scenario, min_alignment: float) -> float:
    """The η with q = 0, rad: any less is borne; arguments as ``heading_time_bound``."""
    share = min_alignment * (2.0 - DEAD_ZONE_SHARE) / (2.0 * (1.0 + min_alignment))
    return _error_of_share(scenario, share)


def tank_error_time_bound(
    scenario: Scenario, most: float, error: float, min_alignment: float
) -> float:
    """T under an energy tank that allows for errors, s (theorem D with section 8's charges).

        T ≤ n V_max/(a*² q² s_min) + (n − 1) τ,      q = 2ε − 2(1 + ε)ρ > 0

    as Σ(ε‖f̂_i‖ − e_i)₊ ≥ a* q; this is theorem D's T for η = 0.

    Args:
        scenario: undirected and connected.
        most: V_max = V0⁺ + (n − 1) r W + ΣB_i, m²/s.
        error: η, rad.
        min_alignment: ε.

    Returns:
        A number, s; infinite for q ≤ 0.
    """
    rho = share_of_errors(scenario, error)
    return _by_descent(scenario, most, 2.0 * min_alignment - 2.0 * (1.0 + min_alignment) * rho)


def tank_error_borne(scenario: Scenario, min_alignment: float) -> float:
    """The η with q = 0, rad: any less is borne; arguments as ``tank_error_time_bound``."""
    return _error_of_share(scenario, min_alignment / (1.0 + min_alignment))


def _by_descent(scenario: Scenario, above: float, q: float) -> float:
    """The time n V/(a*² q²) times ``slowdown``, and a step for each merge, s; inf for q ≤ 0."""
    if q <= 0.0:
        return math.inf
    n, a = scenario.n_robots, scenario.bottleneck_weight
    return n * above / (a * q) ** 2 * slowdown(scenario) + (n - 1) * scenario.tau


# ---- links ---------------------------------------------------------------------------------------


def link_time_bound(
    scenario: Scenario, most: float, least_weight: float, share: float, error: float
) -> float:
    """Theorem R's T for velocities that keep all links, inputs held, s.

        T ≤ n V_tot / (4 λ d_min s (1 − 2nη/π)²) + (n − 1) τ,      s = min(d_min, v_max, r/(2τ))

    With a long step or a slow robot the law's part is s q in place of d q, which lies in the same
    set and descends at λ d s ‖q‖².

    Args:
        scenario: gives n, r, τ and v_max.
        most: V_tot, m²/s.
        least_weight: d_min, m/s.
        share: λ.
        error: η, rad.

    Returns:
        A number, s; infinite for η ≥ π/(2n).
    """
    n = scenario.n_robots
    spare = 1.0 - 2.0 * n * error / math.pi
    if spare <= 0.0:
        return math.inf
    slowest = min(least_weight, scenario.speed_limit, scenario.merge_radius / (2 * scenario.tau))
    return n * most / (4.0 * share * least_weight * slowest * spare**2) + (n - 1) * scenario.tau


def link_error_borne(scenario: Scenario) -> float:
    """π/(2n), rad: any less is borne (theorem R d)."""
    return math.pi / (2.0 * scenario.n_robots)
