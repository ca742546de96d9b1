"""The second stage: carry displacements out, with contacts and merges.

Most teams only add. Those in which something can meet in this step, two neighbours or a robot and
an obstacle, are moved one by one by exact geometry.
"""

from ..compilation import inlined_kernel, inner_kernel, unfolded_kernel
from ..equations.contact import IGNORE, move_curved, move_straight
from ..equations.merging import merge_swept
from ..equations.vectors import load, norm
from .link_kinds import arcs_of
from .links import load_links, store_links
from .memory import (
    ACTIVE,
    FREE,
    LYAPUNOV_BEFORE_MERGE,
    MERGED,
    MOVED,
    PROXIMITY,
    RUNNING,
    SCORED,
    SQUARE_CLOSEST,
    STATUS,
    TOUCHES,
    WAY,
    lane_count,
    read,
)
from .worlds import world_of

_ROUNDING = 1.0 + 1e-9
_CLEARANCE = 1e-9  # m; nearer than this to what it could reach, a robot is moved exactly


@unfolded_kernel
def advance_block(
    block, count, layout, constants, robot, teams, links, obstacles, results, buffers, hand
):
    """Carry out the displacements; teams in which something can meet go one by one."""
    lanes, tally = lane_count(layout.width), buffers.tally
    tally[:] = 0.0
    _mark_near(block, layout, constants, teams, obstacles, buffers)
    for lane in range(count):
        if tally[PROXIMITY * lanes + lane] != FREE:
            if teams.statistics[block, STATUS * lanes + lane] == RUNNING:
                _advance_exactly(
                    block,
                    lane,
                    layout,
                    constants,
                    robot,
                    teams,
                    links,
                    obstacles,
                    results,
                    buffers,
                    hand,
                )
            else:  # nothing meets before an episode's first step or after its last
                tally[PROXIMITY * lanes + lane] = FREE
    for i in range(buffers.action.shape[0]):
        _add_displacements(layout, buffers.displacement[i], tally, teams.positions[block, i])


@unfolded_kernel
def _add_displacements(layout, displacement, tally, positions):
    """Move one robot of every team that is free, and add up the ways."""
    d, lanes = len(layout.axes), lane_count(layout.width)
    for k in range(d):
        for lane in range(lanes):
            # the others stand at their ends already; a choice, not a branch, keeps the loop SIMD
            free = tally[PROXIMITY * lanes + lane] == FREE
            positions[k * lanes + lane] += displacement[k * lanes + lane] if free else 0.0
    for lane in range(lanes):
        tally[WAY * lanes + lane] += displacement[d * lanes + lane]


@inlined_kernel
def _mark_near(block, layout, constants, teams, obstacles, buffers):
    """Mark teams where neighbours start within r + 2 v_max τ, or a robot within v_max τ of an
    obstacle.
    """
    lanes = lane_count(layout.width)
    reach = constants.speed_limit * constants.duration * _ROUNDING
    square_reach = (constants.merge_radius * _ROUNDING + 2.0 * reach) ** 2
    for lane in range(lanes):
        # as of the last observation, which is of the places where this step begins
        square_closest = teams.statistics[block, SQUARE_CLOSEST * lanes + lane]
        buffers.tally[PROXIMITY * lanes + lane] = MOVED if square_closest < square_reach else FREE
    if obstacles is not None:
        if constants.contact_mode != IGNORE:
            for m in range(buffers.balls.shape[0]):
                for i in range(buffers.action.shape[0]):
                    _mark_near_ball(
                        layout, teams.positions[block, i], buffers.balls[m], reach, buffers.tally
                    )


@inlined_kernel
def _mark_near_ball(layout, position, ball, reach, tally):
    """Mark teams in which a robot is within reach of the bounding ball of an obstacle."""
    d, lanes = len(layout.axes), lane_count(layout.width)
    for lane in range(lanes):
        square = 0.0
        for k in range(d):
            offset = ball[k * lanes + lane] - position[k * lanes + lane]
            square += offset * offset
        touch = ball[d * lanes + lane] + reach + _CLEARANCE
        near = PROXIMITY * lanes + lane
        tally[near] = MOVED if square < touch * touch else tally[near]


@inner_kernel
def _advance_exactly(
    block, lane, layout, constants, robot, teams, links, obstacles, results, buffers, hand
):
    """Move one team with swept contacts and merges."""
    lanes, d = lane_count(layout.width), len(layout.axes)
    team = block * lanes + lane
    _load_team(block, lane, layout, teams, buffers, hand)
    if obstacles is not None:
        if constants.contact_mode != IGNORE:
            _stay_outside(
                block, lane, layout, constants, robot, teams, obstacles, results, buffers, hand
            )
    for i in range(hand.lengths.shape[0]):
        # before merging: who is merged away in this step still took part in it, and earns
        buffers.took_part[lane, i] = teams.merged_into[team, i] == i
        for k in range(d):
            # what obstacles left, uncut by merges: it is what the robot model learns of the step
            buffers.displacement[i, k * lanes + lane] = hand.displacements[i, k]
    merges = _merge_team(block, lane, layout, constants, teams, links, obstacles, hand)
    for i in range(hand.lengths.shape[0]):
        buffers.displacement[i, d * lanes + lane] = hand.lengths[i]
        for k in range(d):
            teams.positions[block, i, k * lanes + lane] = hand.positions[i, k]
    if merges > 0:
        teams.statistics[block, ACTIVE * lanes + lane] -= merges
        buffers.tally[PROXIMITY * lanes + lane] = MERGED
        for k in range(4):
            row = SCORED + LYAPUNOV_BEFORE_MERGE + k
            buffers.tally[row * lanes + lane] = hand.report[k]


@unfolded_kernel
def _load_team(block, lane, layout, teams, buffers, hand):
    """Places and proposed displacements of one team into working memory."""
    lanes, d = lane_count(layout.width), len(layout.axes)
    for i in range(hand.lengths.shape[0]):
        hand.lengths[i] = buffers.displacement[i, d * lanes + lane]
        for k in range(d):
            hand.positions[i, k] = teams.positions[block, i, k * lanes + lane]
            hand.displacements[i, k] = buffers.displacement[i, k * lanes + lane]


@inner_kernel
def _merge_team(block, lane, layout, constants, teams, links, obstacles, hand):
    """Move the team at hand and merge whom that brings together; number of merges."""
    team = block * lane_count(layout.width) + lane
    count = load_links(block, lane, links, hand)
    listed = (hand.first[:count], hand.second[:count], hand.weights[:count])
    hand.report[:] = 0.0
    merges = merge_swept(
        hand.positions,
        hand.displacements,
        hand.lengths,
        listed,
        arcs_of(links, block),
        teams.merged_into[team],
        world_of(obstacles, team),
        constants.merge_radius,
        (hand.moments, hand.here, hand.resting),
        hand.report,
    )
    if merges > 0:
        store_links(block, lane, count, links, hand)
    return merges


@inner_kernel
def _stay_outside(block, lane, layout, constants, robot, teams, obstacles, results, buffers, hand):
    """Replace the displacements of the team at hand by those that obstacles leave."""
    lanes, width = lane_count(layout.width), layout.width
    team = block * lanes + lane
    world = world_of(obstacles, team)
    for i in range(hand.lengths.shape[0]):
        if teams.merged_into[team, i] != i:
            continue
        contact, executed = _hindered(
            load(hand.positions[i]),
            load(hand.displacements[i]),
            constants.contact_mode,
            robot,
            read(buffers.action[i], lane, width, robot.inputs),
            read(teams.frames[block, i], lane, width, layout.entries),
            read(teams.memory[block, i], lane, width, robot.memories),
            world,
            hand.normals,
        )
        for k in range(len(layout.axes)):
            hand.displacements[i, k] = executed[k]
        if contact:
            results.contact[team, i] = True
            buffers.tally[TOUCHES * lanes + lane] += 1.0
            hand.lengths[i] = norm(executed)  # of the chord: the way along a surface is not kept


@inner_kernel
def _hindered(point, way, mode, robot, action, frame, memory, world, normals):
    if len(memory) == 0:  # a model that keeps nothing goes straight
        return move_straight(point, way, world, mode, normals)
    return move_curved(point, way, robot.model, action, frame, memory, world, mode, normals)
