"""From a scenario to what the kernels work on: empty state, constants, rules of a start."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..experiment.obstacles import ObstacleField, pack, row_width
from ..experiment.scenario import CONTACT_MODES, Scenario
from .lanes import LANES
from .starts import StartRules
from .teams import BOOK, MIN_CLEARANCE, SQUARE_CLOSEST, Physics, Teams


def empty_teams(scenario: Scenario, batch: int) -> Teams:
    """State of teams that no reset has touched yet."""
    n, d, model = scenario.n_robots, scenario.dim, scenario.model
    layout, blocks = scenario.observation_layout, -(-batch // LANES)
    book = np.zeros((blocks, len(BOOK) * LANES))
    for entry in (MIN_CLEARANCE, SQUARE_CLOSEST):
        book[:, entry * LANES : (entry + 1) * LANES] = np.inf
    return Teams(
        positions=np.zeros((blocks, n, d * LANES)),
        frames=np.zeros((blocks, n, d * d * LANES)),
        weights=np.zeros((blocks, n * (n - 1) // 2, LANES)),
        angles=np.zeros((batch, n, model.n_angles)),
        obstacles=np.zeros((batch, layout.obstacle_slots, row_width(scenario.obstacles, d))),
        merged_into=np.tile(np.arange(n), (batch, 1)),
        book=book,
    )


def physics(scenario: Scenario, max_steps: int) -> tuple[Any, ...]:
    """The fields of Physics, as a plain tuple."""
    reward = scenario.reward
    turn_limits = [float(bound) for bound in scenario.action_bounds[1:]]
    nonholonomic = scenario.model.nonholonomic
    constants = Physics(
        n_angles=scenario.model.n_angles,
        duration=float(scenario.tau),
        merge_radius=float(scenario.merge_radius),
        speed_limit=float(scenario.speed_limit),
        yaw_rate_limit=turn_limits[0] if nonholonomic else 0.0,
        pitch_rate_limit=turn_limits[-1] if nonholonomic else 0.0,
        max_steps=max_steps,
        contact_mode=CONTACT_MODES.index(scenario.obstacle_contact),
        obstacle_range=float(scenario.obstacle_range),
        neighbour_slots=scenario.observation_layout.neighbour_slots,
        rows=scenario.observation_layout.rows,
        reward_weights=(
            reward.progress,
            reward.time_penalty,
            reward.collision_penalty,
            reward.rendezvous_bonus,
        ),
        all_earn=scenario.on_merge == "follow",
    )
    return tuple(constants)


def start_rules(scenario: Scenario) -> StartRules:
    """The rules of a start of which nothing is given."""
    graph, field = scenario.sensing_graph, scenario.obstacles
    count, radius, region, keep_out, overlap = (0, 0), (0.0, 0.0), 0.0, 0.0, True
    if isinstance(field, ObstacleField):
        count = field.count_range
        radius, region = field.radius, field.region
        keep_out, overlap = field.keep_out, field.overlap
    return StartRules(
        draw_positions=True,
        draw_frames=True,
        draw_angles=True,
        draw_weights=True,
        draw_obstacles=True,
        spawn_size=float(scenario.spawn_size),
        least_distance=2.0 * scenario.merge_radius,
        topology=graph.topology,
        probability=float(graph.probability),
        weight_range=graph.weight_range,
        base_weights=graph.base_weights(scenario.n_robots),
        field_counts=count,
        field_radii=radius,
        field_region=float(region),
        keep_out=float(keep_out),
        field_overlap=overlap,
    )


def fixed_obstacles(scenario: Scenario) -> NDArray[np.float64] | None:
    """The scenario's obstacles, (1, M, width); None if they are drawn."""
    if isinstance(scenario.obstacles, ObstacleField):
        return None
    slots = scenario.observation_layout.obstacle_slots
    return pack(scenario.obstacles, scenario.dim, slots)[None]
