"""Gymnasium spaces of a scenario, and the privileged global state. One place, used by every
environment.
"""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from ..experiment.packing import row_width
from ..experiment.scenario import Scenario
from ..guarantee.action_filter import ActionFilter
from ..simulator import Simulator


def observation_bounds(scenario: Scenario) -> NDArray[np.float32]:
    """Symmetric bound on every number of an observation, (rows, d): D̄ for neighbours, 1 for the
    rest.
    """
    layout = scenario.observation_layout
    bounds = np.ones(layout.shape)
    bounds[layout.neighbours] = max(scenario.max_degree, 1e-6)
    bounds[layout.velocity] = scenario.speed_limit
    return np.nextafter(bounds.astype(np.float32), np.float32(np.inf))


def action_bounds(scenario: Scenario) -> NDArray[np.float32]:
    """Symmetric bound on every number of an action, (a,)."""
    return scenario.action_bounds.astype(np.float32)


def observation_box(scenario: Scenario) -> Box:
    """Space of one robot's observations."""
    bounds = observation_bounds(scenario)
    return Box(-bounds, bounds, dtype=np.float32)


def action_box(scenario: Scenario) -> Box:
    """Space of one robot's actions."""
    bounds = action_bounds(scenario)
    return Box(-bounds, bounds, dtype=np.float32)


def choice_box(action_filter: ActionFilter) -> Box:
    """Space of what a policy chooses for one robot, in units of the largest."""
    return Box(action_filter.lowest_choice, 1.0, (action_filter.action_size,), dtype=np.float32)


def filtered_observation_box(action_filter: ActionFilter) -> Box:
    """Space of one robot's observations as a filter shows them: a turned row keeps only its
    length, and the level of a tank has no bound.
    """
    bounds = observation_bounds(action_filter.scenario)
    if action_filter.along_net_bearing:
        bounds = bounds * np.float32(1.0 + 1e-6)
    if action_filter.observes_level:
        level = np.ones((1, bounds.shape[1]), dtype=np.float32)
        level[0, 0] = np.finfo(np.float32).max
        bounds = np.concatenate([bounds, level])
    return Box(-bounds, bounds, dtype=np.float32)


def team_observation_box(scenario: Scenario) -> Box:
    """Space of the observations of all robots of a team, (n, rows, d)."""
    bounds = _for_all_robots(scenario, observation_bounds(scenario))
    return Box(-bounds, bounds, dtype=np.float32)


def team_action_box(scenario: Scenario) -> Box:
    """Space of the actions of all robots of a team, (n, a)."""
    bounds = _for_all_robots(scenario, action_bounds(scenario))
    return Box(-bounds, bounds, dtype=np.float32)


def _for_all_robots(scenario: Scenario, bounds: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.repeat(bounds[None], scenario.n_robots, axis=0)


def state_box(scenario: Scenario) -> Box:
    """Space of ``team_state``: any finite float32."""
    largest = float(np.finfo(np.float32).max)
    return Box(-largest, largest, (_state_size(scenario),), dtype=np.float32)


def team_state(simulator: Simulator) -> NDArray[np.float32]:
    """The privileged global state of every team, (B, …) float32.

    Positions (n·d, m), frames (n·d·d), weights (n·n, m/s), active (n), packed obstacles (M·width),
    and the share of the time limit that has passed.
    """
    parts = (
        simulator.positions,
        simulator.frames,
        simulator.weights,
        simulator.active,
        simulator.obstacles,
        (simulator.steps / simulator.max_steps)[:, None],
    )
    batch = simulator.num_envs
    return np.concatenate([part.reshape(batch, -1) for part in parts], axis=1).astype(np.float32)


def _state_size(scenario: Scenario) -> int:
    n, d = scenario.n_robots, scenario.dim
    obstacles = scenario.observation_layout.obstacle_slots * row_width(scenario.obstacles)
    return n * d + n * d * d + n * n + n + obstacles + 1
