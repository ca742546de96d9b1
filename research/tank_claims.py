"""The claims of theorem D: any motion at all, while its ledger lasts (guarantees 8)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from tank_wishes import Tanked, wishes

from rendezvous_env import ObstacleField, Scenario, Simulator
from rendezvous_env.safety.tank import EnergyTank
from rendezvous_env.safety.theorems.tank import tank_lyapunov_bound, tank_time_bound
from rendezvous_env.trajectory import Policy, Step
from train.verify.cases import Case, draw_case, draw_nonholonomic
from train.verify.claim import Array, Claim, anything, keeps, meets, rounding

_MARGINS = (0.05, 0.8)
_STEPS = (0.3, 3.0)
"""τ over the certified step."""
_LARGEST_BUDGET = 10.0
"""m²/s."""


def draw_timed(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Teams under a tank, with budgets and without, at steps longer and shorter than certified."""
    return _filled(draw_case(random, batch, least_margin, step_factors=_STEPS), random)


def draw_ledgers(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """The same with margins down to 0.05, where meeting would take too long to wait for."""
    return _any_margin(draw_timed(random, batch, least_margin), random)


def draw_bodies(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Nonholonomic robots under a tank."""
    case = _any_margin(_filled(draw_nonholonomic(random, batch, least_margin), random), random)
    step = random.uniform(*_STEPS) * case.scenario.certified_step
    scenario = case.scenario.replace(time_step=step, allow_long_step=True)
    return dataclasses.replace(case, scenario=scenario)


def draw_obstructed(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Teams among discs or balls."""
    case = draw_ledgers(random, batch, least_margin)
    scenario = case.scenario.replace(
        spawn_size=6.0,
        obstacles=ObstacleField(count=4, radius=(0.2, 0.6), region=6.0, keep_out=0.3, overlap=True),
    )
    return dataclasses.replace(case, scenario=scenario, options={})


def _filled(case: Case, random: np.random.Generator) -> Case:
    full = random.random() < 0.5
    return dataclasses.replace(case, budget=full * random.uniform(0.1, _LARGEST_BUDGET))


def _any_margin(case: Case, random: np.random.Generator) -> Case:
    low, high = map(math.log, _MARGINS)
    return dataclasses.replace(case, margin=math.exp(random.uniform(low, high)))


def tanked(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """All wishes under a tank, in either frame, held or chosen anew in every step."""
    tank = EnergyTank(
        case.scenario,
        num_envs,
        budget=case.budget,
        min_alignment=case.margin,
        frame=str(random.choice(["net_bearing", "local"])),
        bearing_error=case.error,
    )
    return Tanked(tank, wishes(case.scenario, num_envs, random), int(random.choice([1, 1, 5])))


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


_A_WHILE = 300
"""Steps."""


def bound_d(case: Case, teams: Simulator) -> Array:
    """Of theorem D, s."""
    return tank_time_bound(
        case.scenario, teams.lyapunov(), min_alignment=case.margin, budget=case.budget
    )


def for_a_while(case: Case, teams: Simulator) -> Array:
    """Of no theorem: as long as it takes to show what there is to see in every step."""
    return np.full(teams.num_envs, _A_WHILE * case.scenario.tau)


TANK = (
    Claim(
        "tank-ledger",
        "any wishes under a tank: V + ΣA never rises in a step without a merge, A ≥ 0",
        draw_ledgers,
        tanked,
        for_a_while,
        (keeps,),
        anything,
        watch=ledger_is_kept,
    ),
    Claim(
        "tank-start",
        "any wishes under a tank: V ≤ V(0) + ΣB until the first merge",
        draw_ledgers,
        tanked,
        for_a_while,
        (keeps,),
        anything,
        watch=stays_below_start,
    ),
    Claim(
        "theorem-D",
        "any wishes under a tank: V ≤ V0⁺ + (n−1)rW + ΣB always, all meet, T ≤ D",
        draw_timed,
        tanked,
        bound_d,
        (meets, keeps),
        anything,
        timed=True,
        watch=stays_bounded,
    ),
    Claim(
        "tank-obstacles",
        "the same among obstacles: V ≤ V(0) + ΣB in motion without contact or merge",
        draw_obstructed,
        tanked,
        for_a_while,
        (keeps,),
        anything,
        watch=stays_below_start,
    ),
    Claim(
        "tank-nonholonomic",
        "any inputs of nonholonomic robots: V ≤ V(0) + ΣB until the first merge, bounded always",
        draw_bodies,
        tanked,
        for_a_while,
        (keeps,),
        anything,
        watch=nothing_rises_above,
    ),
)
