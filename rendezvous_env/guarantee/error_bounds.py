"""By when all have met although bearings are wrong or noisy, and how wrong they may be, from a
Scenario (theorems N1, N1' and R d).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..experiment.scenario import Scenario
from .bounds import lyapunov_bound, scale_bound, share_of_errors
from .error_times import (
    certified_share,
    error_of_share,
    forgiven_share,
    wrong_certified_time,
    wrong_law_1_time,
)
from .graph_bounds import links_time
from .noise_times import mean_cosine, noisy_mean_time

Array = NDArray[np.float64]


def law_time_bound(scenario: Scenario, initial_lyapunov: ArrayLike, error: float) -> Array:
    """T for law (1) as it is, inputs held, s (theorem N1): ``wrong_law_1_time``.

    Args:
        scenario: undirected and connected, with a step that is certified.
        initial_lyapunov: V(0), (...), m²/s.
        error: η, rad.

    Returns:
        (...), s; infinite for ρ ≥ 1, or if robots can be slowed down.
    """
    above = lyapunov_bound(scenario, initial_lyapunov)
    if scenario.speed_limit < scenario.max_degree:
        return np.full(above.shape, np.inf)
    return wrong_law_1_time(
        scenario.n_robots,
        above,
        max_degree=scenario.max_degree,
        bottleneck_weight=scenario.bottleneck_weight,
        error=error,
        step=scenario.tau,
    )


def law_error_borne(scenario: Scenario) -> float:
    """The η that law (1) bears on an undirected graph, a number, rad: ρ < 1 (theorem N1)."""
    return error_borne(scenario, 1.0)


def expected_time_bound(scenario: Scenario, initial_lyapunov: float) -> float:
    """E[T] of law (1) under unbiased noise that is drawn anew for every bearing and step, s
    (guarantees 11): ``noisy_mean_time``.

    Args:
        scenario: undirected and connected; gives n, r, τ, D̄, a* and σ.
        initial_lyapunov: V(0), m²/s.

    Returns:
        A number, s; infinite if the step is too long for this noise, or robots can be slowed down.
    """
    if scenario.speed_limit < scenario.max_degree:
        return math.inf
    graph = scenario.sensing_graph
    weights = graph.links(scenario.n_robots)[2] * graph.weight_range[1]
    bound = noisy_mean_time(
        scenario.n_robots,
        lyapunov_bound(scenario, initial_lyapunov),
        max_degree=scenario.max_degree,
        bottleneck_weight=scenario.bottleneck_weight,
        cosine=mean_cosine(scenario.sensing.noise),
        square_weights=2.0 * float(weights @ weights),
        merge_radius=scenario.merge_radius,
        step=scenario.tau,
    )
    return float(bound)


def heading_time_bound(
    scenario: Scenario, initial_lyapunov: ArrayLike, error: float, min_alignment: float
) -> Array:
    """T for certified headings that allow for errors, inputs held, s (theorem N1'):
    ``wrong_certified_time``.

    Args:
        scenario: undirected and connected.
        initial_lyapunov: V(0), (...), m²/s.
        error: η, rad.
        min_alignment: ε.

    Returns:
        (...), s; infinite for q ≤ 0.
    """
    return wrong_certified_time(
        scenario.n_robots,
        lyapunov_bound(scenario, initial_lyapunov),
        bottleneck_weight=scenario.bottleneck_weight,
        share=certified_share(min_alignment, share_of_errors(scenario, error)),
        step=scenario.tau,
        slowest=scale_bound(scenario),
    )


def heading_error_borne(scenario: Scenario, min_alignment: float) -> float:
    """The η with q = 0, rad: any less is borne (theorem N1'); as ``heading_time_bound``."""
    return error_borne(scenario, float(forgiven_share(min_alignment)))


def tank_error_borne(scenario: Scenario, min_alignment: float) -> float:
    """The same under an energy tank, rad (theorem D); as ``tank_time_bound``."""
    return error_borne(scenario, float(forgiven_share(min_alignment, 0.0)))


def error_borne(scenario: Scenario, share: float) -> float:
    """The η at which errors can feign a share ρ of 2 a* (theorem N1): ``error_of_share``.

    Args:
        scenario: gives n, D̄ and a*.
        share: ρ, a number without unit.

    Returns:
        A number, rad.
    """
    n, a = scenario.n_robots, scenario.bottleneck_weight
    return float(error_of_share(n, scenario.max_degree, a, share))


def link_time_bound(
    scenario: Scenario, most: float, least_weight: float, share: float, error: float
) -> float:
    """T for velocities that keep all links, inputs held, s (theorem R): ``links_time``.

    Args:
        scenario: gives n, r, τ and v_max.
        most: V_tot, m²/s.
        least_weight: d_min, m/s.
        share: λ.
        error: η, rad.

    Returns:
        A number, s; infinite for η ≥ π/(2n).
    """
    slowest = min(least_weight, scenario.speed_limit, scenario.merge_radius / (2 * scenario.tau))
    bound = links_time(
        scenario.n_robots,
        most,
        least_degree=least_weight,
        step=scenario.tau,
        share=share,
        error=error,
        slowest=slowest,
    )
    return float(bound)


def link_error_borne(scenario: Scenario) -> float:
    """π/(2n), a number, rad: any less is borne (theorem R d)."""
    return math.pi / (2.0 * scenario.n_robots)
