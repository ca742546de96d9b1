"""Cases for the claims about energy tanks, and the policies that are tried on them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from rendezvous_env import ObstacleField
from rendezvous_env.guarantee.energy_tank import EnergyTank
from rendezvous_env.trajectory import Policy

from .cases import Case, draw_case, draw_nonholonomic
from .tank_adversaries import Tanked, wishes

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
