"""Stages of environments with moving obstacles: their motion, contacts, and merges beside them."""

import numpy as np

from ...compilation import inner_kernel, kernel
from ...obstacles.contact import IGNORE
from ...obstacles.shape import MIDDLE
from ...physics.random_streams import TRAFFIC, stream_key
from ...physics.vectors import add, load, store
from ...robots.motion import constants_of_robot
from ...traffic.contact import meets_traffic, move_among, move_past_still
from ...traffic.motion import SHARE, execute_plan, plan_motion
from ..memory import (
    FREE,
    MERGED,
    PROXIMITY,
    RUNNING,
    STATUS,
    load_fields,
    load_point,
    obstacles_of,
)
from .collide import execute_motion

_SAME_TIME = 1e-12  # of the step


@kernel
def move_obstacles(
    robot,
    lanes,
    first,
    last,
    mode,
    pushes,
    lengths,
    robots,
    merged_into,
    environments,
    moves,
    traffic,
    states,
    seeds,
    episodes,
    obstacles,
    discs,
    arrivals,
    work,
    contact,
):
    """Move the obstacles of running environments, and replace displacements of robots.

    ``lengths`` are the time step, s, and the merge radius, m. ``states`` are (B, M, STATE), see
    ``traffic.motion``. ``arrivals``, (B, n, 3), receives the final positions of robots
    that an obstacle might reach, else NaN. Working memory ``work``: plans (M, 4), normals (2M, 3),
    levels (2M,), halts (2, M) bool, executed (n, 3), met (2, n) bool.
    """
    d, plans = len(robot.axes), work[0]
    for block in range(first, last):
        environment, move = environments[block], moves[block - first]
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            if environment[STATUS * lanes + lane] != RUNNING:
                continue
            b = block * lanes + lane
            world = obstacles_of(obstacles, b)
            key = stream_key(seeds[b], episodes[b], TRAFFIC)
            plan_motion(traffic, states[b], lengths[0], key, d, plans)
            arrivals[b] = np.nan
            if mode != IGNORE and environment[PROXIMITY * lanes + lane] != FREE:
                _move_robots(
                    robot, lanes, lane, (mode, pushes, d), lengths, robots[block], merged_into[b],
                    environment, move, world, arrivals[b], work, contact[b],
                )  # fmt: skip
            execute_plan(traffic, states[b], plans, lengths[0], world)
            for m in range(discs.shape[1]):
                for k in range(2):
                    discs[block, m, k * lanes + lane] = world.shapes[m, MIDDLE + k]


@kernel
def _move_robots(
    robot,
    lanes,
    lane,
    settings,
    lengths,
    robots,
    merged_into,
    environment,
    move,
    world,
    arrivals,
    work,
    contact,
):
    """Displacements of the robots and obstacles of one environment."""
    plans, normals, _, _, executed, flags = work
    d, n = len(robot.axes), robots.shape[0]
    for i in range(n):
        point = load_point(robots[i], 0, lane, lanes, d)
        reach = constants_of_robot(robot.model, robot.limits, i).speed_limit * lengths[0]
        flags[0, i] = merged_into[i] == i and meets_traffic(point, reach + lengths[1], world, plans)
    settled = _settle(robot, lanes, lane, settings, lengths, robots, move, world, work)
    for i in range(n):
        if merged_into[i] == i:
            point = load_point(robots[i], 0, lane, lanes, d)
            if flags[0, i] and settled:
                met, way = flags[1, i], load(executed[i])
            else:
                way = load_point(move[i], 0, lane, lanes, d)
                path = _path_of(robot, robot.memories, i, lane, lanes, robots[i], move[i], way)
                met, way = move_past_still(point, path, way, world, settings[0], normals)
            execute_motion(met, way, i, lane, lanes, d, move[i], environment, contact)
            if flags[0, i]:
                store(add(point, 1.0, way), arrivals[i])


@inner_kernel
def _settle(robot, lanes, lane, settings, lengths, robots, move, world, work):
    """Find the times at which robots block obstacles, the earliest first.

    Returns False if that fails; no obstacle moves then.
    """
    plans, _, _, halts, _, flags = work
    for _ in range(len(plans) + 2):
        earliest = np.inf
        for i in range(robots.shape[0]):
            if flags[0, i]:
                moment = _try(robot, lanes, lane, i, settings, lengths, robots, move, world, work)
                if moment < earliest:
                    earliest = moment
                    for m in range(halts.shape[1]):
                        halts[1, m] = halts[0, m]
        if earliest == np.inf:
            return True
        if not _hold_up(plans, halts[1], earliest):
            break
    plans[:, SHARE] = 0.0
    return False


@inner_kernel
def _try(robot, lanes, lane, i, settings, lengths, robots, move, world, work):
    """Displacement and contact of one robot; returns when it blocks obstacles, or inf."""
    plans, normals, levels, halts, executed, flags = work
    d = settings[2]
    point = load_point(robots[i], 0, lane, lanes, d)
    way = load_point(move[i], 0, lane, lanes, d)
    path = _path_of(robot, robot.memories, i, lane, lanes, robots[i], move[i], way)
    duration = 1.0 if len(robot.memories) == 0 else lengths[0]
    memory = normals, levels, halts[0]
    met, executed_way, moment = move_among(
        point, path, way, duration, world, plans, settings, memory
    )
    store(executed_way, executed[i])
    flags[1, i] = met
    return moment


@inner_kernel
def _path_of(robot, memories, i, lane, lanes, state, move, way):
    """Straight displacement of a robot, a triple, or its curve."""
    d = len(robot.axes)
    if len(memories) == 0:
        return way
    return (
        constants_of_robot(robot.model, robot.limits, i),
        load_fields(move, d + 1, lane, lanes, robot.inputs),
        load_fields(state, d, lane, lanes, robot.entries),
        load_fields(state, d + d * d, lane, lanes, memories),
    )


@inner_kernel
def _hold_up(plans, halts, time):
    """Stop the marked obstacles at a time of the step; returns whether any moved longer."""
    later = False
    for m in range(len(halts)):
        if halts[m] and plans[m, SHARE] > time + _SAME_TIME:
            plans[m, SHARE] = time
            later = True
    return later


@kernel
def settle_merged(lanes, d, first, last, robots, merged_into, environments, took_part, arrivals):
    """Give robots that merged beside moving obstacles the lower one's position after the step.

    An obstacle might otherwise pass through the place of the merge in the rest of the step.
    """
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            if environments[block, PROXIMITY * lanes + lane] != MERGED:
                continue
            b = block * lanes + lane
            for j in range(merged_into.shape[1]):
                i = merged_into[b, j]
                if took_part[b, j] and i != j and arrivals[b, i, 0] == arrivals[b, i, 0]:
                    for k in range(d):
                        robots[block, i, k * lanes + lane] = arrivals[b, i, k]
