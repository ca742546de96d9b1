"""The teams that a run trains in: all alike, or groups whose sensors differ."""

from __future__ import annotations

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines.learned.perceiving import PerceivingTeams
from rendezvous_env import make_vec
from rendezvous_env.experiment.scenario import Scenario
from rendezvous_env.experiment.sensing import Sensing

from .global_state import GlobalStateLayout
from .sensing_groups import SensingGroups
from .settings import Config


def make_teams(config: Config, stage: int) -> PerceivingTeams | SensingGroups:
    """The teams of a stage of the curriculum."""
    scenario, ranges = config.stage_scenario(stage), config.sensing_ranges()
    if not ranges:
        return _alike(config, scenario, config.num_teams)

    def make(sensing: Sensing, size: int) -> PerceivingTeams:
        return _alike(config, scenario.replace(sensing=sensing), size)

    def draw(group: int, generation: int) -> Sensing:
        return ranges.draw(scenario.sensing, config.seed, group, generation)

    parts = np.array_split(np.arange(config.num_teams), config.sensing_groups)
    return SensingGroups(make, draw, [len(part) for part in parts], config.sensing_updates)


def _alike(config: Config, scenario: Scenario, size: int) -> PerceivingTeams:
    slots = config.obstacle_slots()
    state = GlobalStateLayout(scenario.n_robots, slots)
    teams = make_vec(
        scenario,
        size,
        autoreset_mode=AutoresetMode.SAME_STEP,
        num_threads=config.num_threads,
    )
    return PerceivingTeams(
        teams,
        config.policy_settings(),
        touch_penalty=config.touch_penalty,
        obstacle_slots=slots,
        global_state=state if config.critic == "global" else None,
    )
