"""Stages of clocks and of failures, called only in scenarios with ``activation`` or ``events``.

Before ``propose_motion``: a robot that is active takes its action as its command, any other one
keeps its command or stands still; then crashes, adversaries, slip and disturbances change the
command. After the motion local frames turn, and robots with a failed sensor observe nothing.
"""

import math

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.edges import load_links
from ...physics.potential import net_bearings_of_links
from ...physics.random_streams import ACTIVATION, ACTUATION, stream_key, uniform
from ...physics.vectors import dot, to_local
from ...robots.activation import is_adversarial, is_scheduled
from ...robots.events import ADVERSARY, BLIND, CRASH, SIGHTED, drawn_disturbance, drawn_turn
from ...robots.motion import constants_of_robot, propose
from ..memory import (
    RUNNING,
    STATUS,
    STEPS,
    load_fields,
    load_positions,
    sensed_step,
    store_fields,
)

_NUMBERS = 10  # random numbers reserved for a robot in a step
_CRASHED, _ADVERSE = 1, 2
_ZERO = np.float32(0.0)


@kernel
def take_commands(
    robot,
    lanes,
    first,
    last,
    rules,
    streams,
    robots,
    merged_into,
    environments,
    links,
    clocks,
    vectors,
    listed,
    weights,
    actions,
):
    """Write the commands of all robots of some blocks, from actions, (B, n, a), and those before.

    ``clocks`` are the commands, (B, n, a); the step of each robot's last activation, (B, n), −1
    before the first; and whether it is active in this step, (B, n). ``streams`` are the seeds and
    episodes, (B,). Working memory: vectors (3, n, d), listed (2, E), weights (E,). To call it again
    in the same step, with other actions, gives the same as to call it once.
    """
    (seeds, episodes), n = streams, robots.shape[1]
    commands, last_step, activated = clocks
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            b, now = block * lanes + lane, environments[block]
            running = now[STATUS * lanes + lane] == RUNNING
            if running and is_adversarial(rules):
                _find_net_bearings(links, robots, block, lane, lanes, vectors, listed, weights)
            step = int(now[STEPS * lanes + lane])
            key = stream_key(seeds[b], episodes[b], ACTIVATION)
            for i in range(n):
                activated[b, i] = False
                if not running or merged_into[b, i] != i:
                    continue
                command, action, before = commands[b, i], actions[b, i], last_step[b, i]
                due = is_scheduled(rules, key, step, step - before - 1, i) or before == step
                if is_adversarial(rules) and not due:
                    state, net_bearing = robots[block, i], vectors[1, i]
                    gain = _work(robot, i, lanes, lane, state, action, net_bearing)
                    kept = 0.0
                    if not rules.stops:
                        kept = _work(robot, i, lanes, lane, state, command, net_bearing)
                    due = gain < kept
                # selection instead of a branch, which random activation would mispredict
                activated[b, i], last_step[b, i] = due, step if due else before
                for k in range(len(robot.inputs)):
                    other = _ZERO if rules.stops else command[k]
                    command[k] = action[k] if due else other


@inner_kernel
def _find_net_bearings(links, robots, block, lane, lanes, vectors, listed, weights):
    """Write f_i of every robot of one environment to vectors[1], m/s, in the global frame."""
    load_positions(robots[block], lane, lanes, vectors[0])
    found = load_links(links, block, lane, robots.shape[1], listed[0], listed[1], weights)
    edges = listed[0, :found], listed[1, :found], weights[:found]
    net_bearings_of_links(vectors[0], edges, vectors[1])


@inner_kernel(inline="code")
def _work(robot, i, lanes, lane, state, action, net_bearing):
    """f_i · Δ_i of an action, m²/s: half of the rate at which it lowers V."""
    d, given = len(robot.axes), action
    moved, _ = propose(
        constants_of_robot(robot.model, robot.limits, i),
        _as_tuple(given, robot.inputs),
        load_fields(state, d, lane, lanes, robot.entries),
        load_fields(state, d + d * d, lane, lanes, robot.memories),
    )
    return dot(moved, _as_tuple(net_bearing, robot.axes))


@inner_kernel(inline="code")
def _as_tuple(values, parts):
    """An array as a tuple, as long as ``parts``."""
    if len(parts) == 1:
        return (values[0],)
    if len(parts) == 2:
        return values[0], values[1]
    if len(parts) == 3:
        return values[0], values[1], values[2]
    return values[0], values[1], values[2], values[3]


@kernel
def disturb_commands(
    robot,
    lanes,
    first,
    last,
    rules,
    streams,
    robots,
    merged_into,
    environments,
    links,
    faults,
    executed,
    vectors,
    listed,
    weights,
    marks,
    commands,
):
    """Write the commands that are executed after failures and disturbances, both (B, n, a).

    ``faults`` are steps of events, (B, n, 4), and ``streams`` the seeds and episodes, (B,). Working
    memory as in ``take_commands``, and marks (n,).
    """
    (seeds, episodes), n = streams, robots.shape[1]
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            b, now = block * lanes + lane, environments[block]
            running, step = now[STATUS * lanes + lane] == RUNNING, int(now[STEPS * lanes + lane])
            adverse = running and rules.fails
            if adverse:
                adverse = _mark_faults(faults[b], merged_into[b], step, marks)
            if adverse:
                _find_net_bearings(links, robots, block, lane, lanes, vectors, listed, weights)
            key = stream_key(seeds[b], episodes[b], ACTUATION)
            for i in range(n):
                command, own = commands[b, i], executed[b, i]
                mark = marks[i] if running and rules.fails else 0
                counter = (step * n + i) * _NUMBERS
                share = 1.0 - rules.slip * uniform(key, counter) if rules.slip > 0.0 else 1.0
                if not running or mark & _CRASHED:
                    share = 0.0
                for k in range(len(own)):
                    own[k] = command[k] * share
                if not running or mark & _CRASHED or merged_into[b, i] != i:
                    continue
                frame = load_fields(robots[block, i], len(robot.axes), lane, lanes, robot.entries)
                if mark & _ADVERSE:
                    away = _as_tuple(vectors[1, i], robot.axes)
                    length = math.sqrt(dot(away, away))
                    speed = -rules.speed_limit / length if length > 0.0 else 0.0
                    for k in range(len(own)):
                        own[k] = 0.0
                    _add(own, to_local(frame, away), speed)
                elif rules.disturbance > 0.0 or rules.noise > 0.0:
                    drawn = drawn_disturbance(rules, key, counter + 1, robot.axes)
                    _add(own, to_local(frame, drawn), 1.0)


@inner_kernel
def _mark_faults(faults, into, step, marks):
    """Mark the robots that have crashed or are adversarial, which merged ones pass on.

    Returns whether any robot is adversarial.
    """
    found = False
    for i in range(len(marks)):
        marks[i] = 0
    for i in range(len(marks)):
        if faults[i, CRASH] <= step:
            marks[into[i]] |= _CRASHED
        if faults[i, ADVERSARY] <= step:
            marks[into[i]] |= _ADVERSE
            found = True
    return found


@inner_kernel
def _add(row, values, factor):
    """Add a multiple of a pair or triple to the first entries of a row."""
    row[0] += factor * values[0]
    row[1] += factor * values[1]
    if len(values) == 3:
        row[2] += factor * values[2]


@kernel
def turn_frames(axes, entries, lanes, first, last, rules, streams, environments, robots):
    """Turn the local frames of all robots of running environments about the vertical."""
    (seeds, episodes), d = streams, len(axes)
    for block in range(first, last):
        for lane in range(min(lanes, len(seeds) - block * lanes)):
            now, b = environments[block], block * lanes + lane
            if now[STATUS * lanes + lane] != RUNNING:
                continue
            key, step = stream_key(seeds[b], episodes[b], ACTUATION), int(now[STEPS * lanes + lane])
            for i in range(robots.shape[1]):
                counter = (step * robots.shape[1] + i) * _NUMBERS + 8
                angle = drawn_turn(rules, key, counter, i)
                frame = load_fields(robots[block, i], d, lane, lanes, entries)
                store_fields(_turned(frame, angle), robots[block, i], d, lane, lanes)


@inner_kernel
def _turned(frame, angle):
    """R_z(angle) R of a rotation R, row by row, 4 or 9 numbers."""
    c, s = math.cos(angle), math.sin(angle)
    if len(frame) == 4:
        x, y = c * frame[0] - s * frame[2], s * frame[0] + c * frame[2]
        length = math.sqrt(x * x + y * y)  # else rounding adds up over many steps
        x, y = x / length, y / length
        return x, -y, y, x
    first, second = frame[:3], frame[3:6]
    return (
        c * first[0] - s * second[0],
        c * first[1] - s * second[1],
        c * first[2] - s * second[2],
        s * first[0] + c * second[0],
        s * first[1] + c * second[1],
        s * first[2] + c * second[2],
        frame[6],
        frame[7],
        frame[8],
    )


@kernel
def hide_from_blind(lanes, first, last, moves, sensed, environments, faults, observations):
    """Zero the first ``sensed`` rows of robots whose sensor has failed."""
    for block in range(first, last):
        for lane in range(min(lanes, len(faults) - block * lanes)):
            b, step = block * lanes + lane, sensed_step(environments[block], lane, lanes, moves)
            for i in range(faults.shape[1]):
                if faults[b, i, BLIND] <= step and step < faults[b, i, SIGHTED]:
                    rows = observations[b, i]
                    for row in range(sensed):
                        for k in range(rows.shape[1]):
                            rows[row, k] = 0.0
