"""Stage that applies range, field of view and random errors to the exact rows of a block.

It runs before rows are written out, for all environments of a block at once: loops over lanes
become SIMD. A *couple* shares the words of a stream: the rows of two robots about each other, or
two adjacent points of an obstacle.
"""

import math

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.edges import edge_weight, list_pairs, pair_index
from ...physics.random_streams import SENSING, stream_key, word_of
from ...physics.vectors import dot, exactly, norm, subtract, to_local
from ...sensors.chance import is_small, step_key, turned_by_chance
from ...sensors.imperfections import errors_of, in_sectors, is_in_view, is_seen
from ..memory import lane_count, load_fields, read_row, sensed_step, write_row

EPISODE_KEYS, STEP_KEYS = range(2)
"""Key indices: of an environment's episode, and of its step."""
_BIAS, _NOISE, _MISSED = range(3)
"""Random quantities of a couple."""
DRAWS = 3
"""Words of a stream for one couple: two for its rotation (one in 2-D), one for dropout."""
_UPPER_HALF, _WORDS = np.uint64(32), 2.0**32
_ZERO = np.float32(0.0)
_NEAR_EDGE = 1e-9  # difference of cosines within which angles are compared


@kernel
def apply_noise(
    width,
    axes,
    entries,
    first,
    last,
    moves,
    errors,
    slots,
    in_order,
    links,
    seeds,
    episodes,
    robots,
    environments,
    listed,
    weights,
    counts,
    keys,
    words,
    rows,
):
    """Drop and rotate rows of neighbours by a table of ``Imperfections``.

    It may be repeated for the same step: the random numbers are a function of the step number.

    Rows of ``slots`` neighbours are in the order of links if ``in_order``, else in that of robots.
    Working memory: listed (2, E), weights (E,), counts (n,), keys (2, L), words (3, 4, L).
    """
    n = robots.shape[1]
    for block in range(first, last):
        sensing_keys(width, block, moves, seeds, episodes, environments[block], keys)
        found = list_pairs(links, block, n, listed[0], listed[1], weights)
        counts[:] = 0
        for e in range(found):
            ends = listed[0, e], listed[1, e]
            one, other = errors_of(errors, ends[0]), errors_of(errors, ends[1])
            _draw(width, axes, pair_index(ends[0], ends[1], n), one, other, keys, words)
            for side in range(2):
                i, j, slot = end_of(links, block, n, ends, side, slots, in_order, counts)
                if slot >= 0:
                    own, row = errors_of(errors, i), rows[block - first, i, slot]
                    _hide(width, axes, entries, own, robots[block, i], robots[block, j], row)
                    if own.dropout > 0.0:
                        _miss(width, axes, own.dropout, words[_MISSED, side], row)
                    _turn_by_errors(width, axes, side, own, words, row)


@inner_kernel(inline="code")
def end_of(links, block, n, ends, side, slots, in_order, counts):
    """Robot i at one side of a pair, the other robot j, and the slot of j among the rows of i.

    The slot is −1 if robot i has no row for j. Robots are visited in the order of ``list_pairs``;
    ``counts``, (n,), are their links so far.
    """
    i, j = (ends[1], ends[0]) if side else ends
    if not edge_weight(links, block, n, i, j, 1.0) > 0.0:
        return i, j, -1
    slot = counts[i] if in_order else j - (j > i)
    counts[i] += 1
    return i, j, (slot if slot < slots or not in_order else -1)


@inner_kernel
def sensing_keys(width, block, moves, seeds, episodes, environment, keys):
    """Keys of the sensing streams: of the episode, and of the step."""
    lanes = lane_count(width)
    for lane in range(min(lanes, len(seeds) - block * lanes)):
        key = stream_key(seeds[block * lanes + lane], episodes[block * lanes + lane], SENSING)
        keys[EPISODE_KEYS, lane] = key
        keys[STEP_KEYS, lane] = step_key(key, sensed_step(environment, lane, lanes, moves))


@inner_kernel(inline="code")
def _draw(width, axes, couple, one, other, keys, words):
    """Random words of a couple, for alternating sides: words[purpose, side].

    Given are the errors of both sides. In 3-D, words[purpose, 2 + side] is the other half of the
    same words.
    """
    first = couple * DRAWS
    if max(one.bias, other.bias) > 0.0:
        _draw_turns(width, axes, keys[EPISODE_KEYS], first, words[_BIAS])
    if max(one.noise, other.noise) > 0.0:
        _draw_turns(width, axes, keys[STEP_KEYS], first, words[_NOISE])
    if max(one.dropout, other.dropout) > 0.0:
        halve(width, keys[STEP_KEYS], first + 2, words[_MISSED, 0], words[_MISSED, 1])


@inner_kernel(inline="code")
def _draw_turns(width, axes, keys, first, words):
    """Random words for the rotation of a couple's two rows: one in 2-D, two in 3-D."""
    if len(axes) == 2:
        halve(width, keys, first, words[0], words[1])
    else:
        halve(width, keys, first, words[0], words[2])
        halve(width, keys, first + 1, words[1], words[3])


@inner_kernel
def halve(width, keys, counter, upper, lower):
    """Both halves of a word of every lane's stream."""
    for lane in range(lane_count(width)):
        word = word_of(keys[lane], counter)
        upper[lane], lower[lane] = np.uint32(word >> _UPPER_HALF), np.uint32(word)


@inner_kernel
def _turn_row(width, axes, deviation, words, others, row):
    """Rotate a row (L·d,) of every lane by an angle of this standard deviation, rad."""
    deviation = np.float32(deviation)
    if is_small(deviation):
        _turn_by(width, axes, deviation, True, words, others, row)
    else:
        _turn_by(width, axes, deviation, False, words, others, row)


@inner_kernel(inline="code")
def _turn_by(width, axes, deviation, small, words, others, row):
    for lane in range(lane_count(width)):
        seen = read_row(row, lane, axes)
        turned = turned_by_chance(seen, deviation, small, words[lane], others[lane])
        write_row(turned, row, lane)


@inner_kernel(inline="code")
def _turn_by_errors(width, axes, side, errors, words, row):
    """Rotate a row of one side of a couple by its episode bias and its step noise."""
    _turn_side(width, axes, side, errors.bias, words[_BIAS], row)
    _turn_side(width, axes, side, errors.noise, words[_NOISE], row)


@inner_kernel(inline="code")
def _turn_side(width, axes, side, deviation, words, row):
    """Rotate a row of one side of a couple, whose words are (4, L), by a deviation, rad."""
    if deviation > 0.0:
        _turn_row(width, axes, deviation, words[side], words[2 + side], row)


@inner_kernel(inline="code")
def _hide(width, axes, entries, errors, robot, other, row):
    """Drop the row of a robot out of range or outside the field of view of another one."""
    if errors.half_field < math.pi:
        view = errors.half_field, errors.view_cosine
        _see_within(width, axes, entries, errors.reach, view, robot, other, row)
    elif errors.reach < np.inf:
        # without an angle it becomes SIMD
        _see_within(width, axes, entries, errors.reach, (math.pi, -1.0), robot, other, row)


@inner_kernel(inline="code")
def _see_within(width, axes, entries, reach, view, robot, other, row):
    """``is_seen`` in every lane; angles only if one of them may be at the edge of the view.

    The view is half its angle, rad, and the cosine.
    """
    lanes, (half_field, cosine) = lane_count(width), view
    if half_field < math.pi and _none_at_edge(width, axes, entries, cosine, robot, other):
        for lane in range(lanes):
            here = load_fields(robot, 0, lane, lanes, axes)
            offset = subtract(load_fields(other, 0, lane, lanes, axes), here)
            frame = load_fields(robot, len(axes), lane, lanes, entries)
            square, x = dot(offset, offset), to_local(frame, offset)[0]
            keep((square <= reach * reach) & (x >= cosine * math.sqrt(square)), axes, row, lane)
    else:
        for lane in range(lanes):
            here = load_fields(robot, 0, lane, lanes, axes)
            offset = subtract(load_fields(other, 0, lane, lanes, axes), here)
            frame = load_fields(robot, len(axes), lane, lanes, entries)
            keep(is_seen(offset, frame, reach, half_field), axes, row, lane)


@inner_kernel(inline="code")
def _none_at_edge(width, axes, entries, cosine, robot, other):
    """True if the other robot is clear of the edge of the view in all lanes.

    Rounding then cannot change whether it is inside: angles differ at least as much as their
    cosines.
    """
    lanes, close = lane_count(width), 0.0
    for lane in range(lanes):
        here = load_fields(robot, 0, lane, lanes, axes)
        offset = subtract(load_fields(other, 0, lane, lanes, axes), here)
        frame = load_fields(robot, len(axes), lane, lanes, entries)
        length = norm(offset)
        gap = abs(to_local(frame, offset)[0] - cosine * length)
        clear = (gap > _NEAR_EDGE * length) | (length == 0.0)  # unused lanes are zero
        close = max(close, 0.0 if clear else 1.0)
    return close == 0.0


@inner_kernel(inline="code")
def _miss(width, axes, chance, words, row):
    """Drop a row in the lanes with the lowest words."""
    highest = highest_word(chance)
    for lane in range(lane_count(width)):
        keep(words[lane] > highest, axes, row, lane)


@inner_kernel(inline="code")
def highest_word(chance):
    """Highest of the 32-bit words that occur with this probability, > 0, from zero on."""
    return np.uint32(math.ceil(chance * _WORDS) - 1)


@inner_kernel(inline="code")
def keep(there, axes, row, lane):
    """Set a lane of a row to zero unless it is present."""
    for k in range(len(axes)):
        value = row[len(axes) * lane + k]
        row[len(axes) * lane + k] = value if there else _ZERO


@kernel
def apply_noise_to_silhouettes(
    width,
    axes,
    first,
    last,
    moves,
    errors,
    own,
    points,
    seeds,
    episodes,
    environments,
    keys,
    words,
    rows,
):
    """Apply field of view and rotation to angular extents of obstacles.

    They have ``points`` rows each from the row ``own`` on. Working memory as ``apply_noise``.
    """
    lanes, n = lane_count(width), rows.shape[1]
    slots = (rows.shape[2] - own) // points  # a remaining row is proprioception
    for block in range(first, last):
        count = min(lanes, len(seeds) - block * lanes)
        sensing_keys(width, block, moves, seeds, episodes, environments[block], keys)
        for i in range(n):
            sensor = errors_of(errors, i)
            turns = sensor.bias > 0.0 or sensor.noise > 0.0
            for m in range(slots):
                seen = rows[block - first, i, own + m * points : own + (m + 1) * points]
                if sensor.half_field < math.pi:
                    _see_in_view(axes, count, sensor.half_field, seen)
                for side in range(points if turns else 0):
                    if side % 2 == 0:
                        couple = n * (n - 1) // 2 + ((i * slots + m) * points + side) // 2
                        _draw(width, axes, couple, sensor, sensor, keys, words)
                    _turn_by_errors(width, axes, side % 2, sensor, words, seen[side])


@kernel
def round_silhouettes(width, axes, first, last, errors, own, points, batch, rows):
    """Round angular extents of obstacles to the sectors of their observer.

    They have ``points`` rows each from the row ``own`` on, in ``batch`` environments.
    """
    lanes = lane_count(width)
    end = own + (rows.shape[2] - own) // points * points
    for block in range(first, last):
        for i in range(rows.shape[1]):
            sectors = errors_of(errors, i).sectors
            for number in range(own, end if sectors > 0.0 else own):
                row = rows[block - first, i, number]
                for lane in range(min(lanes, batch - block * lanes)):
                    write_row(in_sectors(exactly(read_row(row, lane, axes)), sectors), row, lane)


@inner_kernel
def _see_in_view(axes, count, half_field, rows):
    """Keep all points of an obstacle if one of them is in the field of view."""
    for lane in range(count):
        seen = False
        for s in range(rows.shape[0]):
            point = exactly(read_row(rows[s], lane, axes))
            seen = seen or (dot(point, point) > 0.0 and is_in_view(point, half_field))
        for s in range(rows.shape[0]):
            keep(seen, axes, rows[s], lane)
