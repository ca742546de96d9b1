"""Gymnasium spaces of a scenario, and the global state, for all environments."""

from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ..obstacles.parsing import row_width
from ..robots.robot_models import constants_of
from ..safety.safety_filter import SafetyFilter
from ..scenario.scenario import Scenario
from ..simulator import Simulator

_LARGEST = float(np.finfo(np.float32).max)


def maybe_flatten(rows: NDArray[np.float32], flatten: bool) -> NDArray[np.float32]:
    """View of rows (..., rows, d), or (..., rows·d) with ``flatten``."""
    return rows.reshape(*rows.shape[:-2], -1) if flatten else rows


def observation_box(
    scenario: Scenario, flatten: bool = False, action_filter: SafetyFilter | None = None
) -> Box:
    """Observation space of one robot: neighbour rows have length at most D̄, others 1.

    Under a filter only lengths are bounded, since rows are rotated, and stored energy is unbounded.
    """
    layout = scenario.observation_layout
    lengths = np.ones(layout.shape)
    lengths[layout.neighbours] = max(scenario.max_degree, 1e-6)
    fastest = constants_of(scenario).speed_limit
    lengths[layout.velocity] = max(fastest, 1.0) if layout.senses_gravity else fastest
    high: Any = np.nextafter(lengths.astype(np.float32), np.float32(np.inf))
    if action_filter is not None and action_filter.along_net_bearing:
        high = high * np.float32(1.0 + 1e-6)
    if action_filter is not None and action_filter.observes_level:
        level = np.ones((1, layout.dim), dtype=np.float32)
        level[0, 0] = _LARGEST
        high = np.concatenate([high, level])
    high = maybe_flatten(high, flatten)
    return Box(-high, high, dtype=np.float32)


def action_box(scenario: Scenario) -> Box:
    """Action space of one robot; with limits per robot, the smallest that contains all."""
    bounds = scenario.action_bounds.astype(np.float32)
    return Box(-bounds, bounds, dtype=np.float32)


def team_action_box(scenario: Scenario) -> Box:
    """Action space of all robots, (n, a).

    Components that a robot does not have are bounded as those of others, see ``action_mask``.
    """
    bounds = np.where(scenario.action_mask, scenario.robot_bounds, scenario.action_bounds)
    bounds = bounds.astype(np.float32)
    return Box(-bounds, bounds, dtype=np.float32)


def choice_box(action_filter: SafetyFilter) -> Box:
    """Normalised action space of a filter for one robot."""
    return Box(action_filter.lowest_choice, 1.0, (action_filter.action_size,), dtype=np.float32)


def batched_space(space_of_one: str) -> Any:
    """Lazy attribute with the batched form of a single-environment space, which is large."""
    return cached_property(lambda env: batch_space(getattr(env, space_of_one), env.num_envs))


def team_box(robot: Box, n: int) -> Box:
    """Space of n robots with equal spaces, (n, ...)."""
    low, high = (np.broadcast_to(bound, (n, *robot.shape)) for bound in (robot.low, robot.high))
    return Box(low, high, dtype=np.float32)


def of_one_robot(
    space: Space[Any], robot: int | None = None, parts: NDArray[np.bool_] | None = None
) -> Any:
    """Space of one robot, a Box or a Discrete, from that of n; None is one that contains all.

    With ``parts``, (a,), it has these components only.
    """
    if isinstance(space, MultiDiscrete):
        return Discrete(int(space.nvec[0]))
    assert isinstance(space, Box)
    if robot is None:
        return Box(space.low.min(axis=0), space.high.max(axis=0), dtype=np.float32)
    low, high = space.low[robot], space.high[robot]
    if parts is not None:
        low, high = low[parts], high[parts]
    return Box(low, high, dtype=np.float32)


def state_box(scenario: Scenario) -> Box:
    """Space of ``team_state``: any finite float32."""
    n, d = scenario.n_robots, scenario.dim
    slots = scenario.obstacle_places
    obstacles = slots * row_width(scenario.obstacles)
    size = n * d + n * d * d + n * n + n + obstacles + 1
    return Box(-_LARGEST, _LARGEST, (size,), dtype=np.float32)


def team_state(simulator: Simulator) -> NDArray[np.float32]:
    """Global state of every environment, (B, …) float32; see ``SingleEnvMixin.state``."""
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
