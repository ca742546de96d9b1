"""What sensors make of the rows of one team at a time: what hides neighbours, an adversary,
sectors, and delay.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import inner_kernel
from ...graphs.edges import arcs_of, load_links
from ...physics.vectors import exactly
from ...physics.worst_bias import outward_directions
from ...sensors.imperfections import Imperfections, neighbour_seen
from ..memory import (
    Place,
    load_team,
    obstacles_of,
    read,
    read_row,
    statistics_of,
    step_seen,
    write_row,
)
from .sense_by_chance import gain_of


class Sensor(NamedTuple):
    """A sensor that is not exact."""

    errors: Imperfections
    listed: bool
    """Whether the rows of a block stand in the order of links, rather than each in its own."""
    packed: bool
    """Whether the rows of neighbours that are seen stand first, rather than each in its own."""
    in_lanes: bool  # Whether range, field of view or chance change neighbours' rows
    singly: bool  # Whether anything else does
    seeds: NDArray[np.uint64]  # (B,), of the teams
    episodes: NDArray[np.int64]  # (B,), their numbers
    past: NDArray[np.float32]
    """(B, delay + 1, n, K + M·S, d): what was seen in step t stands at t mod (delay + 1)."""


@inner_kernel
def sense_one_by_one(sensor, block, setup, moves, state, output, scratch):
    """Replace what the robots of a block would see by what they see; nothing if the sensor is exact
    but for range, field of view of neighbours and chance.
    """
    if sensor is not None:
        late = sensor.past.shape[1] > 1
        if sensor.singly or sensor.packed or late:
            for lane in range(block.count):
                place = Place(block.index, lane, block.first + lane)
                rows = output.observations[place.team]
                if sensor.singly:
                    _see_neighbours(place, setup, sensor, state, rows, scratch)
                if sensor.packed:
                    for i in range(rows.shape[0]):
                        _close_ranks(rows[i, : setup.constants.neighbour_slots])
                if late:
                    step = step_seen(statistics_of(state.teams, block.index), lane, moves)
                    _delay(step, state.teams.merged_into[place.team], rows, sensor.past[place.team])


@inner_kernel
def _see_neighbours(place, setup, sensor, state, rows, scratch):
    """Both ends of every link, in the order in which their rows stand; of a one-way link one."""
    slots, teams, positions = setup.constants.neighbour_slots, state.teams, scratch.positions
    counts, merged_into = scratch.counts, teams.merged_into[place.team]
    load_team(teams.positions, place.block, place.lane, positions)
    if sensor.errors.error > 0.0:
        outward_directions(positions, merged_into, scratch.here)
    world = obstacles_of(state.obstacles, place.team)
    scene, places = (world, merged_into, setup.constants.body_radius), (positions, scratch.here)
    found = load_links(place.block, place.lane, state.links, scratch)
    counts[:] = 0
    for end in range(2 * found):
        first, second = scratch.first[end // 2], scratch.second[end // 2]
        i, j = (second, first) if end % 2 else (first, second)
        if gain_of(arcs_of(state.links, place.block), i, j, 1.0) > 0.0:
            slot = counts[i] if sensor.packed else j - (j > i)
            counts[i] += 1
            if slot < slots:
                frame = read(teams.frames[place.block, i], place.lane, setup.layout.entries)
                row = exactly(read_row(rows[i, slot], 0, setup.layout.axes))
                seen = neighbour_seen((i, j), row, frame, sensor.errors, places, scene)
                write_row(seen, rows[i, slot], 0)


@inner_kernel
def _close_ranks(rows):
    """Let the rows of the neighbours that a robot sees, (K, d), stand first."""
    filled = 0
    for slot in range(rows.shape[0]):
        present = False
        for k in range(rows.shape[1]):
            present = present or rows[slot, k] != 0.0
        if present:
            for k in range(rows.shape[1]):
                value = rows[slot, k]
                rows[slot, k] = 0.0
                rows[filled, k] = value
            filled += 1


@inner_kernel
def _delay(step, merged_into, rows, past):
    """Keep what is seen now, and give out what was seen so many steps ago; robots that are gone see
    nothing.
    """
    length, n, sensed, d = past.shape
    now, due = past[step % length], past[(step + 1) % length]
    for i in range(n):
        for row in range(sensed):
            for k in range(d):
                if step == 0:  # nothing else has been seen
                    for t in range(length):
                        past[t, i, row, k] = rows[i, row, k]
                now[i, row, k] = rows[i, row, k]
                rows[i, row, k] = due[i, row, k] if merged_into[i] == i else 0.0
