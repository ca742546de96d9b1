"""What the robots of a block of teams see: lane buffers to observations."""

import math

import numpy as np

from ..compilation import inlined_kernel, kernel
from ..equations.geometry import (
    CENTRE,
    COUNT,
    RADIUS,
    ROUND,
    obstacle_distance,
    silhouette_2d,
    silhouette_3d,
)
from ..guarantee.lyapunov import team_net_bearing
from .lanes import LANES, see_disc, see_pair, store_row
from .teams import MIN_CLEARANCE, SQUARE_CLOSEST, read_frame, read_positions, read_weights


@inlined_kernel
def load_obstacles(block, lanes, d, teams, scratch):
    """Bring a block's obstacles into lane buffers."""
    for lane in range(lanes):
        obstacles = teams.obstacles[block * LANES + lane]
        for m in range(obstacles.shape[0]):
            kind, radius = obstacles[m, COUNT], obstacles[m, RADIUS]
            for k in range(d):
                scratch.balls[m, k * LANES + lane] = obstacles[m, CENTRE + k]
            scratch.balls[m, d * LANES + lane] = radius if kind >= ROUND else np.nan
            scratch.balls[m, (d + 1) * LANES + lane] = radius if kind == ROUND else np.nan


@inlined_kernel
def observe_block(block, lanes, physics, axes, span, teams, results, scratch):
    """Write a block's observations and clearances, and who is closest; half of V is left in
    ``scratch.pair``.
    """
    first, d = block * LANES, len(axes)
    _observe_neighbours(block, physics, axes, span, teams, scratch)
    if d == 3 or teams.obstacles.shape[1] == 0:
        clearances = results.clearance[first : first + lanes].reshape(-1)
        for k in range(len(clearances)):
            clearances[k] = np.inf
    else:
        _observe_discs(block, lanes, physics, axes, span, teams, results, scratch)
    if teams.obstacles.shape[1] > 0:
        _observe_one_by_one(block, lanes, physics, d, teams, results, scratch)
    if physics.n_angles == 2:
        _observe_gravity(block, lanes, physics.rows, teams, scratch)
    observations = results.observations[first : first + lanes]
    if d == 2:  # both numbers of a row in one piece
        _store_rows(scratch.rows.view(np.float64), axes[:1], observations.view(np.float64))
    else:
        _store_rows(scratch.rows, axes, observations)


@inlined_kernel
def _observe_neighbours(block, physics, axes, span, teams, scratch):
    """Every pair once, in index order: the complete graph; an edge that is absent weighs 0."""
    positions, frames, weights = teams.positions[block], teams.frames[block], teams.weights[block]
    found, rows = scratch.pair, scratch.rows
    found[:LANES] = 0.0
    found[LANES : 2 * LANES] = np.inf
    pair, n = 0, positions.shape[0]
    for i in range(n):
        for j in range(i + 1, n):
            see_pair(span, positions[i], positions[j], weights[pair], axes, found)
            # in index order robot j is row j − 1 of robot i < j, and robot i is row i of robot j
            vector = found[2 * LANES :]
            store_row(span, vector, 0, frames[i], axes, rows[i * physics.rows + j - 1])
            store_row(span, vector, 1, frames[j], axes, rows[j * physics.rows + i])
            pair += 1
    for lane in range(LANES):
        teams.book[block, SQUARE_CLOSEST * LANES + lane] = found[LANES + lane]


@inlined_kernel
def _store_rows(rows, axes, observations):
    """From lanes to teams."""
    d = len(axes)
    for k in range(rows.shape[0]):
        for lane in range(observations.shape[0]):
            for axis in range(d):
                observations[lane, k * d + axis] = rows[k, lane * d + axis]


@inlined_kernel
def _observe_discs(block, lanes, physics, axes, span, teams, results, scratch):
    """Discs in the plane, over lanes; the rows of everything else are zero after it."""
    disc = scratch.disc
    for i in range(scratch.action.shape[0]):
        for lane in range(lanes):
            active = teams.merged_into[block * LANES + lane, i] == i
            scratch.sight[lane] = physics.obstacle_range if active else -np.inf
        disc[:LANES] = np.inf
        row = i * physics.rows + physics.neighbour_slots
        frame = teams.frames[block, i]
        for m in range(scratch.balls.shape[0]):
            see_disc(span, teams.positions[block, i], scratch.balls[m], scratch.sight, disc)
            store_row(span, disc[LANES:], 0, frame, axes, scratch.rows[row])
            store_row(span, disc[4 * LANES :], 0, frame, axes, scratch.rows[row + 1])
            row += 2
        for lane in range(lanes):
            active = scratch.sight[lane] >= 0.0
            results.clearance[block * LANES + lane, i] = disc[lane] if active else np.inf


@kernel
def _observe_one_by_one(block, lanes, physics, d, teams, results, scratch):
    """What no lane function does: polygons, and spheres in space; the least clearance of all."""
    n = scratch.action.shape[0]
    points = np.empty((2 if d == 2 else 8, d))
    positions, weights, net_bearing = np.empty((n, d)), np.empty((n, n)), np.empty(d)
    for lane in range(lanes):
        team = block * LANES + lane
        least = teams.book[block, MIN_CLEARANCE * LANES + lane]
        if d == 3 or _has_polygon(teams.obstacles[team]):
            read_positions(block, lane, teams, positions)
            read_weights(block, lane, teams, weights)
            for i in range(n):
                team_net_bearing(positions, weights, i, net_bearing)
                _see_others(
                    block,
                    lane,
                    i,
                    physics,
                    positions[i],
                    net_bearing,
                    teams,
                    points,
                    results,
                    scratch,
                )
        for i in range(n):
            least = min(least, results.clearance[team, i])
        teams.book[block, MIN_CLEARANCE * LANES + lane] = least


@kernel
def _has_polygon(obstacles):
    for m in range(obstacles.shape[0]):
        if obstacles[m, COUNT] > ROUND:
            return True
    return False


@kernel
def _see_others(block, lane, i, physics, position, net_bearing, teams, points, results, scratch):
    """All obstacles of one robot that ``_observe_discs`` leaves out."""
    team, d = block * LANES + lane, position.shape[0]
    active = teams.merged_into[team, i] == i
    frame = np.empty((d, d))
    read_frame(block, lane, i, teams, frame)
    for m in range(teams.obstacles.shape[1]):
        obstacle = teams.obstacles[team, m]
        if d == 2 and obstacle[COUNT] <= ROUND:
            continue
        distance = obstacle_distance(obstacle, position) if active else np.inf
        results.clearance[team, i] = min(results.clearance[team, i], distance)
        seen = distance <= physics.obstacle_range
        if seen and d == 2:
            silhouette_2d(obstacle, position, points)
        elif seen:
            silhouette_3d(obstacle, position, net_bearing, frame[:, 0], frame[:, 1], points)
        row = i * physics.rows + physics.neighbour_slots + m * points.shape[0]
        _store_silhouette(lane, row, seen, frame, points, scratch.rows)


@kernel
def _store_silhouette(lane, first, seen, frame, points, rows):
    """Turn silhouette bearings into the local frame; an obstacle that is not seen is zero."""
    d = frame.shape[0]
    for s in range(points.shape[0]):
        for axis in range(d):
            along = 0.0
            if seen:
                for k in range(d):
                    along += frame[k, axis] * points[s, k]
            rows[first + s, lane * d + axis] = along


@inlined_kernel
def _observe_gravity(block, lanes, rows, teams, scratch):
    """The last row of a 3-D nonholonomic robot: (−sin β, 0, −cos β) in its body frame."""
    for lane in range(lanes):
        team = block * LANES + lane
        for i in range(teams.angles.shape[1]):
            active = teams.merged_into[team, i] == i
            pitch = teams.angles[team, i, 1]
            row = scratch.rows[(i + 1) * rows - 1]
            row[3 * lane] = -math.sin(pitch) if active else 0.0
            row[3 * lane + 2] = -math.cos(pitch) if active else 0.0
