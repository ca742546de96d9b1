"""How an episode begins: graph, obstacles, places and attitudes, drawn from their own streams."""

import math
from typing import NamedTuple

import numpy as np

from ..compilation import inner_kernel, kernel
from ..graphs.edges import arcs_of, load_links, store_links
from ..graphs.random_graphs import GraphRules, draw_links, is_linked, join
from ..obstacles.fields import Rules, draw_obstacles, is_possible
from ..obstacles.obstacle_set import clear_of_obstacles
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
    BatchState,
    Place,
    Teams,
    TeamScratch,
    lane_count,
    load_team,
    obstacles_of,
    read,
    statistics_of,
    store_team,
    write,
)
from .memory.changing_edges import begin_arcs
from .stages.sense_obstacles import lay_out_discs

_TRIES_FOR_START = 1000
_TRIES_FOR_WAYS = 1000
"""Starts that are drawn until no robot is walled in."""
_TRIES_FOR_JOINED = 10_000
FITS, NO_ROOM, TOO_MANY_LINKS = range(3)


class StartRules(NamedTuple):
    """How an episode begins: what is drawn, and from where. Of what is None nothing is compiled."""

    draw_positions: bool
    draw_frames: bool
    draw_memory: bool
    draw_weights: bool
    draw_obstacles: bool
    spawn_size: float
    least_distance: float
    keep_out: float
    factors: tuple[float, float] | None  # The range of what given arcs are multiplied by, or None
    reach: float | None
    """Where links change everyone keeps apart from everyone, and links up to this length, m,
    connect the start, inf if that is not asked for; None where robots keep apart from their
    neighbours alone."""
    graph: GraphRules | None  # None where no episode draws anything of its graph
    field: Rules | None  # None where no episode draws obstacles


@kernel
def reset_teams(indices, status, rules, streams, setup, state, scratch):
    """Begin a new episode with this status in the teams with these indices, (count,); what is given
    already stands in the state. Index of the first team that found no room, or −1; and whether that
    is FITS, NO_ROOM (for its start or obstacles) or TOO_MANY_LINKS.

    Streams are seeds, (B,) uint64, and episodes, (B,); setup is Layout and Robot; state and scratch
    are the fields of BatchState, those of Teams as a tuple, and of TeamScratch.
    """
    seeds, episodes = streams
    layout, robot = setup
    state = BatchState(Teams(*state[0]), state[1], state[2], state[3])
    scratch, lanes = TeamScratch(*scratch), lane_count(layout.width)
    for k in range(len(indices)):
        place = Place(indices[k] // lanes, indices[k] % lanes, indices[k])
        keys = (seeds[place.team], episodes[place.team])
        count = _draw_links(place, keys, rules, rules.graph, state.links, scratch)
        if count < 0:
            return place.team, TOO_MANY_LINKS
        links = (scratch.first[:count], scratch.second[:count], scratch.weights[:count])
        load_team(state.teams.positions, place.block, place.lane, scratch.positions)
        scene = links, obstacles_of(state.obstacles, place.team)
        if not _draw_room(keys, rules, rules.field, rules.reach, scene, scratch):
            return place.team, NO_ROOM
        lay_out_discs(place, state.teams.discs, state.obstacles)
        _write_start(place, status, links, state, scratch)
        _draw_attitudes(place, rules, keys, layout, robot, state.teams)
        key, arcs = stream_key(keys[0], keys[1], GRAPH), arcs_of(state.links, place.team)
        begin_arcs(place.team, key, rules, layout, state, scratch, arcs)
    return -1, FITS


@inner_kernel
def _draw_links(place, keys, rules, graph, links, scratch):
    """Links of a start into working memory: drawn, or as given; their number, −1 for too many."""
    if graph is not None:
        if rules.draw_weights:
            key, n = stream_key(keys[0], keys[1], GRAPH), len(scratch.counts)
            first, second, weights = scratch.first, scratch.second, scratch.weights
            return draw_links(key, n, graph, first, second, weights, scratch.counts)
    return load_links(place.block, place.lane, links, scratch)


@inner_kernel
def _draw_room(keys, rules, field, reach, scene, scratch):
    """Obstacles and places of one team; whether they fit. A start in which some robots are walled
    in, where the field promises none, is drawn again. ``scene`` is links and obstacles.
    """
    positions, world = scratch.positions, scene[1]
    key = stream_key(keys[0], keys[1], START)
    if field is not None:
        if rules.draw_obstacles:
            # obstacles keep clear of given places; places that are drawn keep clear of obstacles
            n_starts = 0 if rules.draw_positions else positions.shape[0]
            field_key = stream_key(keys[0], keys[1], OBSTACLES)
            for trial in range(_TRIES_FOR_WAYS):
                own, of_field = _stream_of_try(key, trial), _stream_of_try(field_key, trial)
                if not draw_obstacles(of_field, field, positions, n_starts, world):
                    return False
                if not _draw_places(own, rules, reach, scene, positions, scratch.counts):
                    return False
                if is_possible(field, world, positions, scratch.chains):
                    return True
            return False
    return _draw_places(key, rules, reach, scene, positions, scratch.counts)


@inner_kernel
def _stream_of_try(key, trial):
    """The stream itself at first, then one of its own for each further try."""
    return key if trial == 0 else mix(key ^ np.uint64(trial))


@inner_kernel
def _draw_places(key, rules, reach, scene, positions, counts):
    """Places, unless they are given; whether they fit. ``scene`` is links and obstacles.

    Where links change they are drawn until those up to ``reach`` connect them.
    """
    if rules.draw_positions:
        if reach is not None:
            for trial in range(_TRIES_FOR_JOINED):
                # beside the streams of further tries for ways
                own = _stream_of_try(key, trial * _TRIES_FOR_WAYS)
                if not _draw_positions(own, rules, reach, scene, positions):
                    return False
                if _is_joined(positions, reach, counts):
                    return True
            return False
        return _draw_positions(key, rules, reach, scene, positions)
    return True


@inner_kernel
def _draw_positions(key, rules, reach, scene, positions):
    """Uniform in the spawn area, neighbours at least 2r apart, clear of obstacles; whether it
    fits.
    """
    (n, d), (links, world) = positions.shape, scene
    counter = 0
    for i in range(n):
        for _ in range(_TRIES_FOR_START):
            for k in range(d):
                positions[i, k] = rules.spawn_size * (uniform(key, counter) - 0.5)
                counter += 1
            if _apart(i, positions, reach, links, rules.least_distance) and _clear(
                positions[i], world, rules.keep_out
            ):
                break
        else:
            return False
    return True


@inner_kernel
def _clear(position, world, margin):
    if world is not None:
        return clear_of_obstacles(load(position), world, margin)
    return True


@inner_kernel
def _apart(i, positions, reach, links, least_distance):
    """Whether robot i is far enough from the neighbours that have a place already; where links
    change, from everyone who has.
    """
    for j in range(i):
        if distance_squared(positions, j, i) < least_distance * least_distance:
            if reach is not None:
                return False
            if is_linked(j, i, links):
                return False
    return True


@inner_kernel
def _is_joined(positions, reach, places):
    """Whether links up to a length (m) connect a team; ``places``, (n,), is working memory."""
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


@inner_kernel(inline="text")
def _write_start(place, status, links, state, scratch):
    """Put a start into the state, and begin the statistics of its episode."""
    block, lane, teams = place.block, place.lane, state.teams
    initial = lyapunov_of_links(scratch.positions, links)
    store_links(block, lane, len(links[0]), state.links, scratch)
    store_team(scratch.positions, teams.positions, block, lane)
    for i in range(scratch.positions.shape[0]):
        teams.merged_into[place.team, i] = i
    teams.statistics[block, :, lane] = 0.0
    # V now and the closest pair follow with the next observation
    statistics = statistics_of(teams, block)
    statistics.status[lane] = status
    statistics.active[lane] = scratch.positions.shape[0]
    statistics.min_clearance[lane] = np.inf
    statistics.initial_lyapunov[lane] = initial


@inner_kernel(inline="text")
def _draw_attitudes(place, rules, keys, layout, robot, teams):
    """Frames of robots whose frame is fixed, or what the robot model keeps at the start and the
    frames that go with it.
    """
    key, lane = stream_key(keys[0], keys[1], FRAMES), place.lane
    for i in range(teams.merged_into.shape[1]):
        frames, memory = teams.frames[place.block, i], teams.memory[place.block, i]
        # numbers 3i to 3i + 2 are robot i's own, used or not: nobody's attitude shifts another's
        if rules.draw_frames:
            write(draw_rotation(key, 3 * i, layout.axes), frames, lane)
        if rules.draw_memory:
            write(init_memory(robot.model, key, 3 * i), memory, lane)
        kept = read(memory, lane, robot.memories)
        write(frame_of(robot.model, read(frames, lane, layout.entries), kept), frames, lane)
