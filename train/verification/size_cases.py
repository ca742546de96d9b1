"""Cases for the claims about the size of a team."""

from __future__ import annotations

import math

import numpy as np

from rendezvous_env import Scenario
from rendezvous_env.experiment import graphs

from .cases import Case, draw_case

_DRIVING = (0.4, 0.8)
"""Speed of a pursuer over ω_max r/2."""
_TURN_IN_A_STEP = 0.05
"""That a pursuer turns through at most, rad."""


def draw_uniform(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Complete graphs of one weight: every pair can dock, and has a row of its own."""
    return _complete(draw_case(random, batch, least_margin), random)


def draw_followed(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Steps that come near to continuous time."""
    return draw_case(random, batch, least_margin, step_factors=(0.2, 1.0))


def draw_held(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Complete graphs and cycles of one weight, with a step that theorem N covers."""
    scenario = _complete(
        draw_case(random, batch, least_margin, speed_limits=False), random
    ).scenario
    n = scenario.n_robots
    if n > 2 and random.random() < 0.5:
        scenario = scenario.replace(graph=graphs.cycle(scenario.bottleneck_weight))
    most = math.pi / n if scenario.dim == 2 or n == 2 else math.atan(1 / math.sqrt(n * (n - 2)))
    error = random.uniform(0.3, 0.9) * most
    step = scenario.merge_radius * math.sin(error) / (2.0 * scenario.max_degree)
    return Case(scenario.replace(time_step=step), 1.0)


def draw_pursuers(random: np.random.Generator, batch: int, least_margin: float) -> Case:
    """Unicycles or 3-D robots that know their neighbours apart, on any graph."""
    dim = int(random.choice([2, 3]))
    model = "unicycle" if dim == 2 else "nonholonomic_3d"
    scenario = draw_case(random, batch, least_margin, dims=(dim,), robot_model=model).scenario
    turn = random.uniform(2.0, 6.0)
    return Case(
        scenario.replace(
            max_turn_rate=turn,
            max_speed=random.uniform(*_DRIVING) * turn * scenario.merge_radius / 2.0,
            time_step=_TURN_IN_A_STEP / turn,
            allow_long_step=True,
            neighbour_slots=scenario.n_robots - 1,
        ),
        1.0,
    )


def _complete(case: Case, random: np.random.Generator) -> Case:
    """The same team on a complete graph of one weight."""
    scenario: Scenario = case.scenario
    graph = graphs.complete(random.uniform(0.5, 2.0))
    return Case(scenario.replace(graph=graph), case.margin, case.options)
