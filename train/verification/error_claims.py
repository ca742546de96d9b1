"""The claims of theorems N1 and N1', and of unbiased noise: undirected graphs, held inputs
(guarantees 11).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from rendezvous_env import Scenario, Sensing, Simulator
from rendezvous_env.guarantee.bounds import lyapunov_bound, tank_time_bound
from rendezvous_env.guarantee.error_bounds import (
    error_borne,
    heading_time_bound,
    law_time_bound,
)
from rendezvous_env.guarantee.error_times import forgiven_share, most_wrong
from rendezvous_env.guarantee.noise_times import mean_cosine, noisy_mean_time, scatter
from rendezvous_env.trajectory import Step

from .cases import Case, draw_case
from .claim import Array, Claim
from .judging import falls, keeps, meets, meets_on_average, rounding
from .laws import by_name
from .promises import anything
from .tank_cases import draw_timed
from .tank_watches import nothing_rises_above
from .wrong_rows import misled_headings, misled_law_1, misled_tanks

_STEPS = (0.3, 1.0)
"""τ over the certified step."""
_ERRORS = (0.3, 0.95)
"""ρ over what is forgiven."""
_NOISE = (0.1, 0.6)
"""Standard deviation of the angles, rad."""
_NOISY_STEPS = (0.2, 0.7)
"""θ over what is beaten."""


def _draw_slow(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    return draw_case(random, batch, least_margin, step_factors=_STEPS, speed_limits=False)


def draw_wrong(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Errors that law (1) bears."""
    case = _draw_slow(random, batch, least_margin)
    return _with_error(case, random.uniform(*_ERRORS))


def draw_wrong_headings(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Errors that certified headings bear."""
    case = _draw_slow(random, batch, least_margin)
    return _with_error(case, random.uniform(0.2, 0.8) * float(forgiven_share(case.margin)))


def draw_wrong_tanks(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Errors that an energy tank bears; it has no dead zone."""
    case = draw_timed(random, batch, least_margin)
    return _with_error(case, random.uniform(0.1, 0.7) * float(forgiven_share(case.margin, 0.0)))


def _with_error(case: Case, rho: float) -> Case:
    """The same with the error of a given ρ."""
    return dataclasses.replace(case, error=error_borne(case.scenario, rho))


def draw_noisy(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Noise, and a step that beats it."""
    scenario = draw_case(random, batch, least_margin, speed_limits=False).scenario
    noise, n = random.uniform(*_NOISE), scenario.n_robots
    gamma = float(mean_cosine(noise))
    most = n * (n - 1) * scenario.sensing_graph.weight_range[1] ** 2
    nu = float(scatter(n, gamma, most, scenario.bottleneck_weight))
    theta = min(random.uniform(*_NOISY_STEPS) * 2.0 * gamma / (gamma**2 + nu), 1.0)
    step = theta * scenario.merge_radius / (2.0 * scenario.max_degree)
    return Case(scenario.replace(sensing=Sensing(noise=noise), time_step=step), 1.0)


def bound_wrong(case: Case, teams: Simulator) -> Array:
    """Of theorem N1, s."""
    return law_time_bound(case.scenario, teams.lyapunov(), case.error)


def bound_wrong_headings(case: Case, teams: Simulator) -> Array:
    """Of theorem N1', s."""
    return heading_time_bound(case.scenario, teams.lyapunov(), case.error, case.margin)


def bound_wrong_tanks(case: Case, teams: Simulator) -> Array:
    """Of theorem D with bearing errors, s."""
    return tank_time_bound(
        case.scenario,
        teams.lyapunov(),
        min_alignment=case.margin,
        budget=case.budget,
        bearing_error=case.error,
    )


def bound_noisy(case: Case, teams: Simulator) -> Array:
    """On the mean time with unbiased noise, s."""
    scenario = case.scenario
    return noisy_mean_time(
        scenario.n_robots,
        lyapunov_bound(scenario, teams.lyapunov()),
        max_degree=scenario.max_degree,
        bottleneck_weight=scenario.bottleneck_weight,
        cosine=mean_cosine(scenario.sensing.noise),
        square_weights=np.sum(teams.weights**2, axis=(-2, -1)),
        merge_radius=scenario.merge_radius,
        step=scenario.tau,
    )


def rises_by_errors_only(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """By how much more than τ Σ(‖f_i‖² − e_i²) V falls in a step, over V(0); in a step with a merge
    it may rise by Σ e_i² up to there.
    """
    scenario, start = case.scenario, teams.lyapunov()
    layout = scenario.observation_layout

    def look(step: Step) -> Array:
        f, degree = layout.net_bearing(step.observations), layout.degree(step.observations)
        forgiven = most_wrong(degree, case.error) ** 2
        promised = scenario.tau * np.sum(np.sum(f**2, axis=-1) - forgiven, axis=-1)
        out = step.outcome
        calm = out.lyapunov_after_merge == out.lyapunov_before_merge
        promised = np.where(calm, promised, np.minimum(promised, 0.0))
        slack = step.lyapunov - out.lyapunov_before_merge - promised
        return np.asarray((slack + rounding(scenario, step.lyapunov)) / start)

    return look


def by_its_square(scenario: Scenario, step: Step) -> Array:
    """V falls by τ Σ ‖u_i‖² with what robots do, whatever they see, m²/s."""
    return np.asarray(scenario.tau * np.sum(step.actions.astype(np.float64) ** 2, axis=(-2, -1)))


ERRORS = (
    Claim(
        "wrong-law-1",
        "law (1), bearings off by η, ρ < 1: V falls by τ Σ(‖f‖² − e²) in every step, T ≤ N1",
        draw_wrong,
        misled_law_1,
        bound_wrong,
        (meets, keeps),
        anything,
        timed=True,
        watch=rises_by_errors_only,
    ),
    Claim(
        "wrong-headings",
        "any policy, headings certified against what is seen: V never rises, T ≤ N1'",
        draw_wrong_headings,
        misled_headings,
        bound_wrong_headings,
        (meets, falls),
        by_its_square,
        timed=True,
    ),
    Claim(
        "wrong-tank",
        "any wishes under a tank that allows for η: V ≤ V(0) + ΣB until a merge, T ≤ D with errors",
        draw_wrong_tanks,
        misled_tanks,
        bound_wrong_tanks,
        (meets, keeps),
        anything,
        timed=True,
        watch=nothing_rises_above,
    ),
    Claim(
        "noise",
        "law (1), unbiased noise, θ < 2γ/(γ² + ν): the mean of T is within its bound by 3 s.e.",
        draw_noisy,
        by_name("bearing-only"),
        bound_noisy,
        (meets_on_average,),
        anything,
        timed=True,
        patience=3.0,
    ),
)
