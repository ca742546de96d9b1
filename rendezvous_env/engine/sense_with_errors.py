"""The sensor that errs: what it makes of the exact observations of a team."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import inlined_kernel, inner_kernel
from ..equations.outward import outward_directions
from ..equations.random_streams import SENSING, stream_key, uniform
from ..equations.sensing import (
    DRAWS,
    gaussian,
    in_sectors,
    random_axis,
    step_key,
    turned,
    turned_towards,
)
from ..equations.sight import is_hidden_by_obstacles, is_hidden_by_robot, is_seen
from ..equations.vectors import ORIGIN, load, square, subtract, to_local
from .link_kinds import arcs_of
from .links import load_links
from .memory import RUNNING, STATUS, STEPS, lane_count, read
from .sensors import describe
from .worlds import world_of


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
def _err(sensor, block, count, layout, constants, moves, teams, links, obstacles, results, hand):
    """Team by team, see ``sensors.err``."""
    lanes = lane_count(layout.width)
    for lane in range(count):
        team = block * lanes + lane
        step = int(teams.statistics[block, STEPS * lanes + lane])
        if moves and teams.statistics[block, STATUS * lanes + lane] == RUNNING:
            step += 1
        merged_into, rows = teams.merged_into[team], results.observations[team]
        for i in range(hand.positions.shape[0]):
            for k in range(len(layout.axes)):
                hand.positions[i, k] = teams.positions[block, i, k * lanes + lane]
        if sensor.error > 0.0:
            outward_directions(hand.positions, merged_into, hand.here)
        key = stream_key(sensor.seeds[team], sensor.episodes[team], SENSING)
        keys = (key, step_key(key, step))
        _see_neighbours(
            block,
            lane,
            keys,
            layout,
            constants,
            sensor,
            teams,
            links,
            world_of(obstacles, team),
            rows,
            hand,
        )
        for i in range(hand.positions.shape[0]):
            if merged_into[i] == i:
                _see_obstacles(i, constants, sensor, keys, rows, hand, layout.axes)
        if sensor.past.shape[1] > 1:
            _delay(step, constants, merged_into, rows, sensor.past[team])


@inner_kernel
def _see_neighbours(block, lane, keys, layout, constants, sensor, teams, links, world, rows, hand):
    """Both ends of every link, in the order in which their rows stand; of a one-way link one."""
    n, d = hand.positions.shape
    merged_into = teams.merged_into[block * lane_count(layout.width) + lane]
    found = load_links(block, lane, links, hand)
    hand.counts[:] = 0
    for end in range(2 * found):
        first, second = hand.first[end // 2], hand.second[end // 2]
        i, j = (second, first) if end % 2 else (first, second)
        if not _leads(arcs_of(links, block), i, j):
            continue
        slot = hand.counts[i] if sensor.packed else j - (j > i)
        hand.counts[i] += 1
        if slot < constants.neighbour_slots:
            frame = read(teams.frames[block, i], lane, layout.width, layout.entries)
            place = (i * constants.rows + slot) * d
            row = _row(rows, place, layout.axes)
            seen = _see_robot(
                i, j, row, frame, constants, sensor, keys, world, merged_into, hand, layout.axes
            )
            _put(seen, rows, place)
    if sensor.packed:
        for i in range(n):
            _close_ranks(i, constants, d, rows)


@inlined_kernel
def _leads(arcs, i, j):
    """Whether robot i sees robot j, whom a link joins."""
    if arcs is not None:
        return arcs.weights[i, j] > 0.0
    return True


@inlined_kernel  # to hand all its arguments over would take longer than what it does
def _see_robot(i, j, row, frame, constants, sensor, keys, world, merged_into, hand, axes):
    """What robot i makes of the exact row of its neighbour j; zero if it does not see it."""
    counter = (i * hand.positions.shape[0] + j) * DRAWS
    offset = subtract(load(hand.positions[j]), load(hand.positions[i]))
    if (
        not is_seen(to_local(frame, _within(axes, offset)), sensor.reach, sensor.half_field)
        or (sensor.dropout > 0.0 and uniform(keys[1], counter + 4) < sensor.dropout)
        or (
            (sensor.obstacles_hide or sensor.robots_hide)
            and _is_hidden(i, j, offset, constants, sensor, world, merged_into, hand)
        )
    ):
        return _within(axes, ORIGIN)
    row = _turned_by_chance(row, keys, counter, sensor)
    if sensor.error > 0.0:
        outward = to_local(frame, _within(axes, load(hand.here[i])))
        row = turned_towards(row, sensor.error, outward)
    if sensor.sectors > 0:
        row = in_sectors(row, sensor.sectors)
    return row


@inner_kernel
def _is_hidden(i, j, offset, constants, sensor, world, merged_into, hand):
    """Whether an obstacle or another robot stands between robots i and j."""
    if world is not None:
        if sensor.obstacles_hide and is_hidden_by_obstacles(world, load(hand.positions[i]), offset):
            return True
    if sensor.robots_hide:
        for k in range(hand.positions.shape[0]):
            if k != i and k != j and merged_into[k] == k:
                other = subtract(load(hand.positions[k]), load(hand.positions[i]))
                if is_hidden_by_robot(offset, other, 0.5 * constants.merge_radius):
                    return True
    return False


@inner_kernel
def _see_obstacles(i, constants, sensor, keys, rows, hand, axes):
    """An obstacle is seen with all its points as soon as one of them is in the field of view."""
    n, d, points = hand.positions.shape[0], len(axes), hand.silhouette.shape[0]
    slots = (sensor.past.shape[3] - constants.neighbour_slots) // points
    for m in range(slots):
        first = (i * constants.rows + constants.neighbour_slots + m * points) * d
        seen = False
        for s in range(points):
            point = _row(rows, first + s * d, axes)
            seen = seen or (square(point) > 0.0 and is_seen(point, np.inf, sensor.half_field))
        for s in range(points):
            place, point = first + s * d, _within(axes, ORIGIN)
            if seen:
                counter = (n * n + (i * slots + m) * points + s) * DRAWS
                point = _turned_by_chance(_row(rows, place, axes), keys, counter, sensor)
                if sensor.sectors > 0:
                    point = in_sectors(point, sensor.sectors)
            _put(point, rows, place)


@inlined_kernel
def _turned_by_chance(row, keys, counter, sensor):
    """A row turned by its bias of the episode and by its noise of the step."""
    if sensor.bias > 0.0:
        angle = sensor.bias * gaussian(keys[0], counter)
        row = turned(row, angle, _axis(row, keys[0], counter + 2))
    if sensor.noise > 0.0:
        angle = sensor.noise * gaussian(keys[1], counter)
        row = turned(row, angle, _axis(row, keys[1], counter + 2))
    return row


@inlined_kernel
def _axis(row, key, counter):
    """About which a row is turned; the plane has but one."""
    if len(row) == 2:
        return ORIGIN
    return random_axis(key, counter)


@inner_kernel
def _close_ranks(i, constants, d, rows):
    """Let the rows of neighbours that robot i sees stand first."""
    first, filled = i * constants.rows * d, 0
    for slot in range(constants.neighbour_slots):
        place, present = first + slot * d, False
        for k in range(d):
            present = present or rows[place + k] != 0.0
        if present:
            for k in range(d):
                value = rows[place + k]
                rows[place + k] = 0.0
                rows[first + filled * d + k] = value
            filled += 1


@inner_kernel
def _delay(step, constants, merged_into, rows, past):
    """Keep what is seen now, and give out what was seen so many steps ago; robots that are gone see
    nothing.
    """
    length, n, sensed, d = past.shape
    now, due = step % length, (step + 1) % length
    for i in range(n):
        for row in range(sensed):
            for k in range(d):
                number = (i * constants.rows + row) * d + k
                for t in range(length):
                    if step == 0 or t == now:  # at the start nothing else has been seen
                        past[t, i, row, k] = rows[number]
                rows[number] = past[due, i, row, k] if merged_into[i] == i else 0.0


# ---- rows as tuples -----------------------------------------------------------------------------


@inlined_kernel
def _within(axes, v):
    """A triple as a pair in the plane."""
    if len(axes) == 2:
        return v[0], v[1]
    return v


@inlined_kernel
def _row(rows, place, axes):
    if len(axes) == 2:
        return np.float64(rows[place]), np.float64(rows[place + 1])
    return np.float64(rows[place]), np.float64(rows[place + 1]), np.float64(rows[place + 2])


@inlined_kernel
def _put(row, rows, place):
    """Write a pair or triple, never the negative zero."""
    rows[place], rows[place + 1] = row[0] + 0.0, row[1] + 0.0
    if len(row) == 3:
        rows[place + 2] = row[2] + 0.0


describe(Sensor, _err)
