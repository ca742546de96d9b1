"""What claims about energy tanks watch in every step; shares of V(0), rounding allowed for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rendezvous_env import Scenario, Simulator
from rendezvous_env.guarantee.bounds import tank_lyapunov_bound
from rendezvous_env.trajectory import Step

from .cases import Case
from .claim import Array
from .judging import rounding


def ledger_is_kept(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """V + ΣA rises in no step without a merge, and no A falls below zero.

    The ledgers are kept here anew, from what robots saw and were told to do.
    """
    start = teams.lyapunov()
    levels = np.full((teams.num_envs, teams.scenario.n_robots), case.budget)
    allowed = np.zeros(teams.num_envs)

    def look(step: Step) -> Array:
        nonlocal allowed
        earned = deposits(case.scenario, step, case.margin) * step.running[:, None]
        levels[...] += earned
        error = rounding(case.scenario, step.lyapunov)
        allowed = allowed + error
        fall = step.lyapunov - teams.lyapunov() - earned.sum(axis=-1) + error
        merged = (teams.merged_into != np.arange(levels.shape[1])) & (levels != 0)
        fall[merged.any(axis=-1)] = np.inf
        for team, robot in np.argwhere(merged):
            levels[team, teams.merged_into[team, robot]] += levels[team, robot]
            levels[team, robot] = 0.0
        return np.asarray(np.minimum(fall, levels.min(axis=-1) + allowed) / start)

    return look


def deposits(scenario: Scenario, step: Step, margin: float) -> Array:
    """G of a step as it was commanded, (B, n), m²/s, for single integrators.

    G = 2 f·Δ − (2/r) D ‖Δ‖² − ε² τ s ‖f‖²                                              (theory 8)
    """
    layout, r, tau = scenario.observation_layout, scenario.merge_radius, scenario.tau
    f, degree = layout.net_bearing(step.observations), layout.degree(step.observations)
    strength = np.linalg.norm(f, axis=-1)
    velocity = step.actions.astype(np.float64)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    moved = tau * velocity * (scenario.speed_limit / np.maximum(speed, scenario.speed_limit))
    with np.errstate(divide="ignore"):  # robots that are gone
        scale = np.minimum(r / (2 * degree * tau), scenario.speed_limit / strength)
    owed = margin**2 * tau * np.minimum(scale, 1.0) * strength**2
    spent = 2 / r * degree * np.sum(moved**2, axis=-1)
    return np.asarray(2 * np.sum(f * moved, axis=-1) - spent - owed)


def stays_below_start(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """V ≤ V(0) + ΣB until the first merge or contact."""
    start, whole = teams.lyapunov(), np.ones(teams.num_envs, dtype=bool)
    most = start + case.scenario.n_robots * case.budget

    def look(step: Step) -> Array:
        nonlocal most, whole
        most = most + rounding(case.scenario, step.lyapunov)
        whole = whole & step.outcome.active.all(axis=-1) & (teams.contacts == 0)
        return np.where(whole, most - teams.lyapunov(), np.inf) / start

    return look


def stays_bounded(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """V stays within theorem D's bound, over all merges."""
    start = teams.lyapunov()
    most = tank_lyapunov_bound(case.scenario, start, budget=case.budget)

    def look(step: Step) -> Array:
        nonlocal most
        most = most + rounding(case.scenario, step.lyapunov)
        return np.asarray((most - teams.lyapunov()) / start)

    return look


def nothing_rises_above(teams: Simulator, case: Case) -> Callable[[Step], Array]:
    """Both of the last two."""
    watches = stays_below_start(teams, case), stays_bounded(teams, case)
    return lambda step: np.minimum(*(look(step) for look in watches))
