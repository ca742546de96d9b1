"""Kernels of the base controller: the rule of merged intervals for a batch of robots.

Most obstacles are not visible and most robots are not blocked, in no regular order. Visible
obstacles are therefore listed without a branch, and angles are computed only for robots near one.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from rendezvous_env.compilation import kernel
from rendezvous_env.engine.memory import read, write
from rendezvous_env.physics.neighbour_rows import net_bearing_of
from rendezvous_env.physics.vectors import load, load_pair, norm, scaled, split, store, triple
from rendezvous_env.safety.heading import scale_of_step
from rendezvous_env.safety.robot_lanes import LANES, give_out, lanes_of, room_for, sum_rows, take_in

from ..obstacle_rules.merged_intervals_2d import (
    comes_near,
    heading_past,
    interval_around,
    least_square_cosine,
)
from ..obstacle_rules.obstacle_edges import list_seen
from ..steering import WITHIN


class Rule(NamedTuple):
    """Parameters of the rule of merged intervals for kernels."""

    neighbour_slots: int
    clearance: float  # rad
    persistence: float


def room_for_aim(rows: int, neighbour_slots: int) -> Any:
    """Working memory of ``aim``: as ``room_for``, and rows and intervals of visible obstacles."""
    obstacles = (rows - neighbour_slots) // 2
    return room_for(0, 2)[0], np.empty(obstacles + 1, np.int64), np.empty((obstacles, 2))


@kernel(unroll=False)
def aim(axes, robots, rule, arrays, work):
    """Directions of the rule for f rotated by pairs (N, 2), to raw (N, 2).

    ``arrays`` are observations, their pairs of float32 as int64, rotations (cos φ, sin φ), carried
    headings, and raw, which may be the headings.
    """
    observations, bits, rotations, headings, raw = arrays
    numbers, listed, intervals = work
    if numbers.shape[1] != LANES:  # always true; tells the compiler the row stride
        return
    lanes = lanes_of(numbers)
    how, least = (rule.clearance, rule.persistence), least_square_cosine(rule.clearance)
    always_near = rule.clearance >= 0.5 * math.pi
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
        for lane in range(len(rows)):
            towards, near = read(lanes.heading, lane, axes), always_near
            count = list_seen(bits[first + lane], rule.neighbour_slots, len(intervals), listed)
            for k in range(count):
                row = listed[k]
                last, clockwise = load_pair(rows[lane, row]), load_pair(rows[lane, row + 1])
                near |= comes_near(towards, last, clockwise, least)
            if near:
                for k in range(count):
                    silhouette = rows[lane, listed[k] : listed[k] + 2]
                    interval_around(triple(towards), silhouette, intervals[k])
                carried = load(headings[first + lane])
                heading = heading_past(triple(towards), intervals[:count], carried, how)
                write(heading, lanes.heading, lane)
        give_out(axes, lanes.heading, first, stop, raw)


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
