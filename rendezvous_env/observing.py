"""What the robots of a block of teams see: lane buffers to observations."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .geometry import obstacle_distance, silhouette_2d, silhouette_3d
from .jit import kernel
from .lanes import LANES, pair_rows
from .lyapunov import team_net_bearing
from .teams import read_positions, read_weights


class Scratch(NamedTuple):
    """Lane buffers of the block at hand."""

    action: NDArray[np.float64]
    """(n, a·LANES), in the robots' own frames; clipped inputs of nonholonomic robots."""
    displacement: NDArray[np.float64]
    """(n, (d + 1)·LANES), m, and its length."""
    near: NDArray[np.float64]
    """(LANES,), whether something can meet in the team: 0 no, 1 yes, 2 it has merged."""
    pair: NDArray[np.float64]
    """((1 + 2d)·LANES,), see ``pair_rows``."""
    rows: NDArray[np.float32]
    """(n·rows·d, LANES), the observations."""


@kernel
def make_scratch(n, d, action_size, rows):
    """Lane buffers for teams of n robots."""
    return Scratch(
        np.zeros((n, action_size * LANES)),
        np.zeros((n, (d + 1) * LANES)),
        np.zeros(LANES),
        np.zeros((1 + 2 * d) * LANES),
        np.zeros((n * rows * d, LANES), dtype=np.float32),
    )


@kernel
def observe_block(block, lanes, physics, axes, teams, results, scratch):
    """Write a block's observations; half of V is left in the first number of ``scratch.pair``."""
    n, d = scratch.action.shape[0], len(axes)
    width = physics.rows * d
    positions, frames, weights = teams.positions[block], teams.frames[block], teams.weights[block]
    scratch.pair[:LANES] = 0.0
    pair = 0
    for i in range(n):
        for j in range(i + 1, n):
            pair_rows(
                positions[i], positions[j], frames[i], frames[j], weights[pair], axes, scratch.pair
            )
            # in index order robot j is row j − 1 of robot i < j, and robot i is row i of robot j
            _store(scratch.pair, 1, d, i * width + (j - 1) * d, scratch.rows)
            _store(scratch.pair, 1 + d, d, j * width + i * d, scratch.rows)
            pair += 1
    if teams.obstacles.shape[1] > 0:
        _observe_obstacles(block, lanes, physics, d, teams, results, scratch)
    if physics.n_angles == 2:
        _observe_gravity(block, lanes, width, teams, scratch)
    observations = results.observations[block * LANES : block * LANES + lanes]
    for k in range(scratch.rows.shape[0]):
        for lane in range(lanes):
            observations[lane, k] = scratch.rows[k, lane]


@kernel
def _store(values, first, d, row, rows):
    """Copy d numbers of a lane buffer into the observations."""
    for axis in range(d):
        for lane in range(LANES):
            rows[row + axis, lane] = values[(first + axis) * LANES + lane]


@kernel
def _observe_obstacles(block, lanes, physics, d, teams, results, scratch):
    n = scratch.action.shape[0]
    points = np.empty((2 if d == 2 else 8, d))
    positions = np.empty((n, d))
    for lane in range(lanes):
        team = block * LANES + lane
        read_positions(block, lane, teams, positions)
        least = teams.book[team]["min_clearance"]
        for i in range(n):
            nearest = np.inf
            active = teams.merged_into[team, i] == i
            for m in range(teams.obstacles.shape[1]):
                distance = np.inf
                if active:
                    distance = obstacle_distance(teams.obstacles[team, m], positions[i])
                nearest = min(nearest, distance)
                seen = distance <= physics.obstacle_range
                if seen:
                    _see_obstacle(block, lane, i, m, positions, teams, points)
                _store_silhouette(block, lane, i, m, seen, physics, teams, points, scratch.rows)
            results.clearance[team, i] = nearest
            least = min(least, nearest)
        teams.book[team]["min_clearance"] = least


@kernel
def _see_obstacle(block, lane, i, m, positions, teams, points):
    """Silhouette bearings of obstacle m as robot i sees it, in the global frame."""
    n, d = positions.shape
    obstacle = teams.obstacles[block * LANES + lane, m]
    if d == 2:
        silhouette_2d(obstacle, positions[i], points)
        return
    f, axis_x, axis_y, weights = np.empty(d), np.empty(d), np.empty(d), np.empty((n, n))
    read_weights(block, lane, teams, weights)
    team_net_bearing(positions, weights, i, f)
    for k in range(d):
        axis_x[k] = teams.frames[block, i, (k * d) * LANES + lane]
        axis_y[k] = teams.frames[block, i, (k * d + 1) * LANES + lane]
    silhouette_3d(obstacle, positions[i], f, axis_x, axis_y, points)


@kernel
def _store_silhouette(block, lane, i, m, seen, physics, teams, points, rows):
    """Turn silhouette bearings into the local frame; an obstacle that is not seen is zero."""
    n_points, d = points.shape
    for s in range(n_points):
        row = i * physics.rows + physics.neighbour_slots + m * n_points + s
        for axis in range(d):
            along = 0.0
            if seen:
                for k in range(d):
                    along += teams.frames[block, i, (k * d + axis) * LANES + lane] * points[s, k]
            rows[row * d + axis, lane] = along


@kernel
def _observe_gravity(block, lanes, width, teams, scratch):
    """The last row of a 3-D nonholonomic robot: (−sin β, 0, −cos β) in its body frame."""
    for lane in range(lanes):
        team = block * LANES + lane
        for i in range(teams.angles.shape[1]):
            active = teams.merged_into[team, i] == i
            pitch = teams.angles[team, i, 1]
            last = (i + 1) * width - 3
            scratch.rows[last, lane] = -math.sin(pitch) if active else 0.0
            scratch.rows[last + 2, lane] = -math.cos(pitch) if active else 0.0
