"""Second stage, for environments with possible contact: contacts, then merges or packing.

One environment at a time, by exact geometry, with one compiled form each.
"""

import math

from ...compilation import inner_kernel, kernel
from ...graphs.edges import arcs_of, load_links, store_links
from ...graphs.merging import merge_swept
from ...obstacles.contact import move_curved, move_straight, work_of
from ...obstacles.spatial_index import obstacles_within, table_of
from ...physics.packing import is_packed, move_apart
from ...physics.vectors import norm
from ...robots.motion import constants_of_robot
from ..memory import (
    ACTIVE,
    AFTER_MERGE,
    BEFORE_MERGE,
    FREE,
    MERGE_EXCESS,
    MERGE_RISE,
    MERGED,
    PACKED,
    PROXIMITY,
    STEP_CONTACTS,
    STEP_LENGTH,
    load_fields,
    load_point,
    load_positions,
    obstacles_of,
    store_positions,
)

_ROUNDING = 1.0 + 1e-9
# of the length of a path: distance of obstacles that a motion and its legs can come near to
_LEGS_OF_LINE, _LEGS_OF_CURVE = 2.0, 4.0
_MARGIN = 1e-3  # m, more than all pushes out of obstacles together
_NEAREST = 3e-6  # m, more than a skin; margin of reachable distances for exact motion


@kernel(unroll=False)
def stop_at_obstacles(
    lanes,
    d,
    first,
    last,
    mode,
    robots,
    merged_into,
    environments,
    moves,
    obstacles,
    index,
    near,
    listed,
    normals,
    contact,
):
    """Replace straight displacements by those that obstacles allow.

    ``index``, of the tables of obstacles, may be None. Working memory: normals (2M, 3), and with an
    index near and listed, see ``spatial_index.obstacles_within``.
    """
    n = robots.shape[1]
    for block in range(first, last):
        for lane in range(_lanes_near(block, lanes, len(merged_into), environments[block])):
            if environments[block, PROXIMITY * lanes + lane] == FREE:
                continue
            b = block * lanes + lane
            table = table_of(index, b)
            world = obstacles_of(obstacles, table)
            for i in range(n):
                if merged_into[b, i] == i:
                    point = load_point(robots[block, i], 0, lane, lanes, d)
                    way = load_point(moves[block - first, i], 0, lane, lanes, d)
                    reach = _LEGS_OF_LINE * norm(way) + _MARGIN
                    here = obstacles_within(world, index, table, point, reach, near, listed)
                    met, executed = move_straight(point, way, here, mode, normals)
                    move, environment = moves[block - first, i], environments[block]
                    execute_motion(met, executed, i, lane, lanes, d, move, environment, contact[b])


@kernel(unroll=False)
def stop_curves_at_obstacles(
    robot,
    lanes,
    first,
    last,
    mode,
    robots,
    merged_into,
    environments,
    moves,
    obstacles,
    index,
    near,
    listed,
    normals,
    contact,
):
    """Replace curved displacements of robot models by those that obstacles allow."""
    n, d = robots.shape[1], len(robot.axes)
    reach = _LEGS_OF_CURVE * robot.model.speed_limit * robot.model.duration + _MARGIN
    for block in range(first, last):
        for lane in range(_lanes_near(block, lanes, len(merged_into), environments[block])):
            if environments[block, PROXIMITY * lanes + lane] == FREE:
                continue
            b = block * lanes + lane
            table = table_of(index, b)
            world = obstacles_of(obstacles, table)
            work = work_of(world)
            for i in range(n):
                if merged_into[b, i] == i:
                    state, move = robots[block, i], moves[block - first, i]
                    point = load_point(state, 0, lane, lanes, d)
                    here = obstacles_within(world, index, table, point, reach, near, listed)
                    met, executed = move_curved(
                        point,
                        load_point(move, 0, lane, lanes, d),
                        constants_of_robot(robot.model, robot.limits, i),
                        load_fields(move, d + 1, lane, lanes, robot.inputs),
                        load_fields(state, d, lane, lanes, robot.entries),
                        load_fields(state, d + d * d, lane, lanes, robot.memories),
                        here,
                        mode,
                        normals,
                        work,
                    )
                    environment = environments[block]
                    execute_motion(met, executed, i, lane, lanes, d, move, environment, contact[b])


@inner_kernel
def _lanes_near(block, lanes, batch, environment):
    """Lanes of a block to process individually: all, or none without possible contact."""
    near = 0.0
    for lane in range(lanes):
        near += environment[PROXIMITY * lanes + lane]
    return min(lanes, batch - block * lanes) if near > 0.0 else 0


@inner_kernel
def execute_motion(met, executed, i, lane, lanes, d, move, environment, contact):
    """Write the displacement of robot i, a triple; after a contact its length, and the contact.

    The length is that of the chord, since the path along a surface is not stored.
    """
    for k in range(d):
        move[k * lanes + lane] = executed[k]
    if met:
        move[d * lanes + lane] = norm(executed)
        contact[i] = True
        environment[STEP_CONTACTS * lanes + lane] += 1.0


@inner_kernel
def _store_lengths(lengths, lane, lanes, d, move, environment):
    """Store the path lengths of one environment, (n,), and their sum."""
    total = 0.0
    for i in range(len(lengths)):
        move[i, d * lanes + lane] = lengths[i]
        total += lengths[i]
    environment[STEP_LENGTH * lanes + lane] = total


@kernel(unroll=False)
def merge_robots(
    lanes,
    first,
    last,
    radius,
    merges_through,
    robots,
    merged_into,
    environments,
    moves,
    links,
    obstacles,
    took_part,
    vectors,
    numbers,
    listed,
    resting,
):
    """Apply the displacements, and merge robots within the merge radius, m.

    With ``merges_through`` they also merge through obstacles. ``took_part``, (B, n), receives the
    robots that were active before the step: those that merge in it still receive its reward.
    Working memory: vectors (3, n, d), numbers (4 + n, max(n, E)), listed (2, max(n, E)), and
    resting (n,).
    """
    n, d = robots.shape[1], vectors.shape[2]
    positions, displacements, here = vectors[0], vectors[1], vectors[2]
    weights, moments, lengths, report = numbers[0], numbers[1], numbers[2, :n], numbers[3]
    for block in range(first, last):
        environment, move = environments[block], moves[block - first]
        for lane in range(_lanes_near(block, lanes, len(merged_into), environment)):
            if environment[PROXIMITY * lanes + lane] == FREE:
                continue
            b = block * lanes + lane
            load_positions(robots[block], lane, lanes, positions)
            load_positions(move, lane, lanes, displacements)
            for i in range(n):
                lengths[i] = move[i, d * lanes + lane]
                took_part[b, i] = merged_into[b, i] == i
            count = load_links(links, block, lane, n, listed[0], listed[1], weights)
            report[:4] = 0.0
            merges = merge_swept(
                positions,
                displacements,
                lengths,
                (listed[0, :count], listed[1, :count], weights[:count]),
                arcs_of(links, block, n),
                merged_into[b],
                obstacles_of(obstacles, b),
                radius,
                (moments, here, resting, report),
                merges_through,
            )
            _store_lengths(lengths, lane, lanes, d, move, environment)
            store_positions(positions, robots[block], lane, lanes)
            if merges > 0:
                store_links(links, block, lane, n, listed[0], listed[1], weights, count)
                environment[ACTIVE * lanes + lane] -= merges
                environment[PROXIMITY * lanes + lane] = MERGED
                environment[BEFORE_MERGE * lanes + lane] = report[0]
                environment[AFTER_MERGE * lanes + lane] = report[1]
                environment[MERGE_RISE * lanes + lane] = report[2]
                environment[MERGE_EXCESS * lanes + lane] = report[3]


@kernel
def pack_robots(
    lanes,
    first,
    last,
    sizes,
    robots,
    merged_into,
    environments,
    moves,
    vectors,
    numbers,
    listed,
    resting,
):
    """Apply the displacements as discs that do not overlap.

    ``sizes`` are the body diameter and the distance at which two bodies are in contact, m. Working
    memory as ``merge_robots``.
    """
    n, d = robots.shape[1], vectors.shape[2]
    positions, displacements, lengths = vectors[0], vectors[1], numbers[2, :n]
    for block in range(first, last):
        environment, move = environments[block], moves[block - first]
        for lane in range(_lanes_near(block, lanes, len(merged_into), environment)):
            if environment[PROXIMITY * lanes + lane] == FREE:
                continue
            load_positions(robots[block], lane, lanes, positions)
            load_positions(move, lane, lanes, displacements)
            for i in range(n):
                lengths[i] = move[i, d * lanes + lane]
            move_apart(positions, displacements, lengths, sizes[0], (vectors[2], numbers[1]))
            if is_packed(positions, sizes[1], (listed[0], resting)):
                environment[PROXIMITY * lanes + lane] = PACKED
            _store_lengths(lengths, lane, lanes, d, move, environment)
            store_positions(positions, robots[block], lane, lanes)


def reaches(rules, has_contacts):
    """Square distance of neighbours, m², and clearance, m, below which contact is possible.

    In a step, distances decrease by at most 2 v_max τ, clearances by v_max τ and the motion of
    obstacles. ``rules`` are the ``Constants``.
    """
    reach = rules.speed_limit * rules.duration * _ROUNDING
    square = (rules.merge_radius * _ROUNDING + 2.0 * reach) ** 2
    # bodies touch whether or not they are neighbours
    clearance = reach + rules.obstacle_reach + _NEAREST
    return math.inf if rules.packs else square, clearance if has_contacts else -math.inf
