"""The times by which claims say that all have met."""

from __future__ import annotations

import numpy as np

from rendezvous_env import Simulator
from rendezvous_env.guarantee.bounds import merge_rise_allowance, tank_time_bound, time_bound
from rendezvous_env.guarantee.even_bounds import held_size_bound
from rendezvous_env.guarantee.graph_bounds import gains_time
from rendezvous_env.guarantee.size_bounds import pursuit_bound, size_bound

from .cases import Case
from .claim import Array

PATIENCE = 500.0
"""Nonholonomic robots have no time bound; after this many seconds they are held not to meet."""
_A_WHILE = 300
"""Steps."""


def bound_a(case: Case, teams: Simulator) -> Array:
    """Of theorem A, s."""
    return time_bound(case.scenario, teams.lyapunov())


def bound_b(case: Case, teams: Simulator) -> Array:
    """Of theorem B, s."""
    return time_bound(case.scenario, teams.lyapunov()) / case.margin**2


def bound_c(case: Case, teams: Simulator) -> Array:
    """Of theorem C, s."""
    return time_bound(case.scenario, teams.lyapunov(), min_alignment=case.margin)


def bound_d(case: Case, teams: Simulator) -> Array:
    """Of theorem D, s."""
    return tank_time_bound(
        case.scenario, teams.lyapunov(), min_alignment=case.margin, budget=case.budget
    )


def bound_of_pieces(case: Case, teams: Simulator) -> Array:
    """Time by which each piece of a disconnected graph has met, s: the proof of A holds for it."""
    scenario = case.scenario
    above = teams.lyapunov() + merge_rise_allowance(scenario)
    return 2.0 * scenario.n_robots * above / (8.0 * scenario.bottleneck_weight**2)


def patience(case: Case, teams: Simulator) -> Array:
    """No theorem's: PATIENCE."""
    return np.full(teams.num_envs, PATIENCE)


def for_a_while(case: Case, teams: Simulator) -> Array:
    """Of no theorem: as long as it takes to show what there is to see in every step."""
    return np.full(teams.num_envs, _A_WHILE * case.scenario.tau)


def no_time(case: Case, teams: Simulator) -> Array:
    """One step shows what there is to see."""
    return np.zeros(teams.num_envs)


def bound_law_1(case: Case, teams: Simulator) -> Array:
    """The smaller of A and G, s; G's is proven in continuous time, and so up to a step a merge."""
    scenario = case.scenario
    followed = size_bound(scenario, teams.size()) + (scenario.n_robots - 1) * scenario.tau
    return np.minimum(bound_a(case, teams), followed)


def bound_held(case: Case, teams: Simulator) -> Array:
    """Of theorem N for held inputs, s."""
    return held_size_bound(case.scenario, teams.size())


def bound_pursuit(case: Case, teams: Simulator) -> Array:
    """Of E2 for pursuers at the speed limit, s."""
    return pursuit_bound(case.scenario, teams.size(), case.scenario.speed_limit)


def bound_gains(case: Case, teams: Simulator) -> Array:
    """Of theorem G where each robot sees at least one other, c = a*, s, up to a step a merge."""
    scenario = case.scenario
    gain = min(scenario.bottleneck_weight, scenario.speed_limit)
    followed = gains_time(scenario.n_robots, scenario.dim, teams.size(), gain)
    return followed + (scenario.n_robots - 1) * scenario.tau


bound_occluded = bound_gains
"""The nearest robot is never hidden."""
