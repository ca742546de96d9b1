"""What the robots of a block see of obstacles, and how near they are."""

import numpy as np

from ...compilation import by_type, inner_kernel
from ...graphs.edges import arcs_of, load_links
from ...obstacles.disc import BALL, disc_edges
from ...obstacles.obstacle_set import (
    RoundObstacles,
    distance_to,
    silhouette_2d,
    silhouette_3d,
)
from ...obstacles.shape import BOUND, MIDDLE
from ...physics.potential import net_bearings_of_arcs, net_bearings_of_links
from ...physics.vectors import load, local_axis, to_local
from ...rewards.terms import CLEARANCE_PENALTY
from ..memory import (
    Place,
    SeenDisc,
    first_row,
    in_lanes,
    lane_count,
    load_team,
    obstacles_of,
    read,
    read_row,
    statistics_of,
    tally_of,
    write_row,
)


@inner_kernel
def lay_out_discs(place, discs, obstacles):
    """Bring the discs of a team into its lane; in space ``discs`` has room for none."""
    if obstacles is not None:
        for m in range(discs.shape[1]):
            shape, disc = obstacles.shapes[place.team, m], discs[place.block, m]
            for k in range(2):
                disc[k, place.lane] = shape[MIDDLE + k]
            is_disc = obstacles.kinds[place.team, m] == BALL
            disc[2, place.lane] = shape[BOUND] if is_disc else np.nan


@inner_kernel(inline="code")
def sense_obstacles(block, setup, moves, state, obstacles, output, scratch):
    """Silhouettes, clearances, the least clearance of the episode, and closeness for the reward."""
    n, constants = state.teams.merged_into.shape[1], setup.constants
    # in one piece: the entries of a table would be filled one by one, without SIMD
    output.clearance.reshape(-1)[block.first * n : (block.first + block.count) * n] = np.inf
    if obstacles is not None:
        if not moves:  # a state may have been put back
            for lane in range(block.count):
                place = Place(block.index, lane, block.first + lane)
                lay_out_discs(place, state.teams.discs, obstacles)
        _see_discs(block, setup, state.teams, output.clearance, scratch.block, setup.layout.axes)
        _see_others(block, setup, state, obstacles, output.clearance, scratch, setup.layout.axes)
        tally = tally_of(scratch.block.tally)
        statistics = statistics_of(state.teams, block.index)
        weighs = constants.reward_weights[CLEARANCE_PENALTY] != 0.0
        for lane in range(block.count):
            least, closeness = np.inf, 0.0
            for i in range(n):
                clearance = output.clearance[block.first + lane, i]
                least = min(least, clearance)
                closeness += max(0.0, 1.0 - clearance / constants.obstacle_range)
            statistics.clearance[lane] = least
            statistics.min_clearance[lane] = min(statistics.min_clearance[lane], least)
            tally.closeness[lane] = closeness if weighs else 0.0


@inner_kernel(inline="code")
def _see_discs(block, setup, teams, clearance, scratch, axes):
    """Discs in the plane, over lanes; what is seen of everything else is nothing after it."""
    n = teams.merged_into.shape[1]
    if len(axes) == 2:
        layout, reach = setup.layout, setup.constants.obstacle_range
        disc, rows = scratch.disc, scratch.rows
        seen = SeenDisc(disc[0], disc[1], disc[2, 0], disc[2, 1])
        for i in range(n):
            for lane in range(block.count):
                active = teams.merged_into[block.first + lane, i] == i
                seen.reach[lane] = reach if active else -np.inf
            seen.nearest[:] = np.inf
            position, frame = teams.positions[block.index, i], teams.frames[block.index, i]
            slot = first_row(setup.constants, rows)
            for m in range(teams.discs.shape[1]):
                _see_disc(layout, position, teams.discs[block.index, m], seen)
                _turn_into(layout, seen.left, frame, rows[i, slot])
                _turn_into(layout, seen.right, frame, rows[i, slot + 1])
                slot += 2
            for lane in range(block.count):
                active = seen.reach[lane] >= 0.0
                clearance[block.first + lane, i] = seen.nearest[lane] if active else np.inf


@inner_kernel(inline="code")
def _see_disc(layout, position, disc, seen):
    """Bearings of the two edges of a disc in the global frame, zero where it is not seen; a radius
    of NaN is no disc.
    """
    if not (
        in_lanes(position, layout)
        and in_lanes(disc, layout)
        and in_lanes(seen.left, layout)
        and in_lanes(seen.right, layout)
    ):
        return
    for lane in range(lane_count(layout.width)):
        x, y, radius = disc[0, lane], disc[1, lane], disc[2, lane]
        x, y = x - position[0, lane], y - position[1, lane]
        ax, ay, bx, by, distance = disc_edges(x, y, radius)
        gap = distance - radius
        near = gap <= seen.reach[lane]
        seen.nearest[lane] = gap if gap < seen.nearest[lane] else seen.nearest[lane]
        seen.left[0, lane] = ax if near else 0.0
        seen.left[1, lane] = ay if near else 0.0
        seen.right[0, lane] = bx if near else 0.0
        seen.right[1, lane] = by if near else 0.0


@inner_kernel(inline="code")
def _turn_into(layout, bearing, frame, row):
    """Write bearings of the plane into a row of observations, in the robots' own frames."""
    if not (in_lanes(bearing, layout) and in_lanes(frame, layout)):
        return
    for lane in range(lane_count(layout.width)):
        local = to_local(read(frame, lane, layout.entries), read(bearing, lane, layout.axes))
        write_row(local, row, lane)


@inner_kernel
def _see_one_by_one(block, setup, state, obstacles, clearance, scratch, axes):
    """Polygons and capsules of the plane, and everything in 3-D."""
    d, team, teams = len(axes), scratch.team, state.teams
    for lane in range(block.count):
        place = Place(block.index, lane, block.first + lane)
        world = obstacles_of(obstacles, place.team)
        if d == 2 and _only_discs(world):
            continue
        load_team(teams.positions, block.index, lane, team.positions)
        if d == 3:
            found = load_links(block.index, lane, state.links, team)
            listed = (team.first[:found], team.second[:found], team.weights[:found])
            _net_bearings(team.positions, listed, arcs_of(state.links, block.index), team.here)
        for i in range(team.lengths.shape[0]):
            _see_all(i, place, setup, teams, world, clearance, scratch, axes)


@inner_kernel(inline="code")
def _see_spheres(block, setup, state, obstacles, clearance, scratch, axes):
    if len(axes) == 3:
        _see_one_by_one(block, setup, state, obstacles, clearance, scratch, axes)


@by_type("obstacles", lambda kind: _see_spheres if kind is RoundObstacles else _see_one_by_one)
def _see_others(block, setup, state, obstacles, clearance, scratch, axes):
    """What is not a disc in the plane; of those alone nothing is compiled here."""


@inner_kernel(inline="code")
def _net_bearings(positions, listed, arcs, out):
    if arcs is not None:
        net_bearings_of_arcs(positions, arcs.weights, out)
    else:
        net_bearings_of_links(positions, listed, out)


@inner_kernel
def _only_discs(world):
    for m in range(world.kinds.shape[0]):
        if world.kinds[m] > BALL:
            return False
    return True


@inner_kernel
def _see_all(i, place, setup, teams, world, clearance, scratch, axes):
    """All obstacles of one robot that ``_see_discs`` leaves out."""
    team, rows, points = place.team, scratch.block.rows, scratch.team.silhouette
    point, active = load(scratch.team.positions[i]), teams.merged_into[place.team, i] == i
    frame = read(teams.frames[place.block, i], place.lane, setup.layout.entries)
    for m in range(world.kinds.shape[0]):
        if len(axes) == 2:
            if world.kinds[m] <= BALL:
                continue
        distance = distance_to(world, m, point) if active else np.inf
        clearance[team, i] = min(clearance[team, i], distance)
        if distance <= setup.constants.obstacle_range:
            if len(axes) == 2:
                silhouette_2d(world, m, point, points)
            else:
                f = load(scratch.team.here[i])
                x, y = local_axis(frame, 0), local_axis(frame, 1)
                silhouette_3d(world, m, point, f, x, y, points)
        else:
            points[:] = 0.0
        first = first_row(setup.constants, rows) + m * points.shape[0]
        for s in range(points.shape[0]):
            bearing = to_local(frame, read_row(points[s], 0, axes))
            write_row(bearing, rows[i, first + s], place.lane)
