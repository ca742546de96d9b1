"""The second stage: carry displacements out, with contacts and merges, or bodies that touch.

Most teams only add. Those in which something can meet in this step, two neighbours or a robot and
an obstacle, are moved one by one by exact geometry.
"""

import math

from ...compilation import inner_kernel
from ...graphs.edges import arcs_of, load_links, store_links
from ...graphs.merging import merge_swept
from ...obstacles.contact import IGNORE, move_curved, move_straight
from ...physics.packing import is_packed, move_apart
from ...physics.vectors import load, norm
from ..memory import (
    FREE,
    MERGED,
    MOVED,
    PACKED,
    RUNNING,
    Place,
    lane_count,
    load_team,
    obstacles_of,
    read,
    statistics_of,
    store_team,
    tally_of,
)

_ROUNDING = 1.0 + 1e-9
_CLEARANCE = 3e-6  # m, more than a skin; nearer to what it could reach, a robot is moved exactly


@inner_kernel(inline="text")
def advance_block(block, setup, state, output, scratch):
    """Carry out the displacements; teams in which something can meet go one by one."""
    teams, lanes = state.teams, scratch.block
    tally, statistics = tally_of(lanes.tally), statistics_of(teams, block.index)
    lanes.tally[:] = 0.0
    _mark_near(block, setup, teams, state.obstacles, lanes)
    for lane in range(block.count):
        if tally.proximity[lane] != FREE:
            if statistics.status[lane] == RUNNING:
                place = Place(block.index, lane, block.first + lane)
                _advance_exactly(place, setup, state, output.contact, scratch)
            else:  # nothing meets before an episode's first step or after its last
                tally.proximity[lane] = FREE
    for i in range(lanes.action.shape[0]):
        displacement, position = lanes.displacement[i], teams.positions[block.index, i]
        for k in range(len(setup.layout.axes)):
            for lane in range(lane_count(setup.layout.width)):
                # the others stand at their ends already; a choice, not a branch, keeps it SIMD
                free = tally.proximity[lane] == FREE
                position[k, lane] += displacement[k, lane] if free else 0.0
        for lane in range(lane_count(setup.layout.width)):
            tally.way[lane] += displacement[len(setup.layout.axes), lane]


@inner_kernel(inline="code")
def _mark_near(block, setup, teams, obstacles, lanes):
    """Mark teams where neighbours start within r + 2 v_max τ, or a robot within v_max τ of an
    obstacle.
    """
    constants, tally = setup.constants, tally_of(lanes.tally)
    # as of the last observation, which is of the places where this step begins
    statistics = statistics_of(teams, block.index)
    reach = constants.speed_limit * constants.duration * _ROUNDING
    square_reach = (constants.merge_radius * _ROUNDING + 2.0 * reach) ** 2
    if constants.packs:  # bodies touch whether or not they are neighbours
        square_reach = math.inf
    for lane in range(lane_count(setup.layout.width)):
        near = statistics.square_closest[lane] < square_reach
        tally.proximity[lane] = MOVED if near else FREE
    if obstacles is not None:
        if constants.contact_mode != IGNORE:
            for lane in range(lane_count(setup.layout.width)):
                near = statistics.clearance[lane] < reach + _CLEARANCE
                tally.proximity[lane] = MOVED if near else tally.proximity[lane]


@inner_kernel
def _advance_exactly(place, setup, state, contact, scratch):
    """Move one team with swept contacts and merges."""
    d, lane, team, lanes = len(setup.layout.axes), place.lane, scratch.team, scratch.block
    teams, tally = state.teams, tally_of(lanes.tally)
    load_team(teams.positions, place.block, lane, team.positions)
    for i in range(team.lengths.shape[0]):
        team.lengths[i] = lanes.displacement[i, d, lane]
        for k in range(d):
            team.displacements[i, k] = lanes.displacement[i, k, lane]
    _stay_outside(place, setup, teams, state.obstacles, contact, scratch)
    for i in range(team.lengths.shape[0]):
        # before merging: who is merged away in this step still took part in it, and earns
        lanes.took_part[lane, i] = teams.merged_into[place.team, i] == i
        for k in range(d):
            # what obstacles left, uncut by merges: it is what the robot model learns of the step
            lanes.displacement[i, k, lane] = team.displacements[i, k]
    merges = 0
    if not setup.constants.packs:
        merges = _merge_team(place, setup.constants, state, team)
    elif _pack_team(setup.constants, team):
        tally.proximity[lane] = PACKED
    for i in range(team.lengths.shape[0]):
        lanes.displacement[i, d, lane] = team.lengths[i]
    store_team(team.positions, teams.positions, place.block, lane)
    if merges > 0:
        statistics_of(teams, place.block).active[lane] -= merges
        tally.proximity[lane] = MERGED
        tally.lyapunov_before_merge[lane] = team.report[0]
        tally.lyapunov_after_merge[lane] = team.report[1]
        tally.merge_rise[lane] = team.report[2]
        tally.merge_excess[lane] = team.report[3]


@inner_kernel
def _stay_outside(place, setup, teams, obstacles, contact, scratch):
    """Replace the displacements of the team at hand by those that obstacles leave."""
    if obstacles is not None:
        mode, layout, robot = setup.constants.contact_mode, setup.layout, setup.robot
        if mode != IGNORE:
            team, world = scratch.team, obstacles_of(obstacles, place.team)
            for i in range(team.lengths.shape[0]):
                if teams.merged_into[place.team, i] != i:
                    continue
                curve = (
                    robot.model,
                    read(scratch.block.action[i], place.lane, robot.inputs),
                    read(teams.frames[place.block, i], place.lane, layout.entries),
                    read(teams.memory[place.block, i], place.lane, robot.memories),
                )
                point, way = load(team.positions[i]), load(team.displacements[i])
                met, executed = _move_among(point, way, curve, curve[3], world, mode, team.normals)
                for k in range(len(layout.axes)):
                    team.displacements[i, k] = executed[k]
                if met:
                    contact[place.team, i] = True
                    tally_of(scratch.block.tally).contacts[place.lane] += 1.0
                    # of the chord: the way along a surface is not kept
                    team.lengths[i] = norm(executed)


@inner_kernel
def _move_among(point, way, curve, memory, world, mode, normals):
    if len(memory) == 0:  # a model that keeps nothing goes straight
        return move_straight(point, way, world, mode, normals)
    model, action, frame, _ = curve
    return move_curved(point, way, model, action, frame, memory, world, mode, normals)


@inner_kernel(inline="text")
def _merge_team(place, constants, state, team):
    """Move the team at hand and merge whom that brings together; number of merges."""
    count = load_links(place.block, place.lane, state.links, team)
    team.report[:] = 0.0
    merges = merge_swept(
        team.positions,
        team.displacements,
        team.lengths,
        (team.first[:count], team.second[:count], team.weights[:count]),
        arcs_of(state.links, place.block),
        state.teams.merged_into[place.team],
        obstacles_of(state.obstacles, place.team),
        constants.merge_radius,
        (team.moments, team.here, team.resting, team.report),
        constants.merges_through,
    )
    if merges > 0:
        store_links(place.block, place.lane, count, state.links, team)
    return merges


@inner_kernel
def _pack_team(constants, team):
    """Move the team at hand as discs that do not overlap; whether all are one packed cluster."""
    work, size = (team.here, team.moments), 2.0 * constants.body_radius
    move_apart(team.positions, team.displacements, team.lengths, size, work)
    return is_packed(team.positions, constants.merge_radius, (team.counts, team.resting))
