"""What becomes of the exact observations of teams whose sensors are not exact."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import inner_kernel
from ...graphs.edge_kinds import arcs_of
from ...graphs.edges import load_links
from ...physics.random_streams import SENSING, stream_key
from ...physics.vectors import square
from ...physics.worst_bias import outward_directions
from ...sensors.imperfections import Imperfections, neighbour_seen, point_seen
from ...sensors.line_of_sight import is_seen
from ...sensors.sensor_equations import DRAWS, step_key
from ..memory import RUNNING, Place, read, statistics_of
from ..memory.obstacles import obstacles_of


class Sensor(NamedTuple):
    """A sensor that is not exact."""

    errors: Imperfections
    packed: bool
    """Whether the rows of neighbours that are seen stand first, rather than each in its own."""
    seeds: NDArray[np.uint64]
    """(B,), of the teams."""
    episodes: NDArray[np.int64]
    """(B,), their numbers."""
    past: NDArray[np.float32]
    """(B, delay + 1, n, K + M·S, d): what was seen in step t stands at t mod (delay + 1)."""


@inner_kernel
def apply_sensor_model(sensor, block, setup, moves, state, output, scratch):
    """Replace the exact observations of a block by what its robots see; nothing if that is exact.

    It may be done again for the same step: what is drawn follows from the number of the step.
    """
    if sensor is not None:
        for lane in range(block.count):
            place = Place(block.index, lane, block.first + lane)
            rows = output.observations[place.team]
            _sense_team(sensor, place, setup, moves, state, rows, scratch)


@inner_kernel
def _sense_team(sensor, place, setup, moves, state, rows, scratch):
    axes, slots, team = setup.layout.axes, setup.constants.neighbour_slots, place.team
    statistics, positions = statistics_of(state.teams, place.block), scratch.positions
    merged_into, step = state.teams.merged_into[team], int(statistics.steps[place.lane])
    if moves and statistics.status[place.lane] == RUNNING:
        step += 1  # which the team has not counted yet
    for i in range(positions.shape[0]):
        for k in range(len(axes)):
            positions[i, k] = state.teams.positions[place.block, i, k, place.lane]
    if sensor.errors.error > 0.0:
        outward_directions(positions, merged_into, scratch.here)
    key = stream_key(sensor.seeds[team], sensor.episodes[team], SENSING)
    keys = (key, step_key(key, step))
    obstacles = obstacles_of(state.obstacles, team)
    _see_neighbours(place, keys, setup, sensor, state, obstacles, rows, scratch)
    for i in range(positions.shape[0]):
        if merged_into[i] == i:
            _see_obstacles(i, slots, sensor, keys, rows[i], scratch, axes)
    if sensor.past.shape[1] > 1:
        _delay(step, merged_into, rows, sensor.past[team])


@inner_kernel
def _see_neighbours(place, keys, setup, sensor, state, obstacles, rows, scratch):
    """Both ends of every link, in the order in which their rows stand; of a one-way link one."""
    slots, teams = setup.constants.neighbour_slots, state.teams
    counts, merged_into = scratch.counts, teams.merged_into[place.team]
    scene = (obstacles, merged_into, 0.5 * setup.constants.merge_radius)
    found = load_links(place.block, place.lane, state.links, scratch)
    counts[:] = 0
    for end in range(2 * found):
        first, second = scratch.first[end // 2], scratch.second[end // 2]
        i, j = (second, first) if end % 2 else (first, second)
        if not _leads(arcs_of(state.links, place.block), i, j):
            continue
        slot = counts[i] if sensor.packed else j - (j > i)
        counts[i] += 1
        if slot < slots:
            frame = read(teams.frames[place.block, i], place.lane, setup.layout.entries)
            row, places = _row(rows[i, slot], setup.layout.axes), (scratch.positions, scratch.here)
            seen = neighbour_seen((i, j), row, frame, sensor.errors, keys, places, scene)
            _put(seen, rows[i, slot])
    if sensor.packed:
        for i in range(rows.shape[0]):
            _close_ranks(rows[i, :slots])


@inner_kernel(inline="code")
def _leads(arcs, i, j):
    """Whether robot i sees robot j, whom a link joins."""
    if arcs is not None:
        return arcs.weights[i, j] > 0.0
    return True


@inner_kernel
def _see_obstacles(i, neighbour_slots, sensor, keys, rows, scratch, axes):
    """An obstacle is seen with all its points as soon as one of them is in the field of view."""
    n, points = scratch.positions.shape[0], scratch.silhouette.shape[0]
    slots = (sensor.past.shape[3] - neighbour_slots) // points
    for m in range(slots):
        first = neighbour_slots + m * points
        seen = False
        for s in range(points):
            point = _row(rows[first + s], axes)
            in_view = is_seen(point, np.inf, sensor.errors.half_field)
            seen = seen or (square(point) > 0.0 and in_view)
        for s in range(points):
            if seen:
                counter = (n * n + (i * slots + m) * points + s) * DRAWS
                point = _row(rows[first + s], axes)
                _put(point_seen(point, sensor.errors, keys, counter), rows[first + s])
            else:
                rows[first + s] = 0.0


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
    now, due = step % length, (step + 1) % length
    for i in range(n):
        for row in range(sensed):
            for k in range(d):
                for t in range(length):
                    if step == 0 or t == now:  # at the start nothing else has been seen
                        past[t, i, row, k] = rows[i, row, k]
                rows[i, row, k] = past[due, i, row, k] if merged_into[i] == i else 0.0


@inner_kernel(inline="code")
def _row(row, axes):
    """A row (d,) as a pair or triple of float64."""
    if len(axes) == 2:
        return np.float64(row[0]), np.float64(row[1])
    return np.float64(row[0]), np.float64(row[1]), np.float64(row[2])


@inner_kernel(inline="code")
def _put(values, row):
    """Write a pair or triple, never the negative zero."""
    row[0], row[1] = values[0] + 0.0, values[1] + 0.0
    if len(values) == 3:
        row[2] = values[2] + 0.0
