"""How an episode begins: links, obstacles, positions and attitudes, drawn from their own streams.

Separate kernels, called one after another for all environments of a reset:

    draw_graphs → draw_fields → begin_episodes → check_passages → draw_memories → begin_arcs

What an experiment does not draw is not called.
"""

import math

import numpy as np

from ..compilation import inner_kernel, kernel
from ..graphs.edges import load_links, store_links
from ..graphs.random_graphs import draw_links, is_linked, join
from ..obstacles.fields import draw_obstacles
from ..obstacles.obstacle_set import AnyObstacles, clear_of_obstacles
from ..obstacles.reachability import none_walled_in
from ..physics.potential import distance_squared, lyapunov_of_links
from ..physics.random_streams import (
    FRAMES,
    GRAPH,
    OBSTACLES,
    START,
    draw_rotation,
    mix,
    stream_key,
    uniform,
)
from ..physics.vectors import load
from ..robots.motion import frame_of, init_memory
from .memory import (
    ACTIVE,
    CLEARANCE,
    INITIAL_LYAPUNOV,
    MIN_CLEARANCE,
    SQUARE_CLOSEST,
    STATUS,
    load_fields,
    load_positions,
    store_fields,
    store_positions,
)
from .stages.sense_neighbours import drawn_factor

_MAX_DRAWS = 1000
"""Positions that are drawn for one robot until it has room."""
MAX_TRIALS = 1000
"""Initial conditions that are drawn until no robot is walled in."""
_MAX_CONNECTED = 10_000


@kernel
def draw_graphs(lanes, which, seeds, episodes, rules, links, listed, weights, places):
    """Draw the links of environments by ``GraphRules``; the first that has too many, or −1.
    Working memory: listed (2, E), weights (E,), places (n,).
    """
    n = len(places)
    for k in range(len(which)):
        b = which[k]
        key = stream_key(seeds[b], episodes[b], GRAPH)
        count = draw_links(key, n, rules, listed[0], listed[1], weights, places)
        if count < 0:
            return b
        block, lane = b // lanes, b % lanes
        store_links(links, block, lane, n, listed[0], listed[1], weights, count)
    return -1


@kernel
def draw_fields(
    lanes, which, trial, seeds, episodes, field, n_given, robots, obstacles, positions
):
    """Draw the obstacles of environments, clear of the first ``n_given`` robots; the first
    environment without room for them, or −1. ``positions``, (n, d), is working memory.
    """
    for k in range(len(which)):
        b = which[k]
        world = AnyObstacles(obstacles.kinds[b], obstacles.corners[b], obstacles.shapes[b])
        load_positions(robots[b // lanes], b % lanes, lanes, positions)
        key = _stream_of_trial(stream_key(seeds[b], episodes[b], OBSTACLES), trial)
        if not draw_obstacles(key, field, positions, n_given, world):
            return b
    return -1


@kernel
def check_passages(lanes, which, passage, robots, obstacles, positions, chains, walled_in):
    """Write to ``walled_in``, (count,), whether some robots of an environment cannot reach one
    another through gaps of the width ``passage``, m.
    """
    for k in range(len(which)):
        b = which[k]
        world = AnyObstacles(obstacles.kinds[b], obstacles.corners[b], obstacles.shapes[b])
        load_positions(robots[b // lanes], b % lanes, lanes, positions)
        walled_in[k] = not none_walled_in(world, positions, passage, chains)


@kernel
def begin_episodes(
    lanes,
    which,
    trial,
    status,
    draws,
    lengths,
    seeds,
    episodes,
    links,
    obstacles,
    robots,
    merged_into,
    environments,
    positions,
    listed,
    weights,
    counts,
):
    """Begin an episode with this status in environments, in which links and obstacles, or None,
    are already; the first without room for its robots, or −1.

    ``draws`` are whether positions and frames are drawn, and whether all robots keep apart rather
    than neighbours; ``lengths``, m, those of the spawn area, between robots, to obstacles, and of
    the links that must connect the robots, inf where that is not asked for. Working memory:
    positions (n, d), listed (2, E), weights (E,), counts (n,).
    """
    n, d = positions.shape
    for k in range(len(which)):
        b = which[k]
        block, lane = b // lanes, b % lanes
        count = load_links(links, block, lane, n, listed[0], listed[1], weights)
        found = listed[0, :count], listed[1, :count], weights[:count]
        state, environment = robots[block], environments[block]
        load_positions(state, lane, lanes, positions)
        if draws[0]:
            key = _stream_of_trial(stream_key(seeds[b], episodes[b], START), trial)
            if not _draw_connected(key, b, draws[2], lengths, found, obstacles, positions, counts):
                return b
            store_positions(positions, state, lane, lanes)
        if draws[1]:
            key = stream_key(seeds[b], episodes[b], FRAMES)
            for i in range(n):
                # numbers 3i to 3i + 2 are robot i's own, used or not
                if d == 2:
                    frame = draw_rotation(key, 3 * i, (0, 1))
                    store_fields(frame, state[i], 2, lane, lanes)
                else:
                    rotation = draw_rotation(key, 3 * i, (0, 1, 2))
                    store_fields(rotation, state[i], 3, lane, lanes)
        for i in range(n):
            merged_into[b, i] = i
        for field in range(environments.shape[1] // lanes):
            environment[field * lanes + lane] = 0.0
        environment[STATUS * lanes + lane] = status
        environment[ACTIVE * lanes + lane] = n
        environment[MIN_CLEARANCE * lanes + lane] = np.inf
        # these follow with the next observation, as V now
        environment[CLEARANCE * lanes + lane] = np.inf
        environment[SQUARE_CLOSEST * lanes + lane] = np.inf
        environment[INITIAL_LYAPUNOV * lanes + lane] = lyapunov_of_links(positions, found)
    return -1


@inner_kernel
def _stream_of_trial(key, trial):
    """The stream itself at first, then one of its own for each further trial."""
    return key if trial == 0 else mix(key ^ np.uint64(trial))


@inner_kernel
def _draw_connected(key, b, apart, lengths, links, obstacles, positions, counts):
    """Positions of one environment, drawn until links up to a length connect them; whether they
    fit.
    """
    for trial in range(_MAX_CONNECTED):
        # beside the streams of further trials for passages
        own = _stream_of_trial(key, trial * MAX_TRIALS)
        if not _draw_positions(own, b, apart, lengths, links, obstacles, positions):
            return False
        if not apart or _is_connected(positions, lengths[3], counts):
            return True
    return False


@inner_kernel
def _draw_positions(key, b, apart, lengths, links, obstacles, positions):
    """Uniform in the spawn area, away from neighbours and obstacles; whether they fit."""
    n, d = positions.shape
    counter = 0
    for i in range(n):
        for _ in range(_MAX_DRAWS):
            for k in range(d):
                positions[i, k] = lengths[0] * (uniform(key, counter) - 0.5)
                counter += 1
            if _is_apart(i, positions, apart, links, lengths[1]) and _is_clear(
                positions[i], b, obstacles, lengths[2]
            ):
                break
        else:
            return False
    return True


@inner_kernel
def _is_clear(position, b, obstacles, margin):
    if obstacles is not None:
        world = AnyObstacles(obstacles.kinds[b], obstacles.corners[b], obstacles.shapes[b])
        return clear_of_obstacles(load(position), world, margin)
    return True


@inner_kernel
def _is_apart(i, positions, apart, links, least_distance):
    """Whether robot i is far enough from the neighbours that have a position already, or with
    ``apart`` from all robots that have.
    """
    for j in range(i):
        if distance_squared(positions, j, i) < least_distance * least_distance:
            if apart or is_linked(j, i, links):
                return False
    return True


@inner_kernel
def _is_connected(positions, reach, places):
    """Whether links up to a length (m) connect all robots; ``places``, (n,), is working memory."""
    if math.isinf(reach):
        return True
    for i in range(len(places)):
        places[i] = i
    groups = len(places)
    for i in range(len(places)):
        for j in range(i):
            if distance_squared(positions, i, j) <= reach * reach:
                groups -= join(i, j, places)
    return groups == 1


@kernel
def draw_memories(lanes, which, robot, draws, seeds, episodes, robots):
    """What robot models keep at the start, drawn if it ``draws``, and the frames with it."""
    d = len(robot.axes)
    for k in range(len(which)):
        b, lane = which[k], which[k] % lanes
        key = stream_key(seeds[b], episodes[b], FRAMES)
        for i in range(robots.shape[1]):
            state = robots[b // lanes, i]
            if draws:
                kept = init_memory(robot.model, key, 3 * i)
                store_fields(kept, state, d + d * d, lane, lanes)
            kept = load_fields(state, d + d * d, lane, lanes, robot.memories)
            frame = load_fields(state, d, lane, lanes, robot.entries)
            store_fields(frame_of(robot.model, frame, kept), state, d, lane, lanes)


@kernel
def multiply_arcs(which, low, high, seeds, episodes, n, links):
    """Multiply given arcs by numbers from low to high."""
    for k in range(len(which)):
        b = which[k]
        key = stream_key(seeds[b], episodes[b], GRAPH)
        for i in range(n):
            for j in range(n):
                if i != j:
                    factor = drawn_factor(key, 0, i, j, n, low, high)
                    links.weights[b, i * n + j, 0] *= factor


@kernel
def begin_arcs(which, links, robots, environments, positions, listed, weights):
    """V at the start of environments whose arcs have changed since they began."""
    n = positions.shape[0]
    for k in range(len(which)):
        b = which[k]
        load_positions(robots[b], 0, 1, positions)
        count = load_links(links, b, 0, n, listed[0], listed[1], weights)
        found = listed[0, :count], listed[1, :count], weights[:count]
        environments[b, INITIAL_LYAPUNOV] = lyapunov_of_links(positions, found)
