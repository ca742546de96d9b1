"""How an episode begins: graph, obstacles, places and attitudes, drawn from their own streams."""

from typing import NamedTuple

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.edges import arcs_of, load_links, store_links
from ...graphs.random_graphs import GraphRules, draw_links
from ...obstacles.fields import Rules, draw_obstacles, is_possible
from ...physics.potential import lyapunov_of_links
from ...physics.random_streams import FRAMES, GRAPH, OBSTACLES, START, draw_rotation, stream_key
from ...robots.motion import frame_of, init_memory
from ..memory import (
    BatchState,
    Place,
    Teams,
    TeamScratch,
    lane_count,
    load_team,
    read,
    statistics_of,
    store_team,
    write,
)
from ..memory.changing_edges import begin_arcs
from ..memory.obstacles import obstacles_of
from .places import TRIES_FOR_WAYS, draw_places, stream_of_try

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
    """Begin a new episode in the teams with these indices; what is given already stands in the
    state.

    Args:
        indices: (count,), teams.
        status: what they are to have.
        rules: StartRules.
        streams: seeds, (B,) uint64, and episodes, (B,).
        setup: layout of the memory and robot.
        state: the fields of BatchState, those of Teams as a tuple.
        scratch: the fields of TeamScratch, of one thread.

    Returns:
        Index of the first team that found no room for its start, its obstacles or its links, or −1;
        and which of them: FITS, NO_ROOM or TOO_MANY_LINKS.
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
    """What of one team's start may find no room: obstacles and places; whether it fits.

    A start in which some robots are walled in, where the field promises none, is drawn again.
    ``scene`` is links and obstacles.
    """
    positions, world = scratch.positions, scene[1]
    key = stream_key(keys[0], keys[1], START)
    if field is not None:
        if rules.draw_obstacles:
            # obstacles keep clear of given places; places that are drawn keep clear of obstacles
            n_starts = 0 if rules.draw_positions else positions.shape[0]
            field_key = stream_key(keys[0], keys[1], OBSTACLES)
            for trial in range(TRIES_FOR_WAYS):
                own, of_field = stream_of_try(key, trial), stream_of_try(field_key, trial)
                if not draw_obstacles(of_field, field, positions, n_starts, world):
                    return False
                if not draw_places(own, rules, reach, scene, positions, scratch.counts):
                    return False
                if is_possible(field, world, positions, scratch.chains):
                    return True
            return False
    return draw_places(key, rules, reach, scene, positions, scratch.counts)


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
