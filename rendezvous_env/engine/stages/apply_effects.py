"""The stages of what measured sensors do besides: blind zone, detection, errors with a memory or of
one robot, outliers. They follow ``apply_noise`` and work as it does, over lanes.
"""

import math

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.edges import DENSE, edge_weight, load_links, pair_index
from ...physics.random_streams import SENSING, stream_key, word_of
from ...physics.vectors import norm, scaled, subtract, to_local
from ...sensors.chance import (
    cosine_and_sine,
    gaussian,
    is_small,
    step_key,
    turned_by_angle,
    turned_by_chance,
)
from ...sensors.effects import distance_of, share_in_view, turned_about, unit_number
from ..memory import lane_count, load_fields, read_row, sensed_step, write_row
from .remember import DETECTED, DRIFTED, OBSERVER, OUTLIER, part_keys

_DETECTS, _TURNS, _REPLACES = range(3)
"""What is done to a row, in this order."""
_DRAWS = 3
"""Words of the stream of white noise for one couple, as ``apply_noise`` has them."""
_UPPER_HALF, _WORDS = np.uint64(32), 2.0**32
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
    chances,
    rows,
):
    """Drop rows of neighbours that are not detected, turn the others, and replace some. Rows are as
    ``apply_noise`` has them; ``latent`` and ``errors`` are the memories of ``remember``. Working
    memory: listed (2, E), weights (E,), counts (n,), keys (2, L), words (3, 4, L), chances (≥ L,).
    """
    n = robots.shape[1]
    for block in range(first, last):
        found = links.first.shape[1]
        if links.form == DENSE:
            for e in range(found):
                listed[0, e], listed[1, e] = links.first[0, e], links.second[0, e]
        else:
            found = load_links(links, block, 0, n, listed[0], listed[1], weights)
        for purpose in range(3):
            if not _is_called_for(effects, purpose):
                continue
            streams = seeds, episodes, environments[block]
            _begin(width, block, moves, purpose, effects, streams, keys)
            counts[:] = 0
            for end in range(2 * found):
                one, other = listed[0, end // 2], listed[1, end // 2]
                i, j = (other, one) if end % 2 else (one, other)
                if edge_weight(links, block, n, i, j, 1.0) > 0.0:
                    slot = counts[i] if in_order else j - (j > i)
                    counts[i] += 1
                    if slot < slots or not in_order:
                        couple, row = pair_index(one, other, n), rows[block - first, i, slot]
                        pair, place = (robots[block, i], robots[block, j]), (couple, end % 2)
                        now = moves, environments[block], keys
                        if purpose == _DETECTS:
                            _find_chances(width, axes, entries, effects, pair, chances)
                            _detect(width, axes, effects, place, now, latent[block], chances, row)
                        elif purpose == _TURNS:
                            memory = 2 * couple + end % 2, errors[block], words
                            _turn(width, axes, effects, i, place, now, memory, row)
                        else:
                            team = block, merged_into, robots
                            _replace(width, axes, entries, effects, (i, j), place, team, keys, row)


@inner_kernel
def _is_called_for(effects, purpose):
    if purpose == _DETECTS:
        return effects.nearest > 0.0 or effects.detects
    return effects.turns if purpose == _TURNS else effects.outliers > 0.0


@inner_kernel
def _begin(width, block, moves, purpose, effects, streams, keys):
    """The keys of what is drawn for a purpose; of white noise those of ``apply_noise``."""
    lanes, (seeds, episodes, environment) = lane_count(width), streams
    if purpose == _TURNS and not effects.drifts:
        for lane in range(min(lanes, len(seeds) - block * lanes)):
            key = stream_key(seeds[block * lanes + lane], episodes[block * lanes + lane], SENSING)
            keys[0, lane] = key
            keys[1, lane] = step_key(key, sensed_step(environment, lane, lanes, moves))
    else:
        part = DETECTED if purpose == _DETECTS else DRIFTED if purpose == _TURNS else OUTLIER
        part_keys(width, block, moves, part, seeds, episodes, environment, keys)


@inner_kernel
def _find_chances(width, axes, entries, effects, pair, chances):
    """The probability of detection of one robot by another in every lane."""
    lanes, d, (robot, other) = lane_count(width), len(axes), pair
    distances, table = effects.distances, effects.chances
    for lane in range(lanes):
        here = load_fields(robot, 0, lane, lanes, axes)
        distance = distance_of(here, load_fields(other, 0, lane, lanes, axes))
        chance = table[0]
        for k in range(len(distances) - 1):
            share = (distance - distances[k]) / (distances[k + 1] - distances[k])
            chance = chance + min(max(share, 0.0), 1.0) * (table[k + 1] - table[k])
        chances[lane] = 0.0 if distance < effects.nearest else chance
    if effects.falloff > 0.0:
        for lane in range(lanes):
            here = load_fields(robot, 0, lane, lanes, axes)
            offset = subtract(load_fields(other, 0, lane, lanes, axes), here)
            frame = load_fields(robot, d, lane, lanes, entries)
            chances[lane] *= share_in_view(offset, frame, effects.half_field, effects.falloff)


@inner_kernel
def _detect(width, axes, effects, place, now, latent, chances, row):
    """Drop a row of the lanes in which the neighbour is not detected."""
    lanes, number, (moves, environment, keys) = lane_count(width), 2 * place[0] + place[1], now
    for lane in range(lanes):
        seen = chances[lane] > 0.0
        if effects.remembers:
            odd = sensed_step(environment, lane, lanes, moves) & 1
            seen = latent[odd, number, lane] < chances[lane]
        elif effects.detects:
            seen = unit_number(np.uint32(word_of(keys[1, lane], number))) < chances[lane]
        for k in range(len(axes)):
            value = row[len(axes) * lane + k]
            row[len(axes) * lane + k] = value if seen else _ZERO


@inner_kernel
def _turn(width, axes, effects, i, place, now, memory, row):
    """Turn a row by the noise of robot i: white as in ``apply_noise``, or by its memory. ``place``
    are couple and side; ``memory`` the number of the row, what is kept, and words.
    """
    level, (number, errors, words) = effects.levels[i], memory
    moves, environment, keys = now
    if level > 0.0 and effects.drifts:
        lanes = lane_count(width)
        for lane in range(lanes):
            odd = sensed_step(environment, lane, lanes, moves) & 1
            angle = level * errors[odd, number, lane]
            other = np.uint32(word_of(keys[0, lane], number))
            write_row(turned_by_angle(read_row(row, lane, axes), angle, False, other), row, lane)
    elif level > 0.0:
        _draw_white(width, axes, place, keys, words[1])
        if is_small(level):
            _turn_white(width, axes, level, True, words[1], row)
        else:
            _turn_white(width, axes, level, False, words[1], row)


@inner_kernel
def _draw_white(width, axes, place, keys, words):
    """The words of one side of a couple for white noise, as ``apply_noise`` draws them."""
    couple, side = place
    for lane in range(lane_count(width)):
        if len(axes) == 2:
            word = word_of(keys[1, lane], couple * _DRAWS)
            half = np.uint32(word) if side else np.uint32(word >> _UPPER_HALF)
            words[0, lane], words[1, lane] = half, half
        else:
            word = word_of(keys[1, lane], couple * _DRAWS + side)
            words[0, lane], words[1, lane] = np.uint32(word >> _UPPER_HALF), np.uint32(word)


@inner_kernel(inline="code")
def _turn_white(width, axes, level, small, words, row):
    for lane in range(lane_count(width)):
        seen = read_row(row, lane, axes)
        write_row(turned_by_chance(seen, level, small, words[0, lane], words[1, lane]), row, lane)


@inner_kernel
def _replace(width, axes, entries, effects, pair, place, team, keys, row):
    """Replace a row by an outlier as long as it, in the lanes in which one is drawn."""
    lanes, number, (block, merged_into, robots) = lane_count(width), 2 * place[0] + place[1], team
    highest = np.uint32(math.ceil(effects.outliers * _WORDS) - 1)
    for lane in range(min(lanes, len(merged_into) - block * lanes)):
        if np.uint32(word_of(keys[1, lane], 2 * number) >> _UPPER_HALF) <= highest:
            seen, word = read_row(row, lane, axes), word_of(keys[1, lane], 2 * number + 1)
            length = np.float32(norm(seen))
            if length > 0.0 and effects.uniform:
                write_row(_anywhere(seen, length, word), row, lane)
            elif length > 0.0:
                into = merged_into[block * lanes + lane]
                other = _another(pair, into, unit_number(np.uint32(word)))
                if other >= 0:
                    here, there = robots[block, pair[0]], robots[block, other]
                    _see_instead(axes, entries, here, there, length, lane, lanes, row)


@inner_kernel
def _see_instead(axes, entries, robot, other, length, lane, lanes, row):
    """Let a row of a length be the bearing of another robot; it stays where there is none."""
    here = load_fields(robot, 0, lane, lanes, axes)
    there = load_fields(other, 0, lane, lanes, axes)
    distance = distance_of(here, there)
    if distance > 0.0:
        frame = load_fields(robot, len(axes), lane, lanes, entries)
        bearing = scaled(to_local(frame, subtract(there, here)), length / distance)
        write_row(_as_float32(bearing), row, lane)


@inner_kernel(inline="code")
def _as_float32(v):
    if len(v) == 2:
        return np.float32(v[0]), np.float32(v[1])
    return np.float32(v[0]), np.float32(v[1]), np.float32(v[2])


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
def _another(pair, into, chance):
    """One of the robots that have not merged, other than those of a pair, by a number in [0, 1); −1
    if there is none.
    """
    count, (i, j) = 0, pair
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
    """Noise of silhouettes, ``points`` rows each from the row ``own`` on: that of each robot, and
    with a memory from the place ``start`` on.
    """
    n = rows.shape[1]
    slots = (rows.shape[2] - own) // points  # the remaining row, if any, is of the robot itself
    for block in range(first, last):
        streams = seeds, episodes, environments[block]
        _begin(width, block, moves, _TURNS, effects, streams, keys)
        for i in range(n):
            for number in range(slots * points):
                # as ``apply_noise_to_silhouettes``, in couples
                m, side = number // points, number % points
                couple = n * (n - 1) // 2 + ((i * slots + m) * points + side) // 2
                row, now = rows[block - first, i, own + number], (moves, environments[block], keys)
                memory = start + i * slots * points + number, errors[block], words
                _turn(width, axes, effects, i, (couple, side % 2), now, memory, row)


@kernel
def turn_observers(
    width,
    axes,
    first,
    last,
    moves,
    deviation,
    begin,
    end,
    seeds,
    episodes,
    environments,
    keys,
    turns,
    rows,
):
    """Turn the rows from ``begin`` to ``end`` of each robot by the constant error of its sensor, of
    this standard deviation, rad. Working memory: keys (2, L), turns (≥ 5·L,).
    """
    for block in range(first, last):
        part_keys(width, block, moves, OBSERVER, seeds, episodes, environments[block], keys)
        for i in range(rows.shape[1]):
            _draw_turns(width, axes, np.float32(deviation), i, keys, turns)
            for number in range(begin, end):
                row = rows[block - first, i, number]
                for lane in range(lane_count(width)):
                    seen, turn = read_row(row, lane, axes), _read_turn(width, axes, turns, lane)
                    write_row(turned_about(seen, turn), row, lane)


@inner_kernel(inline="code")
def _draw_turns(width, axes, deviation, i, keys, turns):
    """The rotation of robot i's sensor in every lane: by N(0, σ²) in the plane, and in 3-D by a
    rotation vector of three numbers of N(0, σ²/2).
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
