"""Links that follow the moment: the stage that brings them up before a team is sensed."""

import math
from typing import Any

from numba.core import types

from ...compilation import chosen_by_type, inner_kernel, kernel
from ...graphs.edge_kinds import DirectedEdges
from ...graphs.edges import load_links, pair_index
from ...physics.potential import lyapunov_of_links
from ...physics.random_streams import GRAPH, SWITCHING, stream_key, uniform
from ...physics.vectors import difference, to_local
from ...sensors.line_of_sight import is_seen
from . import RUNNING, read, statistics_of

_ROUNDING = 1e-9
"""Share of a dwell time by which a step may miss its end."""


def bring_links_up(block: int, setup: Any, moves: Any, teams: Any, links: Any) -> None:
    """Replace the links of a block by those of the moment at which it is sensed.

    Args:
        block: index.
        setup: of the batch, see ``engine.memory``.
        moves: whether a step is being done, which its teams have not counted yet.
        teams: the fields of Teams.
        links: of a kind of ``link_kinds``; nothing is done unless they change.
    """
    if isinstance(links, DirectedEdges) and links.changes is not None:
        _follow(block, setup, moves, teams, links)


@inner_kernel(inline="code")
def _leave(block, setup, moves, teams, links):
    pass


@inner_kernel(inline="code")
def _follow(block, setup, moves, teams, links):
    statistics = statistics_of(teams, block)
    steps = statistics.steps[0]
    if moves and statistics.status[0] == RUNNING:
        steps += 1.0
    time = steps * setup.constants.duration
    follow_changes(block, time, setup.layout, teams, links.weights, links.changes)


@chosen_by_type(bring_links_up)
def _compiled_bring_links_up(block, setup, moves, teams, links):
    chosen = _follow if _change(links) else _leave
    return lambda block, setup, moves, teams, links: chosen(block, setup, moves, teams, links)


def _change(links: Any) -> bool:
    """Whether links of this numba type change."""
    if links.instance_class is not DirectedEdges:
        return False
    return not isinstance(links.types[links.fields.index("changes")], types.NoneType)


@kernel
def follow_changes(team, time, layout, teams, weights, changes):
    """Write the arcs of one team at a time (s) of its episode: those of the graph whose turn it is,
    led over to the robots that are left, and of these the ones in sight.

        a_IJ = max over i in I, j in J of a_ij                       (assumption 2)
    """
    if changes is not None:
        n, arcs, into = weights.shape[1], weights[team], teams.merged_into[team]
        turn = _whose_turn(team, time, changes)
        key = stream_key(changes.seeds[team], changes.episodes[team], GRAPH)
        low, high = changes.lows[turn], changes.highs[turn]
        arcs[:] = 0.0
        for i in range(n):
            for j in range(n):
                base, a, b = changes.bases[turn, i, j], into[i], into[j]
                if base > 0.0 and a != b:
                    counter = turn * (n * (n - 1) // 2)
                    gain = base * drawn_factor(key, counter, i, j, n, low, high)
                    arcs[a, b] = max(arcs[a, b], gain)
        if changes.by_sight:
            _keep_in_sight(team, layout, teams, arcs, changes)


@inner_kernel
def _whose_turn(team, time, changes):
    """Index of the graph that holds at a time of the episode."""
    count = changes.bases.shape[0]
    period = math.floor(time / changes.dwell + _ROUNDING)
    if changes.at_random:
        key = stream_key(changes.seeds[team], changes.episodes[team], SWITCHING)
        return int(uniform(key, period) * count)
    return period % count


@kernel
def drawn_factor(key, counter, i, j, n, low, high):
    """What the weights a_ij and a_ji of an episode are multiplied by, from low to high: the same
    numbers of the stream as for a fixed graph whose weights are drawn.
    """
    return low + (high - low) * uniform(key, counter + pair_index(min(i, j), max(i, j), n))


@inner_kernel
def _keep_in_sight(team, layout, teams, arcs, changes):
    """Drop arcs to robots out of range or of the field of view."""
    axes = layout.axes
    for i in range(arcs.shape[0]):
        here = read(teams.positions[team, i], 0, axes)
        frame = read(teams.frames[team, i], 0, layout.entries)
        for j in range(arcs.shape[0]):
            if arcs[i, j] > 0.0:
                offset = difference(here, read(teams.positions[team, j], 0, axes))
                if not is_seen(to_local(frame, offset), changes.reach, changes.half_field):
                    arcs[i, j] = 0.0


# ---- at the start -------------------------------------------------------------------------------


def begin_links(
    team: int, key: Any, rules: Any, layout: Any, state: Any, positions: Any, scratch: Any
) -> None:
    """Directed edges of a team whose start has been written, and V at the start; else nothing.

    Args:
        team: index.
        key: of the stream of its graph, uint64.
        rules: StartRules.
        layout: of the memory.
        state: of the batch.
        positions: (n, d), m.
        scratch: working memory for a team.
    """
    if isinstance(state.links, DirectedEdges):
        _begin_arcs(team, key, rules, layout, state, positions, scratch)


@inner_kernel(inline="code")
def _begin_no_arcs(team, key, rules, layout, state, positions, scratch):
    pass


@chosen_by_type(begin_links)
def _compiled_begin_links(team, key, rules, layout, state, positions, scratch):
    links = state.types[state.fields.index("links")]
    chosen = _begin_arcs if links.instance_class is DirectedEdges else _begin_no_arcs
    return lambda team, key, rules, layout, state, positions, scratch: chosen(
        team, key, rules, layout, state, positions, scratch
    )


@inner_kernel
def _begin_arcs(team, key, rules, layout, state, positions, scratch):
    links, teams = state.links, state.teams
    _multiply(key, rules, rules.factors, links.weights[team])
    follow_changes(team, 0.0, layout, teams, links.weights, links.changes)
    count = load_links(team, 0, links, scratch)
    listed = (scratch.first[:count], scratch.second[:count], scratch.weights[:count])
    statistics_of(teams, team).initial_lyapunov[0] = lyapunov_of_links(positions, listed)


@inner_kernel(inline="code")
def _multiply(key, rules, factors, arcs):
    """Multiply given arcs by what is drawn for them, if anything is."""
    if factors is not None:
        if rules.draw_weights:
            n = arcs.shape[0]
            for i in range(n):
                for j in range(n):
                    if i != j:
                        arcs[i, j] *= drawn_factor(key, 0, i, j, n, factors[0], factors[1])
