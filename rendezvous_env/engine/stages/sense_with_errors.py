"""The sensor that errs: what it makes of the exact observations of a team."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import inner_kernel
from ...graphs.edge_kinds import arcs_of
from ...graphs.edges import load_links
from ...physics.outward import outward_directions
from ...physics.random_streams import SENSING, stream_key, uniform
from ...physics.vectors import ORIGIN, load, square, subtract, to_local
from ...sensors.line_of_sight import is_hidden_by_obstacles, is_hidden_by_robot, is_seen
from ...sensors.sensor_equations import (
    DRAWS,
    gaussian,
    in_sectors,
    random_axis,
    step_key,
    turned,
    turned_towards,
)
from ..memory import RUNNING, Place, read, statistics_of
from ..memory.worlds import world_of
from .sensor_models import describe


class Sensor(NamedTuple):
    """A sensor that is not exact: the fields of ``experiment.sensing.Sensing``."""

    reach: float
    """Range, m; inf without a limit."""
    half_field: float
    """Half the field of view, rad."""
    noise: float
    bias: float
    error: float
    dropout: float
    sectors: int
    """0 leaves bearings as they are."""
    obstacles_hide: bool
    robots_hide: bool
    packed: bool
    """Whether the rows of neighbours that are seen stand first, rather than each in its own."""
    seeds: NDArray[np.uint64]
    """(B,), of the teams."""
    episodes: NDArray[np.int64]
    """(B,), their numbers."""
    past: NDArray[np.float32]
    """(B, delay + 1, n, K + M·S, d): what was seen in step t stands at t mod (delay + 1)."""


@inner_kernel
def _err(sensor, block, setup, moves, state, output, scratch):
    """Team by team, see ``sensor_models.err``."""
    constants, axes, teams = setup.constants, setup.layout.axes, state.teams
    statistics, positions = statistics_of(teams, block.index), scratch.positions
    for lane in range(block.count):
        place = Place(block.index, lane, block.first + lane)
        team, step = place.team, int(statistics.steps[lane])
        if moves and statistics.status[lane] == RUNNING:
            step += 1
        merged_into, rows = teams.merged_into[team], output.observations[team]
        for i in range(positions.shape[0]):
            for k in range(len(axes)):
                positions[i, k] = teams.positions[place.block, i, k, lane]
        if sensor.error > 0.0:
            outward_directions(positions, merged_into, scratch.here)
        key = stream_key(sensor.seeds[team], sensor.episodes[team], SENSING)
        keys = (key, step_key(key, step))
        world = world_of(state.obstacles, team)
        _see_neighbours(place, keys, setup, sensor, state, world, rows, scratch)
        for i in range(positions.shape[0]):
            if merged_into[i] == i:
                _see_obstacles(i, constants.neighbour_slots, sensor, keys, rows[i], scratch, axes)
        if sensor.past.shape[1] > 1:
            _delay(step, merged_into, rows, sensor.past[team])


@inner_kernel
def _see_neighbours(place, keys, setup, sensor, state, world, rows, scratch):
    """Both ends of every link, in the order in which their rows stand; of a one-way link one."""
    axes, slots = setup.layout.axes, setup.constants.neighbour_slots
    teams, radius = state.teams, 0.5 * setup.constants.merge_radius
    counts, merged_into = scratch.counts, teams.merged_into[place.team]
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
            row, scene = _row(rows[i, slot], axes), (world, merged_into, radius)
            _put(_see_robot((i, j), row, frame, sensor, keys, scene, scratch, axes), rows[i, slot])
    if sensor.packed:
        for i in range(rows.shape[0]):
            _close_ranks(rows[i, :slots])


@inner_kernel(inline="code")
def _leads(arcs, i, j):
    """Whether robot i sees robot j, whom a link joins."""
    if arcs is not None:
        return arcs.weights[i, j] > 0.0
    return True


@inner_kernel(inline="code")  # to hand all its arguments over would take longer than what it does
def _see_robot(pair, row, frame, sensor, keys, scene, scratch, axes):
    """What robot i makes of the exact row of its neighbour j; zero if it does not see it."""
    i, j = pair
    counter = (i * scratch.positions.shape[0] + j) * DRAWS
    offset = subtract(load(scratch.positions[j]), load(scratch.positions[i]))
    if (
        not is_seen(to_local(frame, _within(axes, offset)), sensor.reach, sensor.half_field)
        or (sensor.dropout > 0.0 and uniform(keys[1], counter + 4) < sensor.dropout)
        or (
            (sensor.obstacles_hide or sensor.robots_hide)
            and _is_hidden(pair, offset, sensor, scene[0], scene[1], scene[2], scratch.positions)
        )
    ):
        return _within(axes, ORIGIN)
    row = _turned_by_chance(row, keys, counter, sensor)
    if sensor.error > 0.0:
        outward = to_local(frame, _within(axes, load(scratch.here[i])))
        row = turned_towards(row, sensor.error, outward)
    if sensor.sectors > 0:
        row = in_sectors(row, sensor.sectors)
    return row


@inner_kernel
def _is_hidden(pair, offset, sensor, world, merged_into, radius, positions):
    """Whether an obstacle or another robot, of this radius (m), stands between robots i and j."""
    i, j = pair
    if world is not None:
        if sensor.obstacles_hide and is_hidden_by_obstacles(world, load(positions[i]), offset):
            return True
    if sensor.robots_hide:
        for k in range(positions.shape[0]):
            if k != i and k != j and merged_into[k] == k:
                other = subtract(load(positions[k]), load(positions[i]))
                if is_hidden_by_robot(offset, other, radius):
                    return True
    return False


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
            seen = seen or (square(point) > 0.0 and is_seen(point, np.inf, sensor.half_field))
        for s in range(points):
            point = _within(axes, ORIGIN)
            if seen:
                counter = (n * n + (i * slots + m) * points + s) * DRAWS
                point = _turned_by_chance(_row(rows[first + s], axes), keys, counter, sensor)
                if sensor.sectors > 0:
                    point = in_sectors(point, sensor.sectors)
            _put(point, rows[first + s])


@inner_kernel(inline="code")
def _turned_by_chance(row, keys, counter, sensor):
    """A row turned by its bias of the episode and by its noise of the step."""
    if sensor.bias > 0.0:
        angle = sensor.bias * gaussian(keys[0], counter)
        row = turned(row, angle, _axis(row, keys[0], counter + 2))
    if sensor.noise > 0.0:
        angle = sensor.noise * gaussian(keys[1], counter)
        row = turned(row, angle, _axis(row, keys[1], counter + 2))
    return row


@inner_kernel(inline="code")
def _axis(row, key, counter):
    """About which a row is turned; the plane has but one."""
    if len(row) == 2:
        return ORIGIN
    return random_axis(key, counter)


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


# ---- rows as tuples -----------------------------------------------------------------------------


@inner_kernel(inline="code")
def _within(axes, v):
    """A triple as a pair in the plane."""
    if len(axes) == 2:
        return v[0], v[1]
    return v


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


describe(Sensor, _err)
