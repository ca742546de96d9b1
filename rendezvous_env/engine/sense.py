"""The stage that looks: what the robots of a block see, V, and who is closest."""

from typing import Any

import numpy as np

from ..compilation import chosen_by_type, inlined_kernel, inner_kernel, unfolded_kernel
from ..equations.bearings import observed, sighting
from ..equations.robots.motion import sense_oneself
from .changing_links import bring_links_up
from .link_kinds import Arcs, ListedLinks, PairLinks
from .memory import SQUARE_CLOSEST, lane_count, read, write
from .sense_arcs import sense_arcs
from .sense_obstacles import sense_obstacles
from .sensors import err


@unfolded_kernel
def sense_block(
    block,
    count,
    layout,
    constants,
    robot,
    sensor,
    moves,
    teams,
    links,
    obstacles,
    results,
    buffers,
    hand,
):
    """Write a block's observations and clearances, and who is closest; half of V is left in
    ``buffers.pair``.
    """
    lanes = lane_count(layout.width)
    first = block * lanes
    buffers.pair[:lanes] = 0.0
    buffers.pair[lanes : 2 * lanes] = np.inf
    bring_links_up(block, layout, constants, moves, teams, links)
    _sense_neighbours(block, layout, constants, teams, links, results, buffers, hand)
    for lane in range(lanes):
        teams.statistics[block, SQUARE_CLOSEST * lanes + lane] = buffers.pair[lanes + lane]
    sense_obstacles(
        block, count, layout, constants, teams, links, obstacles, results, buffers, hand
    )
    _sense_oneself(block, count, layout, robot, teams, buffers)
    observations = results.whole_rows[first : first + count]
    _give_out(block, layout, constants, links, buffers.whole_rows, observations, results, hand)
    err(sensor, block, count, layout, constants, moves, teams, links, obstacles, results, hand)


# ---- neighbours ---------------------------------------------------------------------------------


def _sense_neighbours(
    block: int,
    layout: Any,
    constants: Any,
    teams: Any,
    links: Any,
    results: Any,
    buffers: Any,
    hand: Any,
) -> None:
    chosen = _SENSE[type(links)]
    chosen(block, layout, constants, teams, links, results, buffers, hand)


@chosen_by_type(_sense_neighbours)
def _compiled_sense_neighbours(block, layout, constants, teams, links, results, buffers, hand):
    chosen = _SENSE[links.instance_class]
    return lambda block, layout, constants, teams, links, results, buffers, hand: chosen(
        block, layout, constants, teams, links, results, buffers, hand
    )


@inlined_kernel
def _sense_pairs(block, layout, constants, teams, links, results, buffers, hand):
    """Every pair once, in index order; a link that is absent weighs 0."""
    positions, frames = teams.positions[block], teams.frames[block]
    d, lanes, n = len(layout.axes), lane_count(layout.width), positions.shape[0]
    rows = buffers.rows.shape[0] // n
    pair, offset = 0, buffers.pair[2 * lanes :]
    factor_ij, factor_ji = buffers.pair[(2 + d) * lanes :], buffers.pair[(3 + d) * lanes :]
    for i in range(n):
        for j in range(i + 1, n):
            _sight(layout, positions[i], positions[j], links.weights[block, pair], buffers.pair)
            # in index order robot j is row j − 1 of robot i < j, and robot i is row i of robot j
            _store_row(layout, offset, factor_ij, frames[i], buffers.rows[i * rows + j - 1])
            _store_row(layout, offset, factor_ji, frames[j], buffers.rows[j * rows + i])
            pair += 1


@inlined_kernel
def _sight(layout, position_i, position_j, gain, out):
    """``sighting`` of two robots in every lane.

    Args:
        layout: of the memory.
        position_i: (d·L,), m.
        position_j: (d·L,), m.
        gain: (L,), a_ij, m/s.
        out: the sum of a_ij ‖p_j − p_i‖, which grows, and the least ‖p_j − p_i‖² of neighbours,
            which falls; then p_j − p_i, the factor of a_ij g_ij, and that of a_ij g_ji.
    """
    d, lanes = len(layout.axes), lane_count(layout.width)
    for lane in range(lanes):
        offset, square, distance, factor = sighting(
            read(position_i, lane, layout.width, layout.axes),
            read(position_j, lane, layout.width, layout.axes),
            gain[lane],
        )
        write(offset, out, 2, lane, layout.width)
        least = out[lanes + lane]
        out[lane] += gain[lane] * distance
        out[lanes + lane] = square if (gain[lane] > 0.0) & (square < least) else least
        out[(2 + d) * lanes + lane] = factor
        out[(3 + d) * lanes + lane] = -factor


@inlined_kernel
def _store_row(layout, vector, factor, frame, row):
    """Write one row of observations in every lane.

    Args:
        layout: of the memory.
        vector: (d·L,), of the global frame.
        factor: (L,).
        frame: d² numbers.
        row: (d·L,) float32, the d numbers of a lane side by side.
    """
    for lane in range(lane_count(layout.width)):
        seen = observed(
            read(frame, lane, layout.width, layout.entries),
            read(vector, lane, layout.width, layout.axes),
            factor[lane],
        )
        _put(seen, lane, row)


@inlined_kernel
def _put(seen, lane, row):
    """Put a pair or triple into one lane of a row of observations."""
    if len(seen) == 2:
        row[2 * lane], row[2 * lane + 1] = seen
    else:
        row[3 * lane], row[3 * lane + 1], row[3 * lane + 2] = seen


@inlined_kernel
def _sense_list(block, layout, constants, teams, links, results, buffers, hand):
    """Every link of one team once, in the order of its robots, which is that of the rows."""
    width = layout.width
    n, slots = hand.lengths.shape[0], constants.neighbour_slots
    rows = buffers.rows.shape[0] // n
    buffers.rows[:] = 0.0
    hand.counts[:] = 0
    for e in range(links.first.shape[1]):
        gain = links.weights[block, e]
        if gain <= 0.0:
            continue
        i, j = links.first[block, e], links.second[block, e]
        offset, square, distance, factor = sighting(
            read(teams.positions[block, i], 0, width, layout.axes),
            read(teams.positions[block, j], 0, width, layout.axes),
            gain,
        )
        buffers.pair[0] += gain * distance
        buffers.pair[1] = min(buffers.pair[1], square)
        for end in range(2):
            robot = j if end else i
            slot = hand.counts[robot]
            if slot >= slots:
                results.crowded[block] = robot
                continue
            hand.counts[robot] = slot + 1
            frame = read(teams.frames[block, robot], 0, width, layout.entries)
            seen = observed(frame, offset, -factor if end else factor)
            _put(seen, 0, buffers.rows[robot * rows + slot])


_SENSE = {PairLinks: _sense_pairs, ListedLinks: _sense_list, Arcs: sense_arcs}


# ---- oneself ------------------------------------------------------------------------------------


@inlined_kernel
def _sense_oneself(block, count, layout, robot, teams, buffers):
    """The last row of models that sense something of themselves; zero for robots that are gone."""
    lanes, n = lane_count(layout.width), buffers.action.shape[0]
    rows = buffers.rows.shape[0] // n
    for i in range(n):
        for lane in range(count):
            seen = sense_oneself(
                robot.model,
                read(teams.frames[block, i], lane, layout.width, layout.entries),
                read(teams.memory[block, i], lane, layout.width, robot.memories),
            )
            active = teams.merged_into[block * lanes + lane, i] == i
            _store_oneself(seen, active, lane, buffers.rows[(i + 1) * rows - 1])


@inlined_kernel
def _store_oneself(seen, active, lane, row):
    if len(seen) == 2:
        row[2 * lane] = seen[0] if active else 0.0
        row[2 * lane + 1] = seen[1] if active else 0.0
    elif len(seen) == 3:
        for k in range(3):
            row[3 * lane + k] = seen[k] if active else 0.0


# ---- from lanes to teams ------------------------------------------------------------------------


def _give_out(
    block: int,
    layout: Any,
    constants: Any,
    links: Any,
    rows: Any,
    observations: Any,
    results: Any,
    hand: Any,
) -> None:
    """Copy the rows of all lanes into observations (count, numbers)."""
    chosen = _copy_or_pack if isinstance(links, PairLinks) else _copy_rows
    chosen(block, layout, constants, links, rows, observations, results, hand)


@chosen_by_type(_give_out)
def _compiled_give_out(block, layout, constants, links, rows, observations, results, hand):
    chosen = _copy_or_pack if links.instance_class is PairLinks else _copy_rows
    return lambda block, layout, constants, links, rows, observations, results, hand: chosen(
        block, layout, constants, links, rows, observations, results, hand
    )


@inlined_kernel
def _copy_or_pack(block, layout, constants, links, rows, observations, results, hand):
    if rows.shape[0] == hand.lengths.shape[0] * constants.rows:
        _copy_rows(block, layout, constants, links, rows, observations, results, hand)
    else:
        _pack_rows(block, layout, constants, links, rows, observations, results, hand)


@inlined_kernel
def _copy_rows(block, layout, constants, links, rows, observations, results, hand):
    parts = 1 if len(layout.axes) == 2 else 3  # see ``Lanes.whole_rows``
    for k in range(rows.shape[0]):
        for lane in range(observations.shape[0]):
            for part in range(parts):
                observations[lane, k * parts + part] = rows[k, lane * parts + part]


@inner_kernel
def _pack_rows(block, layout, constants, links, rows, observations, results, hand):
    """The same where there are fewer neighbour rows than other robots: those present stand first,
    in index order.
    """
    lanes, n = lane_count(layout.width), hand.lengths.shape[0]
    parts, wide = rows.shape[1] // lanes, rows.shape[0] // n
    slots, own = constants.neighbour_slots, constants.rows
    observations[:] = 0.0
    for lane in range(observations.shape[0]):
        hand.counts[:] = 0
        for pair in range(links.first.shape[0]):
            if links.weights[block, pair, lane] > 0.0:
                i, j = links.first[pair], links.second[pair]
                for end in range(2):
                    robot, slot = (j, i) if end else (i, j - 1)
                    place = hand.counts[robot]
                    hand.counts[robot] = place + 1
                    if place >= slots:
                        results.crowded[block * lanes + lane] = robot
                        continue
                    for part in range(parts):
                        number = (robot * own + place) * parts + part
                        row = robot * wide + slot
                        observations[lane, number] = rows[row, lane * parts + part]
        for robot in range(n):
            for k in range(own - slots):
                for part in range(parts):
                    number = (robot * own + slots + k) * parts + part
                    row = robot * wide + n - 1 + k
                    observations[lane, number] = rows[row, lane * parts + part]
