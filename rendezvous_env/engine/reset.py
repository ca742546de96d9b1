"""Initial conditions: links, obstacles, positions and attitudes.

Each is sampled from its own random stream by a separate kernel. The kernels are called in this
order for all environments of a reset:

    draw_graphs, draw_fields, close_field_seams, draw_positions, check_connected,
    check_passages, draw_frames, draw_memories, multiply_arcs

Kernels of quantities that a scenario does not sample are skipped. The subsequent observation
computes the initial V.
"""

import numpy as np

from ..compilation import inner_kernel, kernel
from ..graphs.edges import are_linked, store_links
from ..graphs.random_graphs import draw_links, join
from ..obstacles.fields import draw_obstacles
from ..obstacles.obstacle_set import clear_of_obstacles, close_disc_seams, close_seams
from ..obstacles.reachability import all_reachable
from ..physics.potential import distance_squared
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
from ..robots.motion import constants_of_robot, frame_of, init_memory
from .memory import (
    load_fields,
    load_positions,
    obstacles_of,
    store_fields,
    store_positions,
)
from .stages.sense_neighbours import drawn_factor

_MAX_DRAWS = 1000
"""Maximum number of sampled positions for one robot."""
MAX_TRIALS = 1000
"""Maximum number of sampled initial conditions until no robot is separated."""
MAX_CONNECTED = 10_000


@kernel(unroll=False)
def draw_graphs(lanes, which, seeds, episodes, rules, links, listed, weights, places):
    """Sample the links of environments by ``GraphRules``.

    Returns the first environment with too many links, or −1. Working memory: listed (2, E), weights
    (E,), places (n,).
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


@kernel(unroll=False)
def draw_fields(lanes, which, trial, seeds, episodes, field, n_given, robots, obstacles, positions):
    """Sample the obstacles of environments, clear of the first ``n_given`` robots.

    Returns the first environment without room for them, or −1. ``positions``, (n, d), is working
    memory.
    """
    for k in range(len(which)):
        b = which[k]
        world = obstacles_of(obstacles, b)
        load_positions(robots[b // lanes], b % lanes, lanes, positions)
        key = _stream_of_trial(stream_key(seeds[b], episodes[b], OBSTACLES), trial)
        if not draw_obstacles(key, field, positions, n_given, world):
            return b
    return -1


@kernel
def close_field_seams(which, dim, obstacles):
    """Close the seams between the sampled spheres of environments; see ``close_seams``."""
    for b in which:
        close_seams(obstacles_of(obstacles, b), dim)


@kernel
def close_disc_field_seams(which, obstacles):
    """Close the seams between the sampled discs of environments, in 2-D."""
    for b in which:
        close_disc_seams(obstacles_of(obstacles, b))


@kernel
def check_passages(lanes, which, passage, robots, obstacles, positions, chains, walled_in):
    """Write to ``walled_in``, (count,), whether some robots of an environment are separated.

    Robots are separated if no gaps of the width ``passage``, m, connect them.
    """
    for k in range(len(which)):
        b = which[k]
        world = obstacles_of(obstacles, b)
        load_positions(robots[b // lanes], b % lanes, lanes, positions)
        walled_in[k] = not all_reachable(world, positions, passage, chains)


@kernel(unroll=False)
def draw_positions(
    lanes,
    which,
    trials,
    lengths,
    region,
    apart,
    seeds,
    episodes,
    links,
    obstacles,
    robots,
    positions,
):
    """Sample positions uniformly in the spawn area, away from neighbours and obstacles.

    ``region``, (m, 7), are triangles that replace it, see ``start_region.triangles_of``, or None.

    With ``apart`` the distance holds for all robots; obstacles may be None. Returns the first
    environment without room, or −1.

    ``lengths``, m, are the three edges of the spawn area and the minimum distances between robots
    and to obstacles. ``trials`` are those for passages and for connected robots. ``positions``,
    (n, d), is working memory.
    """
    for k in range(len(which)):
        b = which[k]
        key = _stream_of_trial(stream_key(seeds[b], episodes[b], START), trials[0])
        # distinct from the streams of further trials for passages
        key = _stream_of_trial(key, trials[1] * MAX_TRIALS)
        counter = 0
        for i in range(positions.shape[0]):
            for draw in range(_MAX_DRAWS):
                if region is None:
                    for axis in range(positions.shape[1]):
                        positions[i, axis] = lengths[0][axis] * (uniform(key, counter) - 0.5)
                        counter += 1
                else:
                    _place_in(region, key, counter, positions[i])
                    counter += 3
                if _is_apart(i, positions, apart, links, b, lanes, lengths[1]) and _is_clear(
                    positions[i], b, obstacles, lengths[2]
                ):
                    break
                if draw == _MAX_DRAWS - 1:
                    return b
        store_positions(positions, robots[b // lanes], b % lanes, lanes)
    return -1


@inner_kernel
def _place_in(region, key, counter, out):
    """Sample a point uniformly in triangles: p₀ + u (p₁ − p₀) + v (p₂ − p₀) with u + v ≤ 1."""
    share, first, last = uniform(key, counter), 0, len(region) - 1
    while first < last:
        middle = (first + last) // 2
        if region[middle, 0] > share:
            last = middle
        else:
            first = middle + 1
    u, v = uniform(key, counter + 1), uniform(key, counter + 2)
    if u + v > 1.0:
        u, v = 1.0 - u, 1.0 - v
    row = region[first]
    for axis in range(2):
        origin = row[1 + axis]
        out[axis] = origin + u * (row[3 + axis] - origin) + v * (row[5 + axis] - origin)


@kernel
def draw_frames(lanes, which, axes, seeds, episodes, robots):
    """Sample the frames of environments, uniformly."""
    for k in range(len(which)):
        b = which[k]
        key = stream_key(seeds[b], episodes[b], FRAMES)
        for i in range(robots.shape[1]):
            # numbers 3i to 3i + 2 are reserved for robot i
            frame = draw_rotation(key, 3 * i, axes)
            store_fields(frame, robots[b // lanes, i], len(axes), b % lanes, lanes)


@inner_kernel
def _stream_of_trial(key, trial):
    """The stream itself for the first trial, and a separate one for each further trial."""
    return key if trial == 0 else mix(key ^ np.uint64(trial))


@inner_kernel
def _is_clear(position, b, obstacles, margin):
    if obstacles is not None:
        world = obstacles_of(obstacles, b)
        return clear_of_obstacles(load(position), world, margin)
    return True


@inner_kernel
def _is_apart(i, positions, apart, links, b, lanes, least_distance):
    """True if robot i is far enough from its neighbours with a position.

    With ``apart``, from all robots with a position.
    """
    for j in range(i):
        if distance_squared(positions, j, i) < least_distance * least_distance:
            if apart or are_linked(links, b // lanes, b % lanes, len(positions), j, i):
                return False
    return True


@kernel
def check_connected(lanes, which, reach, robots, positions, places, parted):
    """Write to ``parted``, (count,), whether links leave robots of an environment unconnected.

    Links are at most ``reach`` long, m. Working memory: positions (n, d), places (n,).
    """
    for k in range(len(which)):
        load_positions(robots[which[k] // lanes], which[k] % lanes, lanes, positions)
        for i in range(len(places)):
            places[i] = i
        groups = len(places)
        for i in range(len(places)):
            for j in range(i):
                if distance_squared(positions, i, j) <= reach * reach:
                    groups -= join(i, j, places)
        parted[k] = groups > 1


@kernel(unroll=False)
def draw_memories(lanes, which, robot, draws, seeds, episodes, robots):
    """Initial memory of robot models, sampled if it ``draws``, and the matching frames."""
    d = len(robot.axes)
    for k in range(len(which)):
        b, lane = which[k], which[k] % lanes
        key = stream_key(seeds[b], episodes[b], FRAMES)
        for i in range(robots.shape[1]):
            state, model = robots[b // lanes, i], constants_of_robot(robot.model, robot.limits, i)
            if draws:
                kept = init_memory(model, key, 3 * i)
                store_fields(kept, state, d + d * d, lane, lanes)
            kept = load_fields(state, d + d * d, lane, lanes, robot.memories)
            frame = load_fields(state, d, lane, lanes, robot.entries)
            store_fields(frame_of(model, frame, kept), state, d, lane, lanes)


@kernel
def multiply_arcs(which, low, high, seeds, episodes, n, links):
    """Multiply given arcs by sampled factors from low to high."""
    for k in range(len(which)):
        b = which[k]
        key = stream_key(seeds[b], episodes[b], GRAPH)
        for i in range(n):
            for j in range(n):
                if i != j:
                    factor = drawn_factor(key, 0, i, j, n, low, high)
                    links.weights[b, i * n + j, 0] *= factor
