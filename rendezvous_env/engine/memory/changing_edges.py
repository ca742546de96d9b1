"""Links that follow the moment: the stage that brings them up before a team is sensed."""

import math

from ...compilation import inner_kernel
from ...graphs.edges import load_links, pair_index
from ...physics.potential import lyapunov_of_links
from ...physics.random_streams import GRAPH, SWITCHING, stream_key, uniform
from ...physics.vectors import subtract
from ...sensors.imperfections import is_seen
from . import read, statistics_of, step_seen

_ROUNDING = 1e-9  # Share of a dwell time by which a step may miss its end


@inner_kernel(inline="code")
def update_links(block, setup, moves, state, changes):
    """Replace the links of a block by those of the moment at which it is sensed; ``changes`` are
    those of the state, by themselves: without any nothing is compiled.
    """
    if changes is not None:
        step = step_seen(statistics_of(state.teams, block), 0, moves)
        time, arcs = step * setup.constants.duration, state.links.weights[block]
        follow_changes(block, time, setup.layout, state.teams, arcs, changes)


@inner_kernel
def follow_changes(team, time, layout, teams, arcs, changes):
    """Write the arcs (n, n) of a team at a time (s) of its episode: those of the graph whose turn
    it is, led over to the robots that are left, and of these the ones in sight.

        a_IJ = max over i in I, j in J of a_ij                       (assumption 2)
    """
    if changes is not None:
        n, into = arcs.shape[0], teams.merged_into[team]
        turn = _whose_turn(team, time, changes)
        key = stream_key(changes.seeds[team], changes.episodes[team], GRAPH)
        low, high = changes.lows[turn], changes.highs[turn]
        arcs[:] = 0.0
        for i in range(n):
            for j in range(n):
                base, a, b = changes.bases[turn, i, j], into[i], into[j]
                if base > 0.0 and a != b:
                    counter = turn * (n * (n - 1) // 2)
                    gain = base * _drawn_factor(key, counter, i, j, n, low, high)
                    arcs[a, b] = max(arcs[a, b], gain)
        if changes.by_sight:
            _keep_in_sight(team, layout, teams, arcs, changes)


@inner_kernel
def _whose_turn(team, time, changes):
    """Index of the graph that holds at a time of the episode."""
    count, period = changes.bases.shape[0], math.floor(time / changes.dwell + _ROUNDING)
    if changes.at_random:
        key = stream_key(changes.seeds[team], changes.episodes[team], SWITCHING)
        return int(uniform(key, period) * count)
    return period % count


@inner_kernel
def _drawn_factor(key, counter, i, j, n, low, high):
    """What the weights a_ij and a_ji of an episode are multiplied by, from low to high: the same
    numbers of the stream as for a fixed graph whose weights are drawn.
    """
    return low + (high - low) * uniform(key, counter + pair_index(min(i, j), max(i, j), n))


@inner_kernel
def _keep_in_sight(team, layout, teams, arcs, changes):
    """Drop arcs to robots out of range or of the field of view."""
    for i in range(arcs.shape[0]):
        here = read(teams.positions[team, i], 0, layout.axes)
        frame = read(teams.frames[team, i], 0, layout.entries)
        for j in range(arcs.shape[0]):
            if arcs[i, j] > 0.0:
                offset = subtract(read(teams.positions[team, j], 0, layout.axes), here)
                if not is_seen(offset, frame, changes.reach, changes.half_field):
                    arcs[i, j] = 0.0


@inner_kernel
def begin_arcs(team, key, rules, layout, state, scratch, arcs):
    """Arcs of a team whose start has been written, and V at the start; nothing for other links, for
    which ``arcs`` is None. ``key`` is of the stream of the team's graph.
    """
    if arcs is not None:
        if rules.draw_weights:
            _multiply(key, rules.factors, arcs.weights)
        follow_changes(team, 0.0, layout, state.teams, arcs.weights, state.changes)
        count = load_links(team, 0, state.links, scratch)
        links = (scratch.first[:count], scratch.second[:count], scratch.weights[:count])
        initial = lyapunov_of_links(scratch.positions, links)
        statistics_of(state.teams, team).initial_lyapunov[0] = initial


@inner_kernel(inline="code")
def _multiply(key, factors, arcs):
    """Multiply given arcs by what is drawn for them, if anything is."""
    if factors is not None:
        n, (low, high) = arcs.shape[0], factors
        for i in range(n):
            for j in range(n):
                if i != j:
                    arcs[i, j] *= _drawn_factor(key, 0, i, j, n, low, high)
