"""What the robots of a block of teams see: lane buffers to observations."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .geometry import (
    CENTRE,
    COUNT,
    RADIUS,
    ROUND,
    obstacle_distance,
    silhouette_2d,
    silhouette_3d,
)
from .jit import kernel
from .lanes import LANES, disc_rows, pair_rows
from .lyapunov import team_net_bearing
from .teams import read_positions, read_weights

_FAR_AWAY = 1e150
"""m; where obstacles that are not there stand in lane buffers."""


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
    centre: NDArray[np.float64]
    """(M, d·LANES), of the obstacles, m; far away where there is none."""
    bound: NDArray[np.float64]
    """(M, LANES), radius of a ball about the centre that holds the obstacle, m."""
    disc: NDArray[np.float64]
    """(M, d·LANES), centres as above, but far away for a polygon, too."""
    sight: NDArray[np.float64]
    """(6·LANES,), whether a robot is active, and what ``disc_rows`` gives out."""


@kernel
def make_scratch(n, d, action_size, rows, n_obstacles):
    """Lane buffers for teams of n robots among at most that many obstacles."""
    return Scratch(
        np.zeros((n, action_size * LANES)),
        np.zeros((n, (d + 1) * LANES)),
        np.zeros(LANES),
        np.zeros((1 + 2 * d) * LANES),
        np.zeros((n * rows * d, LANES), dtype=np.float32),
        np.full((n_obstacles, d * LANES), _FAR_AWAY),
        np.zeros((n_obstacles, LANES)),
        np.full((n_obstacles, d * LANES), _FAR_AWAY),
        np.zeros(6 * LANES),
    )


@kernel
def load_obstacles(block, lanes, teams, scratch):
    """Bring a block's obstacles into lane buffers."""
    for lane in range(lanes):
        obstacles = teams.obstacles[block * LANES + lane]
        for m in range(obstacles.shape[0]):
            kind = obstacles[m, COUNT]
            scratch.bound[m, lane] = obstacles[m, RADIUS]
            for k in range(scratch.centre.shape[1] // LANES):
                place = obstacles[m, CENTRE + k]
                scratch.centre[m, k * LANES + lane] = place if kind >= ROUND else _FAR_AWAY
                scratch.disc[m, k * LANES + lane] = place if kind == ROUND else _FAR_AWAY


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
        if d == 2:
            _observe_discs(block, lanes, physics, teams, results, scratch)
        _observe_one_by_one(block, lanes, physics, d, teams, results, scratch)
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
def _observe_discs(block, lanes, physics, teams, results, scratch):
    """Discs in the plane, over lanes; the rows of everything else are zero after it."""
    sight = scratch.sight
    for i in range(scratch.action.shape[0]):
        for lane in range(lanes):
            sight[lane] = 1.0 if teams.merged_into[block * LANES + lane, i] == i else 0.0
            sight[LANES + lane] = np.inf
        for m in range(scratch.disc.shape[0]):
            disc_rows(
                scratch.disc[m],
                scratch.bound[m],
                teams.positions[block, i],
                teams.frames[block, i],
                sight[:LANES],
                physics.obstacle_range,
                sight[LANES:],
            )
            row = i * physics.rows + physics.neighbour_slots + 2 * m
            _store(sight, 2, 4, 2 * row, scratch.rows)
        for lane in range(lanes):
            results.clearance[block * LANES + lane, i] = sight[LANES + lane]


@kernel
def _observe_one_by_one(block, lanes, physics, d, teams, results, scratch):
    """What no lane function does: polygons, and spheres in space; the least clearance of all."""
    n = scratch.action.shape[0]
    points = np.empty((2 if d == 2 else 8, d))
    positions = np.empty((n, d))
    for lane in range(lanes):
        team = block * LANES + lane
        least = teams.book[team]["min_clearance"]
        if d == 3 or _has_polygon(teams.obstacles[team]):
            read_positions(block, lane, teams, positions)
            for i in range(n):
                if teams.merged_into[team, i] == i:
                    _see_others(block, lane, i, physics, positions, teams, points, results, scratch)
        for i in range(n):
            least = min(least, results.clearance[team, i])
        teams.book[team]["min_clearance"] = least


@kernel
def _has_polygon(obstacles):
    for m in range(obstacles.shape[0]):
        if obstacles[m, COUNT] > ROUND:
            return True
    return False


@kernel
def _see_others(block, lane, i, physics, positions, teams, points, results, scratch):
    """All obstacles of one active robot that ``_observe_discs`` leaves out."""
    team = block * LANES + lane
    for m in range(teams.obstacles.shape[1]):
        if positions.shape[1] == 2 and teams.obstacles[team, m, COUNT] == ROUND:
            continue
        distance = obstacle_distance(teams.obstacles[team, m], positions[i])
        results.clearance[team, i] = min(results.clearance[team, i], distance)
        seen = distance <= physics.obstacle_range
        if seen:
            _see_obstacle(block, lane, i, m, positions, teams, points)
        _store_silhouette(block, lane, i, m, seen, physics, teams, points, scratch.rows)


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
