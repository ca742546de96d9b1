"""Kernels of the base controller: the rule of merged intervals for a batch of robots.

Most obstacles are not visible and most robots are not blocked, in no regular order. The visible
obstacles of LANES robots are therefore listed without a branch, and their angles are SIMD over the
list. Only robots near an obstacle merge intervals.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.engine.memory import read, write
from rendezvous_env.physics.neighbour_rows import net_bearing_of
from rendezvous_env.physics.trigonometry import arctangent, cos_sin
from rendezvous_env.physics.vectors import (
    combine,
    cross_in_plane,
    dot,
    load,
    load_pair,
    norm,
    perpendicular,
    scaled,
    split,
    store,
)
from rendezvous_env.safety.heading import scale_of_step
from rendezvous_env.safety.robot_lanes import LANES, give_out, lanes_of, room_for, sum_rows, take_in

from ..obstacle_rules.merged_intervals_2d import (
    comes_near,
    least_square_cosine,
    turn_past,
    width_of,
)
from ..obstacle_rules.obstacle_edges import NO_SIGNS
from ..steering import WITHIN

_BESIDE = min(16, LANES)
"""Obstacles processed at a time; loops over 8 are unrolled before they become SIMD."""


class Rule(NamedTuple):
    """Parameters of the rule of merged intervals for kernels."""

    neighbour_slots: int
    clearance: float  # rad
    persistence: float


class AimRoom(NamedTuple):
    """Working memory of ``aim`` for LANES robots and ``size`` visible obstacles."""

    numbers: Any  # as of ``room_for``
    listed: Any  # (size,), first rows of visible obstacles, of all rows of the robots
    owners: Any  # (size,), their robots
    stops: Any  # (LANES,), where the obstacles of each robot end in the list
    views: Any  # (6, size): x, y of an obstacle's edges and of its robot's direction
    angles: Any  # (2 size,), intervals, rad
    is_near: Any  # (size,), whether the obstacle is near the direction
    blocked: Any  # (LANES,), whether any of a robot's obstacles is
    turns: Any  # (LANES,), rad


def room_for_aim(rows: int, neighbour_slots: int) -> AimRoom:
    """Working memory of ``aim`` for observations with this number of rows."""
    size = LANES * ((rows - neighbour_slots) // 2 + 1)
    lists = np.zeros(size, np.int64), np.zeros(size, np.int64), np.zeros(LANES, np.int64)
    views, angles = np.zeros((6, size)), np.zeros(2 * size)
    near = np.zeros(size, np.bool_), np.zeros(LANES, np.bool_)
    return AimRoom(room_for(0, 2)[0], *lists, views, angles, *near, np.zeros(LANES))


@kernel(unroll=False)
def aim(axes, robots, rule, arrays, work):
    """Directions of the rule for f rotated by pairs (N, 2), to raw (N, 2).

    ``arrays`` are observations, their pairs of float32 as int64, rotations (cos φ, sin φ), carried
    headings, and raw, which may be the headings.
    """
    observations, bits, rotations, headings, raw = arrays
    if work.numbers.shape[1] != LANES:  # always true; tells the compiler the row stride
        return
    lanes = lanes_of(work.numbers)
    for first in range(robots[0], robots[1], LANES):
        stop = min(first + LANES, robots[1])
        rows = observations[first:stop]
        sum_rows(axes, rows, rule.neighbour_slots, lanes.f)
        take_in(axes, rotations, first, stop, lanes.choice)
        for lane in range(LANES):
            f, (c, s) = read(lanes.f, lane, axes), read(lanes.choice, lane, axes)
            length, aside = split((c * f[0] - s * f[1], s * f[0] + c * f[1]))
            towards = aside[0] if length > 0.0 else 1.0, aside[1] if length > 0.0 else 0.0
            write(towards, lanes.heading, lane)
        count = _list_obstacles(bits[first:stop], rule.neighbour_slots, work)
        if count > 0:
            _see_obstacles(rule.clearance, rows, lanes.heading, count, work)
            _turn_past(axes, rule, headings[first:stop], lanes.heading, work)
        give_out(axes, lanes.heading, first, stop, raw)


@inner_kernel
def _list_obstacles(bits, neighbour_slots, work):
    """List the visible obstacles of robots (N, rows, 1), without a branch; returns their number.

    As ``list_seen``, in one loop over all rows; a call of it per robot is slower.
    """
    stride, pairs, count = bits.shape[1], bits.reshape(-1), 0
    for lane in range(len(bits)):
        for row in range(lane * stride + neighbour_slots, (lane + 1) * stride - 1, 2):
            place = np.uint64(count)
            work.listed[place], work.owners[place] = row, lane
            count += (pairs[np.uint64(row)] & NO_SIGNS) != 0
        work.stops[lane] = count
    return count


@inner_kernel
def _see_obstacles(clearance, rows, directions, count, work):
    """Intervals of listed obstacles around directions (3, LANES), and robots near any."""
    edges, least = rows.reshape(-1), least_square_cosine(clearance)
    for k in range(count):
        lane, first = work.owners[k], 2 * work.listed[k]
        for part in range(4):
            work.views[part, k] = edges[first + part]
        work.views[4, k], work.views[5, k] = directions[0, lane], directions[1, lane]
    for start in range(0, count, _BESIDE):
        _see_lanes(start, least, work)
    work.blocked[:] = clearance >= 0.5 * math.pi
    for k in range(count):
        work.blocked[work.owners[k]] |= work.is_near[k]


@inner_kernel(inline="code")
def _see_lanes(start, least, work):
    """Intervals as of ``interval_around``, and ``comes_near``, of obstacles from one on."""
    views, stop = work.views, start + _BESIDE
    last_x, last_y = views[0, start:stop], views[1, start:stop]
    first_x, first_y = views[2, start:stop], views[3, start:stop]
    u_x, u_y = views[4, start:stop], views[5, start:stop]
    is_near, angles = work.is_near[start:stop], work.angles[2 * start : 2 * stop]
    for k in range(_BESIDE):
        last, clockwise = (last_x[k], last_y[k]), (first_x[k], first_y[k])
        is_near[k] = comes_near((u_x[k], u_y[k]), last, clockwise, least)
    for k in range(_BESIDE):
        last, clockwise = (last_x[k], last_y[k]), (first_x[k], first_y[k])
        angles[2 * k] = _angle_between((u_x[k], u_y[k]), clockwise)
        angles[2 * k + 1] = width_of(_angle_between(clockwise, last))


@inner_kernel(inline="code")
def _angle_between(one, other):
    """Angle from one pair counter-clockwise to another, rad in [−π, π]."""
    return arctangent(cross_in_plane(one, other), dot(one, other))


@inner_kernel
def _turn_past(axes, rule, carried, directions, work):
    """Turn directions (3, LANES) of the robots near obstacles past these."""
    intervals, start, how = work.angles.reshape(-1, 2), 0, (rule.clearance, rule.persistence)
    work.turns[:] = 0.0
    for lane in range(len(carried)):
        stop = work.stops[lane]
        if work.blocked[lane]:
            towards, kept = read(directions, lane, axes), load_pair(carried[lane])
            work.turns[lane] = turn_past(towards, intervals[start:stop], kept, how)
        start = stop
    for lane in range(LANES):
        (c, s), towards = cos_sin(work.turns[lane]), read(directions, lane, axes)
        write(combine(c, towards, s, perpendicular(towards)), directions, lane)


@kernel
def unit_vectors(given, out, otherwise):
    """Write vectors (B, n, 2) of any length as unit vectors; ``otherwise`` for zero vectors.

    Returns False at a number that is not finite.
    """
    for team in range(len(given)):
        for i in range(given.shape[1]):
            x, y = given[team, i, 0], given[team, i, 1]
            if not (abs(x) < math.inf and abs(y) < math.inf):
                return False
            length = math.sqrt(x * x + y * y)
            along = length > 0.0
            out[team, i, 0] = x / length if along else otherwise[0]
            out[team, i, 1] = y / length if along else otherwise[1]
    return True


@kernel
def desired_velocities(teams, observations, robot, headings, held):
    """Desired velocities of a HeadingTankFilter, in units of v_max, along headings (B, n, d)."""
    K = robot.neighbour_slots
    for team in range(teams[0], teams[1]):
        for i in range(observations.shape[1]):
            rows = observations[team, i]
            degree, strength = 0.0, norm(net_bearing_of(rows, K))
            for k in range(K):  # each length in float32, as ``ObservationLayout.degree`` has it
                degree += np.float64(np.sqrt(rows[k, 0] * rows[k, 0] + rows[k, 1] * rows[k, 1]))
            law_speed = scale_of_step(degree, robot.merge_radius, robot.gate.duration) * strength
            share = WITHIN * min(law_speed / robot.speed_limit, 1.0)
            store(scaled(load(headings[team, i]), share), held[team, i])
