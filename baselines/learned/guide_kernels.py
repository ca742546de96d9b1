"""Kernels of the base controller: the rule of merged intervals for a batch of robots.

Most obstacles are out of sight, and most robots have none in their way, in no regular order. So
visible obstacles are listed first, and angles are computed only for robots near one of them.
"""

from typing import Any, NamedTuple

import numpy as np

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.engine.memory import read, write
from rendezvous_env.physics.neighbour_rows import net_bearing_of
from rendezvous_env.physics.vectors import load, load_pair, norm, scaled, split, store, triple
from rendezvous_env.safety.heading import scale_of_step
from rendezvous_env.safety.robot_lanes import LANES, give_out, lanes_of, room_for, sum_rows, take_in

from ..obstacle_rules.merged_silhouettes_2d import (
    comes_near,
    heading_past,
    interval_around,
    least_square_cosine,
)
from ..steering import WITHIN

_NO_SIGNS = 0x7FFFFFFF7FFFFFFF
"""All bits of two float32 but their signs, since zeros have either sign."""


class Rule(NamedTuple):
    """Parameters of the rule of merged intervals for kernels."""

    neighbour_slots: int
    clearance: float  # rad
    persistence: float


def room_for_aim(rows: int, neighbour_slots: int) -> Any:
    """Working memory of ``aim``: as ``room_for``, lists of obstacles and robots, and intervals."""
    obstacles = (rows - neighbour_slots) // 2
    listed = np.empty((2, LANES * obstacles + 1), np.int64), np.empty((2, LANES + 1), np.int64)
    return room_for(0, 2)[0], listed, np.empty((obstacles, 2))


@kernel
def aim(axes, robots, rule, arrays, work):
    """Directions of the rule for f rotated by pairs (N, 2), to raw (N, 2).

    ``arrays`` are observations, their pairs of float32 as int64, rotations (cos φ, sin φ), carried
    headings, and raw, which may be the headings.
    """
    observations, bits, rotations, headings, raw = arrays
    numbers, listed, intervals = work
    if numbers.shape[1] != LANES:  # it is; so the compiler knows how far apart rows are
        return
    lanes, K = lanes_of(numbers), rule.neighbour_slots
    how, least = (rule.clearance, rule.persistence), least_square_cosine(rule.clearance)
    always_near = 1.0 if rule.clearance >= 0.5 * np.pi else 0.0
    for first in range(robots[0], robots[1], LANES):
        stop = min(first + LANES, robots[1])
        rows = observations[first:stop]
        sum_rows(axes, rows, K, lanes.f)
        take_in(axes, rotations, first, stop, lanes.choice)
        for lane in range(LANES):
            f, (c, s) = read(lanes.f, lane, axes), read(lanes.choice, lane, axes)
            length, aside = split((c * f[0] - s * f[1], s * f[0] + c * f[1]))
            towards = aside[0] if length > 0.0 else 1.0, aside[1] if length > 0.0 else 0.0
            write(towards, lanes.heading, lane)
            lanes.accepted[lane] = always_near
        count = _list_visible(bits[first:stop], K, intervals.shape[0], listed)
        for k in range(count):
            lane, row = listed[0][0, k], listed[0][1, k]
            last, clockwise = load_pair(rows[lane, row]), load_pair(rows[lane, row + 1])
            near = comes_near(read(lanes.heading, lane, axes), last, clockwise, least)
            lanes.accepted[lane] = max(lanes.accepted[lane], 1.0 if near else 0.0)
        for k in range(_list_nonzero(lanes.accepted, len(rows), listed[1][1])):
            lane = listed[1][1, k]
            towards, seen = triple(read(lanes.heading, lane, axes)), 0
            for found in range(listed[1][0, lane], listed[1][0, lane + 1]):
                row = listed[0][1, found]
                interval_around(towards, rows[lane, row : row + 2], intervals[seen])
                seen += 1
            carried = load(headings[first + lane])
            write(heading_past(towards, intervals[:seen], carried, how), lanes.heading, lane)
        give_out(axes, lanes.heading, first, stop, raw)


@inner_kernel
def _list_visible(bits, neighbour_slots, obstacles, listed):
    """List visible obstacles of robots, rows as int64 (N, rows, 1); returns their number.

    The list holds robots and first rows, in order; ``listed[1][0]`` is where each robot's begin.
    """
    (found, _), count = listed, 0
    for lane in range(len(bits)):
        listed[1][0, lane] = count
        for m in range(obstacles):
            row = neighbour_slots + 2 * m
            found[0, count], found[1, count] = lane, row
            count += (bits[lane, row, 0] & _NO_SIGNS) != 0
    listed[1][0, len(bits)] = count
    return count


@inner_kernel
def _list_nonzero(values, stop, listed):
    """List the indices before ``stop`` of nonzero numbers; returns how many there are."""
    count = 0
    for k in range(stop):
        listed[count] = k
        count += values[k] != 0.0
    return count


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
