"""How an episode begins: graph, obstacles, places and attitudes, drawn from their own streams.

Everything is drawn before anything is written, so that a team that finds no room leaves all as it
was.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import inner_kernel, kernel
from ...equations.potential import lyapunov_of_links
from ...equations.random_streams import (
    FRAMES,
    GRAPH,
    OBSTACLES,
    START,
    draw_rotation,
    stream_key,
)
from ...equations.robots.motion import begin_memory, frame_of
from ..changing_links import begin_links
from ..links import copy_links, load_links, store_links
from ..memory import (
    ACTIVE,
    INITIAL_LYAPUNOV,
    MIN_CLEARANCE,
    STATISTICS,
    STATUS,
    AtHand,
    Teams,
    lane_count,
    read,
    write,
)
from ..worlds import copy_world, world_of
from .draw_graph import GraphRules, draw_links
from .fields import Rules, draw_obstacles, is_possible
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


class Drafts(NamedTuple):
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
def reset_teams(
    indices,
    status,
    rules,
    seeds,
    episodes,
    layout,
    robot,
    teams,
    links,
    obstacles,
    hand,
    drafts,
    worlds,
):
    """Begin a new episode in the teams with these indices; what is given already stands in the
    state.

    Args:
        indices: (count,), teams.
        status: what they are to have.
        rules: StartRules.
        seeds: (B,) uint64.
        episodes: (B,).
        layout: of the memory.
        robot: its model.
        teams: the fields of Teams.
        links: of a kind of ``link_kinds``.
        obstacles: Balls or Shapes with a leading axis B, or None.
        hand: the fields of AtHand, of one thread.
        drafts: the fields of Drafts.
        worlds: room for the obstacles of ``count`` teams, of the type of ``obstacles``.

    Returns:
        Index of the first team that found no room for its start, its obstacles or its links, or −1;
        and which of them: FITS, NO_ROOM or TOO_MANY_LINKS. Unless it fits nothing has changed.
    """
    teams = Teams(*teams)
    hand, drafts = AtHand(*hand), Drafts(*drafts)
    # there is one team's working memory at hand: starts wait in the drafts until all teams have one
    for k in range(len(indices)):
        team, positions = indices[k], drafts.positions[k]
        keys = (seeds[team], episodes[team])
        count = _draw_links(team, keys, rules, rules.graph, layout, links, hand)
        if count < 0:
            return team, TOO_MANY_LINKS
        drafts.n_links[k] = count
        drafted = (drafts.first[k], drafts.second[k], drafts.weights[k])
        copy_links((hand.first, hand.second, hand.weights), drafted, count)
        _read_positions(team, layout, teams, positions)
        copy_world(obstacles, team, worlds, k)
        listed = (hand.first[:count], hand.second[:count], hand.weights[:count])
        world = world_of(worlds, k)
        if not _draw_room(
            keys, rules, rules.field, rules.spacing, listed, world, positions, drafts.chains, hand
        ):
            return team, NO_ROOM
    for k in range(len(indices)):
        team, count = indices[k], drafts.n_links[k]
        drafted = (drafts.first[k], drafts.second[k], drafts.weights[k])
        copy_links(drafted, (hand.first, hand.second, hand.weights), count)
        copy_world(worlds, k, obstacles, team)
        _write_start(team, status, count, layout, teams, links, drafts.positions[k], hand)
        _draw_attitudes(team, rules, (seeds[team], episodes[team]), layout, robot, teams)
        key = stream_key(seeds[team], episodes[team], GRAPH)
        begin_links(
            team, key, rules, rules.factors, layout, teams, links, drafts.positions[k], hand
        )
    return -1, FITS


@inner_kernel
def _draw_links(team, keys, rules, graph, layout, links, hand):
    """Links of a start into working memory: drawn, or as given; their number, −1 for too many."""
    # known while compiling: without rules for a graph nothing of its drawing is compiled
    if graph is not None:
        if rules.draw_weights:
            key = stream_key(keys[0], keys[1], GRAPH)
            n = len(hand.counts)
            return draw_links(key, n, graph, hand.first, hand.second, hand.weights, hand.counts)
    lanes = lane_count(layout.width)
    return load_links(team // lanes, team % lanes, links, hand)


@inner_kernel
def _draw_room(keys, rules, field, spacing, links, world, positions, chains, hand):
    """What of one team's start may find no room: obstacles and places; whether it fits.

    A start in which some robots are walled in, where the field promises none, is drawn again.
    """
    key = stream_key(keys[0], keys[1], START)
    if field is not None:
        if rules.draw_obstacles:
            # obstacles keep clear of given places; places that are drawn keep clear of obstacles
            n_starts = 0 if rules.draw_positions else positions.shape[0]
            field_key = stream_key(keys[0], keys[1], OBSTACLES)
            for trial in range(TRIES_FOR_WAYS):
                if not draw_obstacles(
                    stream_of_try(field_key, trial), field, positions, n_starts, world
                ) or not draw_places(
                    stream_of_try(key, trial), rules, spacing, links, world, positions, hand
                ):
                    return False
                if is_possible(field, world, positions, chains):
                    return True
            return False
    return draw_places(key, rules, spacing, links, world, positions, hand)


@inner_kernel
def _read_positions(team, layout, teams, out):
    lanes = lane_count(layout.width)
    block, lane = team // lanes, team % lanes
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[i, k] = teams.positions[block, i, k * lanes + lane]


@inner_kernel
def _write_start(team, status, count, layout, teams, links, positions, hand):
    """Put a start into the state, and begin the statistics of its episode."""
    lanes = lane_count(layout.width)
    block, lane = team // lanes, team % lanes
    n, d = positions.shape
    listed = (hand.first[:count], hand.second[:count], hand.weights[:count])
    initial = lyapunov_of_links(positions, listed)
    store_links(block, lane, count, links, hand)
    for i in range(n):
        teams.merged_into[team, i] = i
        for k in range(d):
            teams.positions[block, i, k * lanes + lane] = positions[i, k]
    statistics = teams.statistics[block]
    for entry in range(len(STATISTICS)):
        statistics[entry * lanes + lane] = 0.0
    # V now and the closest pair follow with the next observation
    statistics[STATUS * lanes + lane] = status
    statistics[ACTIVE * lanes + lane] = n
    statistics[MIN_CLEARANCE * lanes + lane] = np.inf
    statistics[INITIAL_LYAPUNOV * lanes + lane] = initial


@inner_kernel
def _draw_attitudes(team, rules, keys, layout, robot, teams):
    """Frames of robots whose frame is fixed, or what the robot model keeps at the start and the
    frames that go with it.
    """
    lanes, width = lane_count(layout.width), layout.width
    block, lane = team // lanes, team % lanes
    key = stream_key(keys[0], keys[1], FRAMES)
    for i in range(teams.merged_into.shape[1]):
        # numbers 3i to 3i + 2 are robot i's own, used or not: nobody's attitude shifts another's
        if rules.draw_frames:
            frame = draw_rotation(key, 3 * i, layout.axes)
            write(frame, teams.frames[block, i], 0, lane, width)
        if rules.draw_memory:
            kept = begin_memory(robot.model, key, 3 * i)
            write(kept, teams.memory[block, i], 0, lane, width)
        fixed = read(teams.frames[block, i], lane, width, layout.entries)
        memory = read(teams.memory[block, i], lane, width, robot.memories)
        write(frame_of(robot.model, fixed, memory), teams.frames[block, i], 0, lane, width)
