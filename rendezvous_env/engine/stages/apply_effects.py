"""Stages of measured sensors: blind zone, detection, correlated errors, observer bias, outliers.

They follow ``apply_noise`` and process lanes as it does.
"""

import math

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.edges import list_pairs, pair_index
from ...physics.random_streams import word_of
from ...physics.vectors import norm, scaled, subtract, to_local
from ...sensors.chance import cosine_and_sine, gaussian, is_small, turned_by_angle, unit_number
from ...sensors.effects import as_float32, distance_of, share_in_view, turned_about
from ..memory import lane_count, load_fields, read_row, write_row
from .apply_noise import end_of, halve, highest_word, keep
from .remember import DETECTED, DRIFTED, OBSERVER, OUTLIER, is_due, parities, part_keys

_DETECTS, _TURNS, _REPLACES = range(3)
"""Effects on a row, in this order."""
_UPPER_HALF = np.uint64(32)
_ZERO, _ONE, _TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_HALF_SQUARE = np.float32(math.sqrt(0.5))
_WHOLE_TURN = np.float32(2.0 * math.pi)


@kernel
def apply_effects(
    width,
    axes,
    entries,
    first,
    last,
    moves,
    samples,
    effects,
    slots,
    in_order,
    links,
    seeds,
    episodes,
    merged_into,
    robots,
    environments,
    latent,
    errors,
    listed,
    weights,
    counts,
    keys,
    words,
    buffer,
    rows,
):
    """Drop rows of undetected neighbours, rotate the others, and replace outliers.

    Rows are as in ``apply_noise``; ``latent`` and ``errors`` are the memories of ``remember``. This
    and the following stages skip blocks in which no sample is due; ``samples`` are those of
    ``samples_of``.

    Working memory: listed (2, E), weights (E,), counts (n,), keys (2, L), words (3, 4, L), buffer
    (≥ 3·L,).
    """
    n = robots.shape[1]
    for block in range(first, last):
        if not is_due(width, moves, samples, environments[block]):
            continue
        found = list_pairs(links, block, n, listed[0], listed[1], weights)
        for purpose in range(3):
            if not _is_called_for(effects, purpose):
                continue
            streams = seeds, episodes, environments[block]
            _begin(width, block, moves, purpose, streams, keys, words)
            counts[:] = 0
            for e in range(found):
                ends = listed[0, e], listed[1, e]
                couple = pair_index(ends[0], ends[1], n)
                _draw(width, purpose, effects, couple, keys, words)
                pair = robots[block, ends[0]], robots[block, ends[1]]
                for side in range(2):
                    i, j, slot = end_of(links, block, n, ends, side, slots, in_order, counts)
                    if purpose == _DETECTS and (side == 0 or len(effects.chances) > 1):
                        _find_chances(width, axes, effects, i, pair, buffer)
                    if slot >= 0:
                        numbers, row = (i, j, 2 * couple + side, side), rows[block - first, i]
                        team = block, merged_into, robots, latent[block], errors[block]
                        work = keys, words, buffer
                        _apply(
                            width, axes, entries, purpose, effects, numbers, team, work, row[slot]
                        )


@inner_kernel(inline="code")
def _apply(width, axes, entries, purpose, effects, ends, team, work, row):
    """Apply one effect to a row.

    ``ends`` are the robots i and j, the number of the ordered pair and its side of the couple.
    """
    (i, j, number, side), (block, merged_into, robots, latent, errors) = ends, team
    keys, words, buffer = work
    if purpose == _DETECTS:
        robots_of, kept = (robots[block, i], robots[block, j]), (latent, number)
        _detect(width, axes, entries, effects, robots_of, i, side, kept, buffer, words, row)
    elif purpose == _TURNS:
        _turn(width, axes, effects.levels[i], (errors, number), keys, words[2, 0], row)
    else:
        pair, team_now = (i, j, number), (block, merged_into, robots)
        _replace(width, axes, entries, effects, pair, team_now, keys, words[2, 1 + side], row)


@inner_kernel
def _is_called_for(effects, purpose):
    if purpose == _DETECTS:
        return effects.blind or effects.detects
    return effects.drifts if purpose == _TURNS else effects.replaces


@inner_kernel
def _begin(width, block, moves, purpose, streams, keys, words):
    """Write the stream keys of an effect, and in words[2] the ``parities`` of the step."""
    seeds, episodes, environment = streams
    part = DETECTED if purpose == _DETECTS else DRIFTED if purpose == _TURNS else OUTLIER
    part_keys(width, block, moves, part, seeds, episodes, environment, keys)
    parities(width, moves, environment, words[2])


@inner_kernel
def _draw(width, purpose, effects, couple, keys, words):
    """Random words of a couple in a step: words[purpose, …]."""
    if purpose == _DETECTS and effects.detects and not effects.remembers:
        halve(width, keys[1], couple, words[0, 0], words[0, 1])
    elif purpose == _REPLACES:
        halve(width, keys[1], couple, words[2, 1], words[2, 2])


@inner_kernel
def _find_chances(width, axes, effects, i, pair, buffer):
    """Probability that robot i of a pair detects the other, and their distance, in every lane."""
    lanes, own = lane_count(width), (i if len(effects.chances) > 1 else 0)
    (robot, other), table, points = pair, effects.chances[own], effects.distances[own]
    for lane in range(lanes):
        here = load_fields(robot, 0, lane, lanes, axes)
        buffer[lanes + lane] = distance_of(here, load_fields(other, 0, lane, lanes, axes))
        buffer[lane] = table[0]
    for k in range(len(points) - 1):
        span = points[k + 1] - points[k]
        low, slope = points[k], (table[k + 1] - table[k]) / span
        for lane in range(lanes):
            buffer[lane] += slope * min(max(buffer[lanes + lane] - low, 0.0), span)


@inner_kernel
def _detect(width, axes, entries, effects, pair, i, side, kept, buffer, words, row):
    """Drop a row of the lanes in which robot i does not detect the neighbour."""
    lanes, (robot, other), (latent, number) = lane_count(width), pair, kept
    nearest, falloff, chance = effects.nearest[i], effects.falloffs[i], 2 * lanes
    for lane in range(lanes):
        buffer[chance + lane] = 0.0 if buffer[lanes + lane] < nearest else buffer[lane]
    if falloff > 0.0:
        for lane in range(lanes):
            here = load_fields(robot, 0, lane, lanes, axes)
            offset = subtract(load_fields(other, 0, lane, lanes, axes), here)
            frame = load_fields(robot, len(axes), lane, lanes, entries)
            share = share_in_view(offset, frame, effects.half_fields[i], falloff)
            buffer[chance + lane] *= share
    if effects.remembers:
        for lane in range(lanes):
            even, odd = latent[0, number, lane], latent[1, number, lane]
            u = odd if words[2, 0, lane] != 0 else even
            keep(u < buffer[chance + lane], axes, row, lane)
    elif effects.detects:
        for lane in range(lanes):
            keep(unit_number(words[0, side, lane]) < buffer[chance + lane], axes, row, lane)
    else:
        for lane in range(lanes):
            keep(buffer[chance + lane] > 0.0, axes, row, lane)


@inner_kernel
def _turn(width, axes, level, kept, keys, odd, row):
    """Rotate a row by its error in a memory, times a level, rad."""
    if level > 0.0 and is_small(level):
        _turn_by(width, axes, level, True, kept, keys, odd, row)
    elif level > 0.0:
        _turn_by(width, axes, level, False, kept, keys, odd, row)


@inner_kernel(inline="code")
def _turn_by(width, axes, level, small, kept, keys, odd, row):
    """Rotate a row by its error in a memory, times a level, in every lane."""
    errors, number = kept
    for lane in range(lane_count(width)):
        even_step, odd_step = errors[0, number, lane], errors[1, number, lane]
        angle = level * (odd_step if odd[lane] != 0 else even_step)
        other = np.uint32(word_of(keys[0, lane], number))
        write_row(turned_by_angle(read_row(row, lane, axes), angle, small, other), row, lane)


@inner_kernel
def _replace(width, axes, entries, effects, pair, team, keys, words, row):
    """Replace a row by an outlier of equal length in the lanes in which one is sampled."""
    lanes, (i, j, number), (block, merged_into, robots) = lane_count(width), pair, team
    if effects.outliers[i] == 0.0:
        return
    highest, lowest = highest_word(effects.outliers[i]), words[0]
    for lane in range(lanes):
        lowest = min(lowest, words[lane])
    if lowest > highest:
        return
    for lane in range(min(lanes, len(merged_into) - block * lanes)):
        if words[lane] <= highest:
            n = robots.shape[1]  # couples have lower numbers in the stream
            seen, word = read_row(row, lane, axes), word_of(keys[1, lane], n * n + number)
            length = np.float32(norm(seen))
            if length > 0.0 and effects.uniform[i]:
                write_row(_anywhere(seen, length, word), row, lane)
            elif length > 0.0:
                into = merged_into[block * lanes + lane]
                other = _another(i, j, into, unit_number(np.uint32(word)))
                if other >= 0:
                    here, there = robots[block, i], robots[block, other]
                    _see_instead(axes, entries, here, there, length, lane, lanes, row)


@inner_kernel
def _see_instead(axes, entries, robot, other, length, lane, lanes, row):
    """Replace a row by the bearing of another robot, with its length; unchanged without one."""
    here = load_fields(robot, 0, lane, lanes, axes)
    there = load_fields(other, 0, lane, lanes, axes)
    distance = distance_of(here, there)
    if distance > 0.0:
        frame = load_fields(robot, len(axes), lane, lanes, entries)
        bearing = scaled(to_local(frame, subtract(there, here)), np.float64(length) / distance)
        write_row(as_float32(bearing), row, lane)


@inner_kernel
def _anywhere(row, length, word):
    """A uniformly distributed direction of a length, from a word; in 3-D its height is uniform."""
    c, s = cosine_and_sine(_WHOLE_TURN * unit_number(np.uint32(word >> _UPPER_HALF)), False)
    if len(row) == 2:
        return length * c, length * s
    height = _TWO * unit_number(np.uint32(word)) - _ONE
    level = np.float32(math.sqrt(max(_ONE - height * height, _ZERO)))
    return length * level * c, length * level * s, length * height


@inner_kernel
def _another(i, j, into, chance):
    """Active robot other than i and j, selected by a number in [0, 1); −1 without one."""
    count = 0
    for k in range(len(into)):
        count += into[k] == k and k != i and k != j
    chosen = int(chance * count)
    for k in range(len(into)):
        if into[k] == k and k != i and k != j:
            if chosen == 0:
                return k
            chosen -= 1
    return -1


@kernel
def turn_silhouettes(
    width,
    axes,
    first,
    last,
    moves,
    samples,
    effects,
    own,
    points,
    start,
    seeds,
    episodes,
    environments,
    errors,
    keys,
    words,
    rows,
):
    """Apply noise with a memory to the angular extents of obstacles.

    They have ``points`` rows each from the row ``own`` on. The level is that of each robot; errors
    begin at the index ``start``.
    """
    count = (rows.shape[2] - own) // points * points  # a remaining row is proprioception
    for block in range(first, last):
        if not is_due(width, moves, samples, environments[block]):
            continue
        streams = seeds, episodes, environments[block]
        _begin(width, block, moves, _TURNS, streams, keys, words)
        for i in range(rows.shape[1]):
            for number in range(count):
                row = rows[block - first, i, own + number]
                kept = errors[block], start + i * count + number
                _turn(width, axes, effects.levels[i], kept, keys, words[2, 0], row)


@kernel
def turn_observers(
    width,
    axes,
    first,
    last,
    moves,
    samples,
    deviations,
    begin,
    end,
    seeds,
    episodes,
    environments,
    keys,
    turns,
    rows,
):
    """Rotate the rows from ``begin`` to ``end`` of each robot by the bias of its sensor.

    ``deviations``, (n,), rad, are its standard deviations. Working memory: keys (2, L), turns (≥
    5·L,).
    """
    for block in range(first, last):
        if not is_due(width, moves, samples, environments[block]):
            continue
        part_keys(width, block, moves, OBSERVER, seeds, episodes, environments[block], keys)
        for i in range(rows.shape[1]):
            _draw_turns(width, axes, np.float32(deviations[i]), i, keys, turns)
            for number in range(begin, end):
                row = rows[block - first, i, number]
                for lane in range(lane_count(width)):
                    seen, turn = read_row(row, lane, axes), _read_turn(width, axes, turns, lane)
                    write_row(turned_about(seen, turn), row, lane)


@inner_kernel(inline="code")
def _draw_turns(width, axes, deviation, i, keys, turns):
    """Sample the rotation of robot i's sensor in every lane.

    N(0, σ²) in the plane, in 3-D a rotation vector of three numbers of N(0, σ²/2).
    """
    lanes = lane_count(width)
    for lane in range(lanes):
        one, two = word_of(keys[0, lane], 2 * i), word_of(keys[0, lane], 2 * i + 1)
        x = deviation * gaussian(np.uint32(one))
        if len(axes) == 2:
            turns[lane], turns[lanes + lane] = cosine_and_sine(x, False)
        else:
            x, y = x * _HALF_SQUARE, deviation * _HALF_SQUARE * gaussian(np.uint32(two))
            z = deviation * _HALF_SQUARE * gaussian(np.uint32(two >> _UPPER_HALF))
            angle = np.float32(math.sqrt(x * x + y * y + z * z))
            turns[lane], turns[lanes + lane] = cosine_and_sine(angle, False)
            over = _ONE / angle if angle > 0.0 else _ZERO
            turns[2 * lanes + lane], turns[3 * lanes + lane] = x * over, y * over
            turns[4 * lanes + lane] = z * over


@inner_kernel(inline="code")
def _read_turn(width, axes, turns, lane):
    lanes = lane_count(width)
    c, s = np.float32(turns[lane]), np.float32(turns[lanes + lane])
    if len(axes) == 2:
        return c, s
    x, y = np.float32(turns[2 * lanes + lane]), np.float32(turns[3 * lanes + lane])
    return c, s, x, y, np.float32(turns[4 * lanes + lane])
