"""What range, view and chance make of the exact rows of a block, before they are given out.

All teams of a block at once: loops over lanes become SIMD. A *couple* is what shares the words of a
stream: the rows that two robots see of each other, or two silhouette points side by side.
"""

import math

import numpy as np

from ...compilation import by_type, inner_kernel
from ...graphs.edges import DenseEdges, arcs_of, load_links, pair_index
from ...physics.random_streams import SENSING, stream_key, word_of
from ...physics.vectors import dot, exactly, subtract
from ...sensors.chance import is_small, step_key, turned_by_chance
from ...sensors.imperfections import in_sectors, is_in_view, is_seen
from ..memory import first_row, lane_count, read, read_row, statistics_of, step_seen, write_row

_EPISODE, _STEP = range(2)
"""Keys: of a team's episode, and of its step."""
_BIAS, _NOISE, _MISSED = range(3)
"""What is drawn for a couple."""
_DRAWS = 3
"""Words of a stream for one couple: two to turn it (one in the plane), one for what is missed."""
_UPPER_HALF, _WORDS = np.uint64(32), 2.0**32
_ZERO = np.float32(0.0)


@inner_kernel
def sense_by_chance(sensor, block, setup, moves, state, scratch):
    """Let rows of a block be missed, and turn them; nothing if the sensor is exact.

    It may be done again for the same step: what is drawn follows from the number of the step.
    """
    if sensor is not None:
        _begin(sensor, block, state.teams, moves, scratch.block.keys)
        if sensor.in_lanes:
            found = _list_pairs(block.index, state.links, scratch.team)
            _see_neighbours(found, block.index, setup, sensor, state.teams, state.links, scratch)
        _see_points(block, setup, sensor.errors, scratch)


@inner_kernel
def _begin(sensor, block, teams, moves, keys):
    """The keys of the streams of sensing."""
    first, last = block.first, block.first + block.count
    seeds, episodes = sensor.seeds[first:last], sensor.episodes[first:last]
    statistics = statistics_of(teams, block.index)
    for lane in range(len(seeds)):
        key = stream_key(seeds[lane], episodes[lane], SENSING)
        keys[_EPISODE, lane] = key
        keys[_STEP, lane] = step_key(key, step_seen(statistics, lane, moves))


@inner_kernel(inline="code")
def _draw(layout, couple, errors, keys, words):
    """What a sensor needs for a couple, of the two sides in turn: words[what, side], and in space
    the other half of the same words, words[what, 2 + side].
    """
    first = couple * _DRAWS
    if errors.bias > 0.0:
        _draw_turns(layout, keys[_EPISODE], first, words[_BIAS])
    if errors.noise > 0.0:
        _draw_turns(layout, keys[_STEP], first, words[_NOISE])
    if errors.dropout > 0.0:
        _halve(layout, keys[_STEP], first + 2, words[_MISSED, 0], words[_MISSED, 1])


@inner_kernel(inline="code")
def _draw_turns(layout, keys, first, words):
    if len(layout.axes) == 2:
        _halve(layout, keys, first, words[0], words[1])
    else:
        _halve(layout, keys, first, words[0], words[2])
        _halve(layout, keys, first + 1, words[1], words[3])


@inner_kernel
def _halve(layout, keys, counter, upper, lower):
    """Both halves of a word of every lane's stream."""
    for lane in range(lane_count(layout.width)):
        word = word_of(keys[lane], counter)
        upper[lane], lower[lane] = np.uint32(word >> _UPPER_HALF), np.uint32(word)


@inner_kernel
def _turn(layout, deviation, words, others, row):
    """Turn a row (L·d,) of every lane by an angle of this standard deviation, rad."""
    deviation = np.float32(deviation)
    if is_small(deviation):
        _turn_by(layout, deviation, True, words, others, row)
    else:
        _turn_by(layout, deviation, False, words, others, row)


@inner_kernel(inline="code")
def _turn_by(layout, deviation, small, words, others, row):
    for lane in range(lane_count(layout.width)):
        seen = read_row(row, lane, layout.axes)
        turned = turned_by_chance(seen, deviation, small, words[lane], others[lane])
        write_row(turned, row, lane)


@inner_kernel(inline="code")
def _turn_side(layout, side, errors, words, row):
    """Turn a row of one side of a couple by its bias of the episode and its noise of the step."""
    if errors.bias > 0.0:
        _turn(layout, errors.bias, words[_BIAS, side], words[_BIAS, 2 + side], row)
    if errors.noise > 0.0:
        _turn(layout, errors.noise, words[_NOISE, side], words[_NOISE, 2 + side], row)


@inner_kernel(inline="code")
def _all_pairs(block, links, scratch):
    for e in range(links.first.shape[0]):
        scratch.first[e], scratch.second[e] = links.first[e], links.second[e]
    return links.first.shape[0]


@inner_kernel(inline="code")
def _linked_pairs(block, links, scratch):
    return load_links(block, 0, links, scratch)


@by_type("links", lambda kind: _all_pairs if kind is DenseEdges else _linked_pairs)
def _list_pairs(block, links, scratch):
    """List the pairs that have rows in a block, in the order of these; how many there are."""


@inner_kernel
def _see_neighbours(found, block, setup, sensor, teams, links, scratch):
    """Both rows of every pair in the list; of a one-way link one."""
    layout, slots, rows = setup.layout, setup.constants.neighbour_slots, scratch.block.rows
    n, counts, errors = rows.shape[0], scratch.team.counts, sensor.errors
    counts[:] = 0
    for e in range(found):
        first, second = scratch.team.first[e], scratch.team.second[e]
        _draw(layout, pair_index(first, second, n), errors, scratch.block.keys, scratch.block.words)
        for side in range(2):
            i, j = (second, first) if side else (first, second)
            if gain_of(arcs_of(links, block), i, j, 1.0) > 0.0:
                slot = counts[i] if sensor.listed else j - (j > i)
                counts[i] += 1
                if slot < slots or not sensor.listed:
                    row = rows[i, slot]
                    _hide(layout, errors, teams, block, (i, j), row)
                    if errors.dropout > 0.0:
                        _miss(layout, errors.dropout, scratch.block.words[_MISSED, side], row)
                    _turn_side(layout, side, errors, scratch.block.words, row)


@inner_kernel(inline="code")
def gain_of(arcs, i, j, weight):
    """What robot i gives to robot j that a link joins: its weight, or that of the arc."""
    if arcs is not None:
        return arcs.weights[i, j]
    return weight


@inner_kernel(inline="code")
def _hide(layout, errors, teams, block, pair, row):
    """Drop the row of a robot j that is out of range or of the field of view of robot i."""
    places = teams.positions[block, pair[0]], teams.positions[block, pair[1]]
    if errors.half_field < math.pi:
        _see_within(
            layout, errors.reach, errors.half_field, places, teams.frames[block, pair[0]], row
        )
    elif errors.reach < np.inf:
        # without an angle it becomes SIMD
        _see_within(layout, errors.reach, math.pi, places, teams.frames[block, pair[0]], row)


@inner_kernel(inline="code")
def _see_within(layout, reach, half_field, places, frame, row):
    for lane in range(lane_count(layout.width)):
        here, there = read(places[0], lane, layout.axes), read(places[1], lane, layout.axes)
        offset, local = subtract(there, here), read(frame, lane, layout.entries)
        _keep(is_seen(offset, local, reach, half_field), layout, row, lane)


@inner_kernel(inline="code")
def _miss(layout, chance, words, row):
    """Drop a row of the lanes whose words are among the lowest."""
    highest = np.uint32(math.ceil(chance * _WORDS) - 1)
    for lane in range(lane_count(layout.width)):
        _keep(words[lane] > highest, layout, row, lane)


@inner_kernel(inline="code")
def _keep(there, layout, row, lane):
    """Make a lane of a row zero unless it is there."""
    for k in range(len(layout.axes)):
        value = row[len(layout.axes) * lane + k]
        row[len(layout.axes) * lane + k] = value if there else _ZERO


@inner_kernel
def _see_points(block, setup, errors, scratch):
    """Silhouettes, in the field of view, turned, and rounded."""
    rows, layout, words = scratch.block.rows, setup.layout, scratch.block.words
    n, points = rows.shape[0], scratch.team.silhouette.shape[0]
    own = first_row(setup.constants, rows)
    slots = (rows.shape[1] - own) // points  # what is left over is a row of oneself
    turns = errors.bias > 0.0 or errors.noise > 0.0
    for i in range(n):
        for m in range(slots):
            seen = rows[i, own + m * points : own + (m + 1) * points]
            if errors.half_field < math.pi:
                _see_in_view(block.count, errors.half_field, layout, seen)
            for side in range(points if turns else 0):
                if side % 2 == 0:
                    couple = n * (n - 1) // 2 + ((i * slots + m) * points + side) // 2
                    _draw(layout, couple, errors, scratch.block.keys, words)
                _turn_side(layout, side % 2, errors, words, seen[side])
            for s in range(points if errors.sectors > 0 else 0):
                for lane in range(block.count):
                    point = exactly(read_row(seen[s], lane, layout.axes))
                    write_row(in_sectors(point, errors.sectors), seen[s], lane)


@inner_kernel
def _see_in_view(count, half_field, layout, rows):
    """An obstacle is seen with all its points as soon as one of them is in the field of view."""
    for lane in range(count):
        seen = False
        for s in range(rows.shape[0]):
            point = exactly(read_row(rows[s], lane, layout.axes))
            seen = seen or (dot(point, point) > 0.0 and is_in_view(point, half_field))
        for s in range(rows.shape[0]):
            _keep(seen, layout, rows[s], lane)
