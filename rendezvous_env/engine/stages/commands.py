"""Stages of clocks and of failures, called only in scenarios with ``activation`` or ``events``.

Before ``propose_motion``: the command of an active robot is its action; other robots repeat their
command or do not move; then crashes, adversaries, slip and disturbances change the command. After
the motion local frames rotate, and robots with a failed sensor observe nothing.

Loops over lanes are SIMD, apart from those that copy between lanes and arrays (B, n, …).
"""

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.edges import DENSE, load_links
from ...physics.potential import net_bearings_of_links
from ...physics.random_streams import ACTIVATION, ACTUATION, later_key, stream_key, uniform
from ...physics.vectors import add, dot, exactly, norm, scaled, to_global, to_local
from ...robots.activation import is_adversarial, is_drawn, is_random, is_scheduled
from ...robots.events import (
    ADVERSARY,
    BLIND,
    CRASH,
    DRAWS,
    SIGHTED,
    unit_pair,
)
from ...robots.motion import constants_of_robot, propose
from ...sensors.chance import cosine_and_sine, drawn_within, gaussian
from ..memory import (
    ACTIVE,
    RUNNING,
    STATUS,
    STEPS,
    lane_count,
    load_fields,
    load_positions,
    read,
    read_row,
    sensed_step,
    store_fields,
    write_row,
)
from .apply_noise import halve
from .propose import load_actions

_ZERO, _NONE, _ALL = np.float32(0.0), np.int32(0), np.int32(-1)
_CRASHED, _ADVERSE = range(2)
"""Marks of a robot, 0 or 1, in the first fields of its motion, which is not yet in use."""
_BESIDES = 3
"""Field of the working memory of ``disturb_commands`` where a robot's added velocity begins, m/s,
after the sampled velocities."""


@kernel
def sum_bearings(
    width, axes, entries, first, last, robots, links, vectors, listed, weights, nets, rows
):
    """Write f_i of every robot, in its own frame, m/s, (blocks, n, L·d) float32, from exact rows.

    Of directed links f_i is that of the mean weights, along which V falls fastest. Working memory:
    vectors (3, n, d), listed (2, E), weights (E,).
    """
    n = robots.shape[1]
    for block in range(first, last):
        if links.form != DENSE:
            load_positions(robots[block], 0, 1, vectors[0])
            found = load_links(links, block, 0, n, listed[0], listed[1], weights)
            edges = listed[0, :found], listed[1, :found], weights[:found]
            net_bearings_of_links(vectors[0], edges, vectors[1])
        for i in range(n):
            net = nets[block, i]
            net[:] = _ZERO
            for j in range(n - 1 if links.form == DENSE else 0):
                _add_row(width, axes, rows[block - first, i, j], net)
            if links.form != DENSE:
                frame = load_fields(robots[block, i], len(axes), 0, 1, entries)
                write_row(to_local(frame, load_fields(vectors[1, i], 0, 0, 1, axes)), net, 0)


@inner_kernel(inline="code")
def _add_row(width, axes, row, net):
    """Add a row of observations to the sums, both (L·d,)."""
    for k in range(lane_count(width) * len(axes)):
        net[k] += row[k]


@kernel
def take_commands(
    width,
    robot,
    first,
    last,
    rules,
    streams,
    robots,
    merged_into,
    environments,
    nets,
    clocks,
    keys,
    work,
    moves,
    actions,
):
    """Write the commands of all robots of some blocks, from actions, (B, n, a), and those before.

    ``clocks`` are the commands, (B, n, a); the step of each robot's last activation, (blocks, n,
    L), −1 before the first, if an adversary uses it; and whether it is active in this step, (B, n).
    ``streams`` are the seeds and episodes, (B,), and ``nets`` f_i of ``sum_bearings``. Working
    memory: keys (2, L), work (L,), moves (n, (d + 1 + a)·L).
    """
    lanes, n, (commands, last_step, activated) = lane_count(width), robots.shape[1], clocks
    for block in range(first, last):
        environment, start = environments[block], block * lanes
        count = min(lanes, len(merged_into) - start)
        if is_random(rules):
            _find_keys(width, start, count, ACTIVATION, n, streams, environment, keys[0])
        for i in range(n):
            _schedule(width, rules, i, environment, keys[0], work)
            if is_adversarial(rules):
                state, own = robots[block, i], (nets[block, i], last_step[block, i])
                load_actions(width, robot, i, start, actions, moves[0])
                if rules.stops:
                    _choose(width, robot, rules, i, environment, state, own, True, moves, work)
                else:
                    load_actions(width, robot, i, start, commands, moves[1])
                    _choose(width, robot, rules, i, environment, state, own, False, moves, work)
            for lane in range(count):
                activated[start + lane, i] = work[lane] > 0.0
        _leave_out(width, n, start, count, environment, merged_into, activated)
    begin, end = first * lanes, min(last * lanes, len(merged_into))
    _select(robot, rules.stops, begin, end, activated, actions, commands)


@inner_kernel(inline="code")
def _find_keys(width, start, count, purpose, words, streams, environment, keys):
    """Keys of the streams for one purpose from the current step on; a step has ``words`` words."""
    lanes, (seeds, episodes) = lane_count(width), streams
    for lane in range(count):
        key = stream_key(seeds[start + lane], episodes[start + lane], purpose)
        keys[lane] = later_key(key, int(environment[STEPS * lanes + lane]) * words)


@inner_kernel(inline="code")
def _schedule(width, rules, i, environment, keys, work):
    """Mark the lanes in which robot i is active by its own clock."""
    lanes = lane_count(width)
    if is_random(rules):
        for lane in range(lanes):
            work[lane] = is_drawn(rules, keys[lane], i)
    elif not is_adversarial(rules):
        for lane in range(lanes):
            work[lane] = is_scheduled(rules, environment[STEPS * lanes + lane], i)


@inner_kernel(inline="code")
def _choose(width, robot, rules, i, environment, state, own, stops, moves, work):
    """Mark the lanes in which an adversary activates robot i, or must do so.

    It compares the rates f_i · Δ_i, m²/s, at which the action and the command in execution, those
    of ``moves``, lower V; a robot that ``stops`` has none. One that was activated in this step
    stays so if the stage is repeated. ``own`` are its f_i and last activations.
    """
    lanes, (net, last_step) = lane_count(width), own
    model = constants_of_robot(robot.model, robot.limits, i)
    for lane in range(lanes):
        frame = load_fields(state, len(robot.axes), lane, lanes, robot.entries)
        fastest = to_global(frame, exactly(read_row(net, lane, robot.axes)))
        gain = dot(_proposed(robot, model, frame, state, moves[0], lane, lanes), fastest)
        kept = 0.0
        if not stops:
            kept = dot(_proposed(robot, model, frame, state, moves[1], lane, lanes), fastest)
        step, before = int(environment[STEPS * lanes + lane]), last_step[lane]
        forced = (step - before >= rules.max_wait) | (step == before)
        due = forced | (gain < kept)
        due &= environment[STATUS * lanes + lane] == RUNNING
        work[lane] = 1.0 if due else 0.0
        last_step[lane] = step if due else before


@inner_kernel(inline="code")
def _proposed(robot, model, frame, state, move, lane, lanes):
    """Displacement Δ_i of one lane by the action of a motion, m."""
    d = len(robot.axes)
    action = load_fields(move, d + 1, lane, lanes, robot.inputs)
    memory = load_fields(state, d + d * d, lane, lanes, robot.memories)
    moved, _ = propose(model, action, frame, memory)
    return moved


@inner_kernel
def _leave_out(width, n, start, count, environment, merged_into, activated):
    """Clear the activation of merged robots, and in environments that are not running."""
    lanes = lane_count(width)
    for lane in range(count):
        running = environment[STATUS * lanes + lane] == RUNNING
        if running and environment[ACTIVE * lanes + lane] == n:
            continue
        for i in range(n):
            activated[start + lane, i] &= running and merged_into[start + lane, i] == i


@inner_kernel
def _select(robot, stops, begin, end, activated, actions, commands):
    """Write the commands of environments: actions of active robots, of others those before, or 0.

    One loop over all robots becomes SIMD by masks of bits; a selection would become a branch, which
    random activation mispredicts.
    """
    a, others = len(robot.inputs), _NONE if stops else _ALL
    due = activated[begin:end].reshape(-1).view(np.int8)
    new = actions[begin:end].reshape(-1).view(np.int32)
    kept = commands[begin:end].reshape(-1).view(np.int32)
    for p in range(len(due)):
        mask = -np.int32(due[p])
        for k in range(a):
            other = kept[a * p + k] & others
            kept[a * p + k] = other ^ ((other ^ new[a * p + k]) & mask)


@kernel
def disturb_commands(
    width,
    robot,
    first,
    last,
    rules,
    streams,
    robots,
    merged_into,
    environments,
    nets,
    faults,
    keys,
    words,
    work,
    moves,
    commands,
):
    """Write the actions of ``moves`` after failures and disturbances, from commands, (B, n, a).

    ``faults`` are steps of events, (B, 4, n), ``streams`` the seeds and episodes, (B,), and
    ``nets`` f_i of ``sum_bearings``. Working memory: keys (2, L), words (6, L), work ((d + 3)·L,).
    """
    lanes, n = lane_count(width), robots.shape[1]
    for block in range(first, last):
        environment, start, moving = environments[block], block * lanes, moves[block - first]
        count = min(lanes, len(merged_into) - start)
        if rules.draws:
            _find_keys(width, start, count, ACTUATION, n * DRAWS, streams, environment, keys[0])
        if rules.fails:
            _mark_faults(width, rules, start, count, faults, merged_into, environment, moving)
        for i in range(n):
            state, move = robots[block, i], moving[i]
            load_actions(width, robot, i, start, commands, move)
            opposes = rules.opposes and _any_marked(width, _ADVERSE, move)
            fails = rules.fails and _any_marked(width, _CRASHED, move)
            if not (opposes or fails or rules.draws):
                continue
            _find_shares(width, robot, rules, i * DRAWS, keys[0], move, work)
            _disturb(width, robot, rules, i * DRAWS, keys[0], words, state, work, move)
            if opposes:
                _oppose(width, robot, rules, nets[block, i], work, move)
            _execute(width, robot, move, work)


@inner_kernel(inline="code")
def _any_marked(width, field, move):
    """True if a mark of a robot is 1 in any lane."""
    lanes, total = lane_count(width), 0.0
    for lane in range(lanes):
        total += move[field * lanes + lane]
    return total > 0.0


@inner_kernel(inline="code")
def _execute(width, robot, move, work):
    """Write the fraction of its command that a robot executes, and its added velocity."""
    lanes, d = lane_count(width), len(robot.axes)
    for k in range(len(robot.inputs)):
        for lane in range(lanes):
            own = move[(d + 1 + k) * lanes + lane] * move[d * lanes + lane]
            besides = work[(_BESIDES + k) * lanes + lane] if k < d else 0.0
            move[(d + 1 + k) * lanes + lane] = np.float32(own + besides)


@inner_kernel(inline="code")
def _mark_faults(width, rules, start, count, faults, merged_into, environment, moves):
    """Mark the robots that have crashed or are adversarial; a merged robot passes this on."""
    lanes, n = lane_count(width), len(moves)
    for lane in range(count):
        step = int(environment[STEPS * lanes + lane])
        for i in range(n):
            crashed = rules.crashes and faults[start + lane, CRASH, i] <= step
            moves[i, _CRASHED * lanes + lane] = 1.0 if crashed else 0.0
        for i in range(n if rules.opposes else 0):
            moves[i, _ADVERSE * lanes + lane] = faults[start + lane, ADVERSARY, i] <= step
    for lane in range(count):
        if environment[ACTIVE * lanes + lane] < n:
            for i in range(n):
                into = merged_into[start + lane, i]
                for k in range(_CRASHED * lanes + lane, (_ADVERSE + 1) * lanes, lanes):
                    moves[into, k] = max(moves[into, k], moves[i, k])


@inner_kernel(inline="code")
def _find_shares(width, robot, rules, counter, keys, move, work):
    """Write the fraction of its command that a robot executes to the field of the path length.

    Slip reduces it, and it is 0 after a crash. The added velocity is initialised to 0.
    """
    lanes, d = lane_count(width), len(robot.axes)
    move[d * lanes : (d + 1) * lanes] = 1.0
    work[_BESIDES * lanes : (_BESIDES + d) * lanes] = 0.0
    if rules.slip > 0.0:
        for lane in range(lanes):
            move[d * lanes + lane] = 1.0 - rules.slip * uniform(keys[lane], counter)
    if rules.fails:
        for lane in range(lanes):
            move[d * lanes + lane] *= 1.0 - move[_CRASHED * lanes + lane]


@inner_kernel(inline="code")
def _disturb(width, robot, rules, counter, keys, words, state, work, move):
    """Add velocity disturbances, unless the robot has crashed."""
    lanes, d = lane_count(width), len(robot.axes)
    if rules.disturbance > 0.0:
        radius = np.float32(rules.disturbance)
        for k in range(3 if d == 3 else 2):
            halve(width, keys, counter + 1 + k, words[2 * k], words[2 * k + 1])
        for lane in range(lanes):
            four = read(words, lane, (0, 1, 2, 3))
            drawn = drawn_within(radius, four, words[4, lane], robot.axes)
            store_fields(exactly(drawn), work, 0, lane, lanes)
        _add_velocity(width, robot, rules, state, work, move)
    if rules.noise > 0.0:
        noise = np.float32(rules.noise)
        for k in range(0, d, 2):
            halve(width, keys, counter + 4 + k // 2, words[k], words[k + 1])
        for k in range(d):
            for lane in range(lanes):
                work[k * lanes + lane] = noise * gaussian(words[k, lane])
        _add_velocity(width, robot, rules, state, work, move)


@inner_kernel(inline="code")
def _add_velocity(width, robot, rules, state, work, move):
    """Add velocities in the global frame, m/s, to those of a robot, unless it has crashed."""
    lanes, d = lane_count(width), len(robot.axes)
    for lane in range(lanes):
        frame = load_fields(state, d, lane, lanes, robot.entries)
        own = to_local(frame, load_fields(work, 0, lane, lanes, robot.axes))
        works = 1.0 - move[_CRASHED * lanes + lane] if rules.fails else 1.0
        so_far = load_fields(work, _BESIDES, lane, lanes, robot.axes)
        store_fields(add(so_far, works, own), work, _BESIDES, lane, lanes)


@inner_kernel(inline="code")
def _oppose(width, robot, rules, net, work, move):
    """Velocity −f_i/‖f_i‖ at full speed, instead of its command, of an adversarial robot."""
    lanes, d = lane_count(width), len(robot.axes)
    for lane in range(lanes):
        away = exactly(read_row(net, lane, robot.axes))
        length = norm(away)
        own = scaled(away, -rules.speed_limit / length if length > 0.0 else 0.0)
        opposes = move[_ADVERSE * lanes + lane] * (1.0 - move[_CRASHED * lanes + lane])
        move[d * lanes + lane] *= 1.0 - opposes
        so_far = scaled(load_fields(work, _BESIDES, lane, lanes, robot.axes), 1.0 - opposes)
        store_fields(add(so_far, opposes, own), work, _BESIDES, lane, lanes)


@kernel
def turn_frames(
    width, axes, entries, first, last, rules, streams, environments, keys, words, work, robots
):
    """Turn the local frames of all robots of running environments about the vertical.

    Working memory: keys (2, L), words (2, L), work (2·L,).
    """
    lanes, n = lane_count(width), robots.shape[1]
    for block in range(first, last):
        environment, start = environments[block], block * lanes
        if rules.walk > 0.0:
            count = min(lanes, len(streams[0]) - start)
            _find_keys(width, start, count, ACTUATION, n * DRAWS, streams, environment, keys[0])
        for i in range(n):
            turn, state = (rules.turns[i, 0], rules.turns[i, 1]), robots[block, i]
            if rules.walk > 0.0:
                _draw_turns(width, np.float32(rules.walk), i * DRAWS + 8, keys[0], words, work)
                _turn_by(width, axes, entries, turn, True, work, environment, state)
            else:
                _turn_by(width, axes, entries, turn, False, work, environment, state)


@inner_kernel
def _draw_turns(width, walk, counter, keys, words, work):
    """Cosine and sine of Gaussian angles of a standard deviation, rad, in every lane."""
    lanes = lane_count(width)
    halve(width, keys, counter, words[0], words[1])
    for lane in range(lanes):
        work[lane] = walk * gaussian(words[0, lane])
    for lane in range(lanes):
        c, s = cosine_and_sine(np.float32(work[lane]), False)
        work[lane], work[lanes + lane] = unit_pair(np.float64(c), np.float64(s))


@inner_kernel(inline="code")
def _turn_by(width, axes, entries, turn, draws, work, environment, robot):
    """Rotate the frame of a robot by its drift, a cosine and a sine, and by sampled angles."""
    lanes, d = lane_count(width), len(axes)
    for lane in range(lanes):
        running = environment[STATUS * lanes + lane] == RUNNING
        c, s = (turn[0] if running else 1.0), (turn[1] if running else 0.0)
        if draws:
            x = work[lane] if running else 1.0
            y = work[lanes + lane] if running else 0.0
            c, s = c * x - s * y, s * x + c * y
        frame = load_fields(robot, d, lane, lanes, entries)
        store_fields(_turned(frame, c, s), robot, d, lane, lanes)


@inner_kernel(inline="code")
def _turned(frame, c, s):
    """R_z R of a rotation R, row by row, 4 or 9 numbers, by the cosine and sine of R_z."""
    if len(frame) == 4:
        # one row, of unit length, else rounding adds up over many steps
        x, y = unit_pair(c * frame[0] - s * frame[2], s * frame[0] + c * frame[2])
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
            for i in range(faults.shape[2]):
                if faults[b, BLIND, i] <= step and step < faults[b, SIGHTED, i]:
                    rows = observations[b, i]
                    for row in range(sensed):
                        for k in range(rows.shape[1]):
                            rows[row, k] = 0.0


@kernel
def find_conditions(steps, merged_into, faults, crashed, adversarial, blind):
    """Mark the robots that have crashed, are adversarial, and are blind, (B, n) each.

    ``steps`` are those of the episodes, (B,). Arrays (B, 0) are left out.
    """
    if crashed.shape[1] > 0:
        _mark_failed(steps, merged_into, faults, CRASH, crashed)
    if adversarial.shape[1] > 0:
        _mark_failed(steps, merged_into, faults, ADVERSARY, adversarial)
    for b in range(len(steps) if blind.shape[1] > 0 else 0):
        step = int(steps[b])
        for i in range(blind.shape[1]):
            fails = (faults[b, BLIND, i] <= step) & (step < faults[b, SIGHTED, i])
            blind[b, i] = fails & (merged_into[b, i] == i)


@inner_kernel
def _mark_failed(steps, merged_into, faults, event, failed):
    """Mark the robots with an event before a step; a merged robot passes it on."""
    n = failed.shape[1]
    for b in range(len(steps)):
        step, merged = int(steps[b]), 0
        for i in range(n):
            failed[b, i] = faults[b, event, i] < step
            merged |= merged_into[b, i] ^ i
        for i in range(n if merged != 0 else 0):
            failed[b, merged_into[b, i]] |= failed[b, i]
        for i in range(n if merged != 0 else 0):
            failed[b, i] &= merged_into[b, i] == i
