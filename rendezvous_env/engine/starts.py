"""How an episode begins: graph, obstacles, places and attitudes, drawn from their own streams."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from ..equations.geometry import clear_of_obstacles
from ..equations.random_streams import (
    FRAMES,
    GRAPH,
    OBSTACLES,
    START,
    draw_rotation,
    stream_key,
    uniform,
)
from ..experiment.graphs import draw_weights
from ..experiment.obstacles import draw_field
from ..guarantee.lyapunov import square_distance, team_lyapunov
from .lanes import LANES
from .teams import (
    ACTIVE,
    BOOK,
    INITIAL_LYAPUNOV,
    MIN_CLEARANCE,
    STATUS,
    read_positions,
    read_weights,
    write_frame,
    write_positions,
    write_weights,
)

_TRIES_FOR_START = 1000
_LARGEST_START_PITCH = math.pi / 4


class StartRules(NamedTuple):
    """How an episode begins: what is drawn, and from where."""

    draw_positions: bool
    draw_frames: bool
    draw_angles: bool
    draw_weights: bool
    draw_obstacles: bool
    spawn_size: float
    least_distance: float
    topology: int
    probability: float
    weight_range: tuple[float, float]
    base_weights: NDArray[np.float64]
    field_counts: tuple[int, int]
    field_radii: tuple[float, float]
    field_region: float
    keep_out: float
    field_overlap: bool


@kernel
def reset_teams(indices, status, rules, seeds, episodes, teams):
    """Begin a new episode in the teams with these indices; what is given already stands in the
    state.

    Returns:
        Index of the first team that found no room for its start or its obstacles, in which case
        nothing has changed, or −1.
    """
    n, d = teams.merged_into.shape[1], teams.positions.shape[2] // LANES
    count = len(indices)
    positions, weights = np.empty((count, n, d)), np.empty((count, n, n))
    obstacles = np.empty((count, *teams.obstacles.shape[1:]))
    for k, team in enumerate(indices):
        if not _draw_start(
            team, rules, seeds[team], episodes[team], teams, positions[k], weights[k], obstacles[k]
        ):
            return team
    for k, team in enumerate(indices):
        block, lane = team // LANES, team % LANES
        write_positions(block, lane, teams, positions[k])
        write_weights(block, lane, teams, weights[k])
        teams.obstacles[team] = obstacles[k]
        _draw_attitudes(team, rules, seeds[team], episodes[team], teams)
        _open_book(team, status, positions[k], weights[k], teams)
    return -1


@kernel
def _draw_start(team, rules, seed, episode, teams, positions, weights, obstacles):
    """What of one team's start may find no room; whether it fits. What is not drawn is as given."""
    block, lane = team // LANES, team % LANES
    read_positions(block, lane, teams, positions)
    read_weights(block, lane, teams, weights)
    obstacles[:] = teams.obstacles[team]
    if rules.draw_weights:
        _draw_weights(stream_key(seed, episode, GRAPH), rules, weights)
    room = _draw_obstacles(seed, episode, rules, positions, obstacles)
    if room and rules.draw_positions:
        key = stream_key(seed, episode, START)
        room = _draw_positions(key, rules, weights, obstacles, positions)
    return room


@kernel
def _draw_attitudes(team, rules, seed, episode, teams):
    block, lane = team // LANES, team % LANES
    n, d = teams.merged_into.shape[1], teams.positions.shape[2] // LANES
    key = stream_key(seed, episode, FRAMES)
    if teams.angles.shape[2] > 0 and rules.draw_angles:
        _draw_angles(key, teams.angles[team])
    if teams.angles.shape[2] == 0 and rules.draw_frames:
        frame = np.empty((d, d))
        for i in range(n):
            draw_rotation(key, 3 * i, frame)
            write_frame(block, lane, i, teams, frame)


@kernel
def _open_book(team, status, positions, weights, teams):
    book, lane = teams.book[team // LANES], team % LANES
    n = teams.merged_into.shape[1]
    for i in range(n):
        teams.merged_into[team, i] = i
    for entry in range(len(BOOK)):
        book[entry * LANES + lane] = 0.0
    book[STATUS * LANES + lane] = status
    book[ACTIVE * LANES + lane] = n
    book[MIN_CLEARANCE * LANES + lane] = np.inf
    book[INITIAL_LYAPUNOV * LANES + lane] = team_lyapunov(positions, weights)


@kernel
def _draw_weights(key, rules, weights):
    draw_weights(
        key,
        rules.topology,
        rules.probability,
        rules.weight_range[0],
        rules.weight_range[1],
        rules.base_weights,
        weights,
    )


@kernel
def _draw_obstacles(seed, episode, rules, positions, obstacles):
    if not rules.draw_obstacles:
        return True
    return draw_field(
        stream_key(seed, episode, OBSTACLES),
        rules.field_counts[0],
        rules.field_counts[1],
        rules.field_radii[0],
        rules.field_radii[1],
        rules.field_region,
        rules.keep_out,
        rules.field_overlap,
        positions,
        0 if rules.draw_positions else positions.shape[0],
        obstacles,
    )


@kernel
def _draw_positions(key, rules, weights, obstacles, positions):
    """Uniform in the spawn area, neighbours at least 2r apart, clear of obstacles; whether it
    fits.
    """
    n, d = positions.shape
    counter = 0
    for i in range(n):
        for _ in range(_TRIES_FOR_START):
            for k in range(d):
                positions[i, k] = rules.spawn_size * (uniform(key, counter) - 0.5)
                counter += 1
            placed = _apart(i, positions, weights, rules.least_distance)
            if placed and clear_of_obstacles(positions[i], obstacles, rules.keep_out):
                break
        else:
            return False
    return True


@kernel
def _apart(i, positions, weights, least_distance):
    for j in range(i):
        if weights[i, j] > 0.0:
            if square_distance(positions, i, j) < least_distance * least_distance:
                return False
    return True


@kernel
def _draw_angles(key, angles):
    """Uniform yaw, and pitch uniform within 45° of the horizontal."""
    n, n_angles = angles.shape
    for i in range(n):
        angles[i, 0] = math.pi * (2.0 * uniform(key, 3 * i) - 1.0)
        if n_angles == 2:
            angles[i, 1] = _LARGEST_START_PITCH * (2.0 * uniform(key, 3 * i + 1) - 1.0)
