"""How an episode begins: graph, obstacles, places and attitudes, drawn from their own streams.

Everything is drawn before anything is written, so that a team that finds no room leaves all as it
was.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import inner_kernel, kernel
from ...graphs.edges import arcs_of, copy_links, load_links, store_links
from ...graphs.random_graphs import GraphRules, draw_links
from ...obstacles.fields import Rules, draw_obstacles, is_possible
from ...physics.potential import lyapunov_of_links
from ...physics.random_streams import FRAMES, GRAPH, OBSTACLES, START, draw_rotation, stream_key
from ...robots.motion import frame_of, init_memory
from ..memory import BatchState, Place, Teams, TeamScratch, lane_count, read, statistics_of, write
from ..memory.changing_edges import begin_arcs
from ..memory.obstacles import copy_obstacles, obstacles_of
from .places import TRIES_FOR_WAYS, draw_places, stream_of_try

FITS, NO_ROOM, TOO_MANY_LINKS = range(3)


class Spacing(NamedTuple):
    """How places are drawn where links change: everyone keeps apart from everyone."""

    reach: float
    """Links up to this length (m) connect the start; inf if that is not asked for."""


class StartRules(NamedTuple):
    """How an episode begins: what is drawn, and from where."""

    draw_positions: bool
    draw_frames: bool
    draw_memory: bool
    draw_weights: bool
    draw_obstacles: bool
    spawn_size: float
    least_distance: float
    keep_out: float
    factors: tuple[float, float] | None
    """The range of what given arcs are multiplied by, or None."""
    spacing: Spacing | None
    """Of places where links change; None where robots keep apart from their neighbours alone."""
    graph: GraphRules | None
    """None where no episode draws anything of its graph: then nothing of that is compiled."""
    field: Rules | None
    """Likewise, of its obstacles."""


class SampledStarts(NamedTuple):
    """Starts that have been drawn and not yet written, one for each team that is reset."""

    positions: NDArray[np.float64]
    """(count, n, d), m."""
    first: NDArray[np.int64]
    """(count, E), links, see ``Links``."""
    second: NDArray[np.int64]
    """(count, E)."""
    weights: NDArray[np.float64]
    """(count, E), m/s."""
    n_links: NDArray[np.int64]
    """(count,)."""
    chains: NDArray[np.int64]
    """(M, 2), working memory, see ``walled_in``."""


@kernel
def reset_teams(indices, status, rules, streams, setup, state, scratch, sampled, worlds):
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
        sampled: the fields of SampledStarts.
        worlds: room for the obstacles of ``count`` teams, of the type of the obstacles.

    Returns:
        Index of the first team that found no room for its start, its obstacles or its links, or −1;
        and which of them: FITS, NO_ROOM or TOO_MANY_LINKS. Unless it fits nothing has changed.
    """
    seeds, episodes = streams
    layout, robot = setup
    state = BatchState(Teams(*state[0]), state[1], state[2], state[3])
    scratch, sampled = TeamScratch(*scratch), SampledStarts(*sampled)
    # there is working memory for one team: sampled starts wait until all teams have one
    for k in range(len(indices)):
        team, positions = indices[k], sampled.positions[k]
        keys = (seeds[team], episodes[team])
        count = _draw_links(team, keys, rules, rules.graph, layout, state.links, scratch)
        if count < 0:
            return team, TOO_MANY_LINKS
        sampled.n_links[k] = count
        links = (sampled.first[k], sampled.second[k], sampled.weights[k])
        copy_links((scratch.first, scratch.second, scratch.weights), links, count)
        _read_positions(_place(team, layout), state.teams, positions)
        copy_obstacles(state.obstacles, team, worlds, k)
        listed = (scratch.first[:count], scratch.second[:count], scratch.weights[:count])
        scene, counts = (listed, obstacles_of(worlds, k)), (sampled.chains, scratch.counts)
        if not _draw_room(keys, rules, rules.field, rules.spacing, scene, positions, counts):
            return team, NO_ROOM
    for k in range(len(indices)):
        team, count = indices[k], sampled.n_links[k]
        links = (sampled.first[k], sampled.second[k], sampled.weights[k])
        copy_links(links, (scratch.first, scratch.second, scratch.weights), count)
        copy_obstacles(worlds, k, state.obstacles, team)
        place, positions = _place(team, layout), sampled.positions[k]
        _write_start(place, status, count, state, positions, scratch)
        _draw_attitudes(place, rules, (seeds[team], episodes[team]), layout, robot, state.teams)
        key = stream_key(seeds[team], episodes[team], GRAPH)
        arcs = arcs_of(state.links, team)
        begin_arcs(team, key, rules, layout, state, positions, scratch, arcs)
    return -1, FITS


@inner_kernel(inline="text")
def _place(team, layout):
    """Where a team is."""
    lanes = lane_count(layout.width)
    return Place(team // lanes, team % lanes, team)


@inner_kernel
def _draw_links(team, keys, rules, graph, layout, links, scratch):
    """Links of a start into working memory: drawn, or as given; their number, −1 for too many."""
    # known while compiling: without rules for a graph nothing of its drawing is compiled
    if graph is not None:
        if rules.draw_weights:
            key = stream_key(keys[0], keys[1], GRAPH)
            first, second, weights = scratch.first, scratch.second, scratch.weights
            n = len(scratch.counts)
            return draw_links(key, n, graph, first, second, weights, scratch.counts)
    place = _place(team, layout)
    return load_links(place.block, place.lane, links, scratch)


@inner_kernel
def _draw_room(keys, rules, field, spacing, scene, positions, counts):
    """What of one team's start may find no room: obstacles and places; whether it fits.

    A start in which some robots are walled in, where the field promises none, is drawn again.
    ``scene`` is links and obstacles, ``counts`` working memory (chains (M, 2), counts (n,)).
    """
    key, world = stream_key(keys[0], keys[1], START), scene[1]
    chains, own = counts
    if field is not None:
        if rules.draw_obstacles:
            # obstacles keep clear of given places; places that are drawn keep clear of obstacles
            n_starts = 0 if rules.draw_positions else positions.shape[0]
            field_key = stream_key(keys[0], keys[1], OBSTACLES)
            for trial in range(TRIES_FOR_WAYS):
                if not draw_obstacles(
                    stream_of_try(field_key, trial), field, positions, n_starts, world
                ) or not draw_places(
                    stream_of_try(key, trial), rules, spacing, scene, positions, own
                ):
                    return False
                if is_possible(field, world, positions, chains):
                    return True
            return False
    return draw_places(key, rules, spacing, scene, positions, own)


@inner_kernel(inline="text")
def _read_positions(place, teams, out):
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[i, k] = teams.positions[place.block, i, k, place.lane]


@inner_kernel(inline="text")
def _write_start(place, status, count, state, positions, scratch):
    """Put a start into the state, and begin the statistics of its episode."""
    block, lane, teams = place.block, place.lane, state.teams
    n, d = positions.shape
    listed = (scratch.first[:count], scratch.second[:count], scratch.weights[:count])
    initial = lyapunov_of_links(positions, listed)
    store_links(block, lane, count, state.links, scratch)
    for i in range(n):
        teams.merged_into[place.team, i] = i
        for k in range(d):
            teams.positions[block, i, k, lane] = positions[i, k]
    teams.statistics[block, :, lane] = 0.0
    # V now and the closest pair follow with the next observation
    statistics = statistics_of(teams, block)
    statistics.status[lane] = status
    statistics.active[lane] = n
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
