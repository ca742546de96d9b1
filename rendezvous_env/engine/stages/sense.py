"""The stage that looks: what the robots of a block see, V, and who is closest."""

import numpy as np

from ...compilation import by_type, inner_kernel
from ...graphs.edges import DenseEdges, DirectedEdges, EdgeList, arcs_of
from ...physics.packing import apart
from ...physics.potential import bearing_factor, observed, sighting
from ...robots.motion import proprioception
from ..memory import (
    in_lanes,
    lane_count,
    load_team,
    pair_of,
    read,
    statistics_of,
    write,
    write_row,
)
from ..memory.changing_edges import update_links
from .sense_by_chance import gain_of, sense_by_chance
from .sense_obstacles import sense_obstacles
from .sense_one_by_one import sense_one_by_one

_MANY_ROWS = 256  # which with those of the other lanes no longer fit into the nearest cache


@inner_kernel(inline="text")
def sense_block(block, setup, sensor, moves, state, output, scratch):
    """Write a block's observations and clearances, and who is closest; half of V is left in
    ``scratch.block.pair``.
    """
    found = pair_of(scratch.block.pair, setup.layout.axes)
    found.half_lyapunov[:] = 0.0
    found.square_closest[:] = np.inf
    update_links(block.index, setup, moves, state, state.changes)
    _sense_neighbours(block.index, setup, state.teams, state.links, output.crowded, scratch)
    if setup.constants.packs:
        _leave_out_docked(block, setup.constants, state.teams, scratch)
    square_closest = statistics_of(state.teams, block.index).square_closest
    for lane in range(lane_count(setup.layout.width)):
        square_closest[lane] = found.square_closest[lane]
    sense_obstacles(block, setup, moves, state, state.obstacles, output, scratch)
    _proprioception(block, setup, state.teams, scratch.block.rows)
    sense_by_chance(sensor, block, setup, moves, state, scratch)
    _give_out(block, setup, state.links, output, scratch, setup.layout.packs, setup.layout.axes)
    sense_one_by_one(sensor, block, setup, moves, state, output, scratch.team)


@inner_kernel(inline="code")
def _sense_pairs(block, setup, teams, links, crowded, scratch):
    """Every pair once, in index order; a link that is absent weighs 0."""
    positions, frames, rows = teams.positions[block], teams.frames[block], scratch.block.rows
    layout, pair, e = setup.layout, scratch.block.pair, 0
    for i in range(positions.shape[0]):
        for j in range(i + 1, positions.shape[0]):
            _sight(layout, positions[i], positions[j], links.weights[block, e], pair)
            # in index order robot j is row j − 1 of robot i < j, and robot i is row i of robot j
            _store_row(layout, pair, 1.0, frames[i], rows[i, j - 1])
            _store_row(layout, pair, -1.0, frames[j], rows[j, i])
            e += 1


@inner_kernel(inline="code")
def _sight(layout, position_i, position_j, gain, pair):
    """``sighting`` of two robots in every lane, (d, L) each, into the rows of Pair."""
    if not (
        in_lanes(position_i, layout) and in_lanes(position_j, layout) and in_lanes(pair, layout)
    ):
        return
    found = pair_of(pair, layout.axes)  # here: the rows of one array, which cannot overlap
    for lane in range(lane_count(layout.width)):
        offset, square, distance, factor = sighting(
            read(position_i, lane, layout.axes), read(position_j, lane, layout.axes), gain[lane]
        )
        write(offset, found.offset, lane)
        least = found.square_closest[lane]
        found.half_lyapunov[lane] += gain[lane] * distance
        found.square_closest[lane] = square if (gain[lane] > 0.0) & (square < least) else least
        found.factor[lane] = factor


@inner_kernel(inline="code")
def _store_row(layout, pair, sign, frame, row):
    """Write what one of a Pair sees of the other into a row of observations, in the robots' frames
    (d², L); the sign is −1 for the second one.
    """
    if not (in_lanes(pair, layout) and in_lanes(frame, layout)):
        return
    found = pair_of(pair, layout.axes)
    for lane in range(lane_count(layout.width)):
        local, offset = read(frame, lane, layout.entries), read(found.offset, lane, layout.axes)
        write_row(observed(local, offset, sign * found.factor[lane]), row, lane)


@inner_kernel(inline="code")
def _sense_list(block, setup, teams, links, crowded, scratch):
    """Every link of one team once, in the order of its robots, which is that of the rows."""
    scratch.block.rows[:] = 0.0
    scratch.team.counts[:] = 0
    for e in range(links.first.shape[1]):
        pair, weight = (links.first[block, e], links.second[block, e]), links.weights[block, e]
        if weight > 0.0:
            _sense_link(pair, weight, None, block, setup, teams, crowded, scratch)


@inner_kernel(inline="code")
def _sense_arcs(block, setup, teams, links, crowded, scratch):
    """Every pair of one team in index order, and of its two arcs those that are there."""
    arcs, n = arcs_of(links, block), teams.positions.shape[1]
    scratch.block.rows[:] = 0.0
    scratch.team.counts[:] = 0
    for i in range(n):
        for j in range(i + 1, n):
            weight = 0.5 * (arcs.weights[i, j] + arcs.weights[j, i])
            if weight > 0.0:
                _sense_link((i, j), weight, arcs, block, setup, teams, crowded, scratch)


@inner_kernel(inline="code")
def _sense_link(pair, weight, arcs, block, setup, teams, crowded, scratch):
    """One link or two arcs of one team; ``arcs`` are None if all go both ways."""
    layout, slots, counts = setup.layout, setup.constants.neighbour_slots, scratch.team.counts
    found = pair_of(scratch.block.pair, layout.axes)
    offset, square, distance, _ = sighting(
        read(teams.positions[block, pair[0]], 0, layout.axes),
        read(teams.positions[block, pair[1]], 0, layout.axes),
        weight,
    )
    found.half_lyapunov[0] += weight * distance
    found.square_closest[0] = min(found.square_closest[0], square)
    for end in range(2):
        i, j = (pair[1], pair[0]) if end else pair
        gain = gain_of(arcs, i, j, weight)
        if gain > 0.0:
            slot = _slot_of(arcs, i, j, slots, counts)
            counts[i] += 1
            if slot < slots:
                frame = read(teams.frames[block, i], 0, layout.entries)
                factor = bearing_factor(-gain if end else gain, distance)
                write_row(observed(frame, offset, factor), scratch.block.rows[i, slot], 0)
            else:
                crowded[block] = i


@inner_kernel(inline="code")
def _slot_of(arcs, i, j, slots, counts):
    """Row of robot j in the observation of robot i: the next one; with arcs and a row for each
    other robot its own.
    """
    if arcs is not None:
        if slots == len(counts) - 1:
            return j - (j > i)
    return counts[i]


_SENSE = {DenseEdges: _sense_pairs, EdgeList: _sense_list, DirectedEdges: _sense_arcs}


@by_type("links", _SENSE.__getitem__)
def _sense_neighbours(block, setup, teams, links, crowded, scratch):
    """Write the neighbour rows of a block, add up V, and find who is closest."""


@inner_kernel
def _leave_out_docked(block, constants, teams, scratch):
    """Zero the rows of those whom a body touches, as a link is gone with a merge; who touches all
    others keeps their rows, or it would have nothing to go by.
    """
    positions, n = scratch.team.positions, scratch.team.positions.shape[0]
    # halfway into r: bodies held at the edge of r would count as met now and then, not all at once
    docked = constants.body_radius + 0.5 * constants.merge_radius
    for lane in range(block.count):
        load_team(teams.positions, block.index, lane, positions)
        for i in range(n):
            touched = 0
            for j in range(n):
                touched += j != i and apart(positions, i, j) <= docked
            for j in range(n):
                if touched < n - 1 and j != i and apart(positions, i, j) <= docked:
                    scratch.block.rows[i, j - (j > i), 2 * lane : 2 * lane + 2] = 0.0


@inner_kernel(inline="code")
def _proprioception(block, setup, teams, rows):
    """The last row of models that sense something of themselves; zero for robots that are gone."""
    for i in range(rows.shape[0]):
        for lane in range(block.count):
            seen = proprioception(
                setup.robot.model,
                read(teams.frames[block.index, i], lane, setup.layout.entries),
                read(teams.memory[block.index, i], lane, setup.robot.memories),
            )
            active = teams.merged_into[block.first + lane, i] == i
            _store_oneself(seen, active, rows[i, rows.shape[1] - 1], lane)


@inner_kernel(inline="code")
def _store_oneself(seen, active, row, lane):
    if len(seen) > 0:
        for k in range(len(seen)):
            row[len(seen) * lane + k] = seen[k] if active else 0.0


@inner_kernel(inline="code")
def _give_out(block, setup, links, output, scratch, packs, axes):
    """Copy the rows of all lanes into observations; which way is known while compiling."""
    rows, observations, layout = scratch.block.rows, output.observations, setup.layout
    if packs is not None:
        _pack_rows(block, setup.constants, links, output.crowded, observations, scratch)
    elif len(axes) == 2:  # both numbers of a row in one piece: half as many to copy
        _copy_rows(block, layout, rows.view(np.float64), observations.view(np.float64))
    else:
        _copy_rows(block, layout, rows, observations)


@inner_kernel(inline="code")
def _copy_rows(block, layout, rows, observations):
    n_rows, parts = rows.shape[0] * rows.shape[1], rows.shape[2] // lane_count(layout.width)
    source = rows.reshape(n_rows, rows.shape[2])
    everybody = observations.reshape(observations.shape[0], n_rows * parts)
    target = everybody[block.first : block.first + block.count]
    if n_rows < _MANY_ROWS:
        _copy_together(source, target, parts, 4)
    else:
        _copy_together(source, target, parts, 32)


@inner_kernel(inline="code")
def _copy_together(source, target, parts, count):
    """So many rows of a lane at a time, which lie side by side, and the last few one by one."""
    whole = len(source) - len(source) % count
    for k in range(0, whole, count):
        for lane in range(len(target)):
            for row in range(k, k + count):
                for part in range(parts):
                    target[lane, row * parts + part] = source[row, lane * parts + part]
    for row in range(whole, len(source)):
        for lane in range(len(target)):
            for part in range(parts):
                target[lane, row * parts + part] = source[row, lane * parts + part]


@inner_kernel
def _pack_rows(block, constants, links, crowded, observations, scratch):
    """The same where there are fewer neighbour rows than other robots: those present stand first,
    in index order, and the other rows behind them.
    """
    rows, counts, slots = scratch.block.rows, scratch.team.counts, constants.neighbour_slots
    n, d = rows.shape[0], observations.shape[3]
    for lane in range(block.count):
        seen = observations[block.first + lane]
        seen[:] = 0.0
        counts[:] = 0
        for pair in range(links.first.shape[0]):
            if links.weights[block.index, pair, lane] > 0.0:
                for end in range(2):
                    i, j = links.first[pair], links.second[pair]
                    robot, own = (j, i) if end else (i, j - 1)
                    slot = counts[robot]
                    counts[robot] = slot + 1
                    if slot >= slots:
                        crowded[block.first + lane] = robot
                        continue
                    for k in range(d):
                        seen[robot, slot, k] = rows[robot, own, d * lane + k]
        for robot in range(n):
            for other in range(constants.rows - slots):
                for k in range(d):
                    seen[robot, slots + other, k] = rows[robot, n - 1 + other, d * lane + k]
