"""The stage that looks: what the robots of a block see, V, and who is closest."""

import math
from typing import Any

import numpy as np

from ...compilation import by_type, inner_kernel
from ...graphs.edges import DenseEdges, DirectedEdges, EdgeList
from ...physics.bearings import observed, sighting
from ...robots.motion import proprioception
from ..memory import in_lanes, lane_count, pair_of, read, statistics_of, write, write_row
from ..memory.changing_edges import update_links
from .sense_by_chance import sense_by_chance
from .sense_obstacles import sense_obstacles
from .sense_one_by_one import sense_one_by_one


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
        _leave_out_docked(block, setup, state.teams.positions[block.index], scratch.block.rows)
    square_closest = statistics_of(state.teams, block.index).square_closest
    for lane in range(lane_count(setup.layout.width)):
        square_closest[lane] = found.square_closest[lane]
    sense_obstacles(block, setup, state, state.obstacles, output, scratch)
    _proprioception(block, setup, state.teams, scratch.block.rows)
    sense_by_chance(sensor, block, setup, moves, state, scratch)
    _give_out(block, setup, state.links, output, scratch, setup.layout.packs)
    sense_one_by_one(sensor, block, setup, moves, state, output, scratch.team)


# ---- neighbours ---------------------------------------------------------------------------------


@by_type("links", lambda kind: _SENSE[kind])
def _sense_neighbours(block, setup, teams, links, crowded, scratch):
    """Write the neighbour rows of a block, add up V, and find who is closest."""


@inner_kernel(inline="code")
def _sense_pairs(block, setup, teams, links, crowded, scratch):
    """Every pair once, in index order; a link that is absent weighs 0."""
    positions, frames, rows = teams.positions[block], teams.frames[block], scratch.block.rows
    layout, found, e = setup.layout, pair_of(scratch.block.pair, setup.layout.axes), 0
    for i in range(positions.shape[0]):
        for j in range(i + 1, positions.shape[0]):
            _sight(layout, positions[i], positions[j], links.weights[block, e], found)
            # in index order robot j is row j − 1 of robot i < j, and robot i is row i of robot j
            _store_row(layout, found.offset, found.factor_ij, frames[i], rows[i, j - 1])
            _store_row(layout, found.offset, found.factor_ji, frames[j], rows[j, i])
            e += 1


@inner_kernel(inline="code")
def _sight(layout, position_i, position_j, gain, found):
    """``sighting`` of two robots in every lane, (d, L) each."""
    if not (
        in_lanes(position_i, layout)
        and in_lanes(position_j, layout)
        and in_lanes(found.offset, layout)
    ):
        return
    for lane in range(lane_count(layout.width)):
        offset, square, distance, factor = sighting(
            read(position_i, lane, layout.axes), read(position_j, lane, layout.axes), gain[lane]
        )
        write(offset, found.offset, lane)
        least = found.square_closest[lane]
        found.half_lyapunov[lane] += gain[lane] * distance
        found.square_closest[lane] = square if (gain[lane] > 0.0) & (square < least) else least
        found.factor_ij[lane] = factor
        found.factor_ji[lane] = -factor


@inner_kernel(inline="code")
def _store_row(layout, vector, factor, frame, row):
    """Write factor × vector (d, L) into a row of observations, in the robots' frames (d², L)."""
    if not (in_lanes(vector, layout) and in_lanes(frame, layout)):
        return
    for lane in range(lane_count(layout.width)):
        local, offset = read(frame, lane, layout.entries), read(vector, lane, layout.axes)
        write_row(observed(local, offset, factor[lane]), row, lane)


@inner_kernel(inline="code")
def _sense_list(block, setup, teams, links, crowded, scratch):
    """Every link of one team once, in the order of its robots, which is that of the rows."""
    layout, counts, rows = setup.layout, scratch.team.counts, scratch.block.rows
    found = pair_of(scratch.block.pair, layout.axes)
    rows[:] = 0.0
    counts[:] = 0
    for e in range(links.first.shape[1]):
        gain = links.weights[block, e]
        if gain <= 0.0:
            continue
        i, j = links.first[block, e], links.second[block, e]
        offset, square, distance, factor = sighting(
            read(teams.positions[block, i], 0, layout.axes),
            read(teams.positions[block, j], 0, layout.axes),
            gain,
        )
        found.half_lyapunov[0] += gain * distance
        found.square_closest[0] = min(found.square_closest[0], square)
        for end in range(2):
            robot = j if end else i
            slot = counts[robot]
            if slot >= setup.constants.neighbour_slots:
                crowded[block] = robot
                continue
            counts[robot] = slot + 1
            frame = read(teams.frames[block, robot], 0, layout.entries)
            write_row(observed(frame, offset, -factor if end else factor), rows[robot, slot], 0)


@inner_kernel(inline="code")
def _sense_arcs(block, setup, teams, links, crowded, scratch):
    """Every pair of one team in index order, and of its two arcs those that are there."""
    n, axes = teams.positions.shape[1], setup.layout.axes
    found = pair_of(scratch.block.pair, axes)
    scratch.block.rows[:] = 0.0
    scratch.team.counts[:] = 0
    for i in range(n):
        for j in range(i + 1, n):
            both = links.weights[block, i, j] + links.weights[block, j, i]
            if both > 0.0:
                _, square, distance, _ = sighting(
                    read(teams.positions[block, i], 0, axes),
                    read(teams.positions[block, j], 0, axes),
                    both,
                )
                found.half_lyapunov[0] += 0.5 * both * distance
                found.square_closest[0] = min(found.square_closest[0], square)
                for i_sees in (True, False):
                    a, b = (i, j) if i_sees else (j, i)
                    gain = links.weights[block, a, b]
                    if gain > 0.0:
                        _look(a, b, gain, block, setup, teams, crowded, scratch)


@inner_kernel(inline="code")
def _look(i, j, gain, block, setup, teams, crowded, scratch):
    """Write the row of robot j in the observation of robot i."""
    layout, n, slots = setup.layout, teams.positions.shape[1], setup.constants.neighbour_slots
    # with a row for each other robot it has its own; with fewer those present stand first
    slot = j - (j > i) if slots == n - 1 else scratch.team.counts[i]
    scratch.team.counts[i] += 1
    if slot < slots:
        offset, _, _, factor = sighting(
            read(teams.positions[block, i], 0, layout.axes),
            read(teams.positions[block, j], 0, layout.axes),
            gain,
        )
        frame = read(teams.frames[block, i], 0, layout.entries)
        write_row(observed(frame, offset, factor), scratch.block.rows[i, slot], 0)
    else:
        crowded[block] = i


_SENSE: dict[type, Any] = {
    DenseEdges: _sense_pairs,
    EdgeList: _sense_list,
    DirectedEdges: _sense_arcs,
}


@inner_kernel
def _leave_out_docked(block, setup, positions, rows):
    """Zero the rows of those whom a body touches, as a link is gone with a merge; who touches all
    others keeps their rows, or it would have nothing to go by.
    """
    n, constants = positions.shape[0], setup.constants
    # halfway into r: bodies held at the edge of r would count as met now and then, not all at once
    docked = constants.body_radius + 0.5 * constants.merge_radius
    for lane in range(block.count):
        for i in range(n):
            touched = 0
            for j in range(n):
                touched += j != i and _apart(positions, i, j, lane) <= docked
            for j in range(n):
                if touched < n - 1 and j != i and _apart(positions, i, j, lane) <= docked:
                    rows[i, j - (j > i), 2 * lane : 2 * lane + 2] = 0.0


@inner_kernel
def _apart(positions, i, j, lane):
    x = positions[j, 0, lane] - positions[i, 0, lane]
    return math.hypot(x, positions[j, 1, lane] - positions[i, 1, lane])


# ---- oneself ------------------------------------------------------------------------------------


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


# ---- from lanes to teams ------------------------------------------------------------------------


@inner_kernel(inline="code")
def _give_out(block, setup, links, output, scratch, packs):
    """Copy the rows of all lanes into observations; which way is known while compiling."""
    if packs is None:
        _copy_rows(block, output, scratch)
    else:
        _pack_rows(block, setup.constants, links, output.crowded, output.observations, scratch)


@inner_kernel(inline="code")
def _copy_rows(block, output, scratch):
    rows = scratch.block.whole_rows
    n_parts = rows.shape[1] // scratch.block.tally.shape[1]
    observations = output.whole_rows[block.first : block.first + block.count]
    for k in range(rows.shape[0]):
        for lane in range(observations.shape[0]):
            for part in range(n_parts):
                observations[lane, k * n_parts + part] = rows[k, lane * n_parts + part]


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
