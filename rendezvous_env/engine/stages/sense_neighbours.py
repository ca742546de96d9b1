"""Stage that senses neighbours: their bearings, V, and the closest pair."""

import math

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.edges import ARCS, edge_weight, pair_index
from ...physics.packing import apart
from ...physics.potential import bearing_factor, observed, sighting
from ...physics.random_streams import GRAPH, SWITCHING, stream_key, uniform
from ...physics.vectors import subtract
from ...sensors.imperfections import is_seen
from ..memory import (
    SENSED_LYAPUNOV,
    SQUARE_CLOSEST,
    lane_count,
    load_fields,
    load_positions,
    sensed_step,
    store_fields,
    write_row,
)

_ROUNDING = 1e-9  # fraction of a dwell time by which a step may miss its end


@kernel
def sense_pairs(width, axes, entries, first, last, robots, weights, pair, environments, rows):
    """Sense every pair of robots once, in index order, in all lanes; absent links have weight 0.

    Rows, (blocks, n, rows, L·d) float32, are those of neighbours in index order. ``pair``, ((d +
    3)·L,), is working memory: offset (m), factor (1/s), V/2 and least square distance so far.
    """
    d, n = len(axes), robots.shape[1]
    for block in range(first, last):
        _begin_pairs(width, d, pair)
        e, row = 0, rows[block - first]
        for i in range(n):
            for j in range(i + 1, n):
                _sight(width, axes, robots[block, i], robots[block, j], weights[block, e], pair)
                # in index order robot j is row j − 1 of robot i < j, and robot i is row i of j
                _store_sight(width, axes, entries, pair, 1.0, robots[block, i], row[i, j - 1])
                _store_sight(width, axes, entries, pair, -1.0, robots[block, j], row[j, i])
                e += 1
        _end_pairs(width, d, pair, environments[block])


@inner_kernel(inline="code")
def _begin_pairs(width, d, pair):
    lanes = lane_count(width)
    for lane in range(lanes):
        pair[(d + 1) * lanes + lane], pair[(d + 2) * lanes + lane] = 0.0, np.inf


@inner_kernel(inline="code")
def _end_pairs(width, d, pair, environment):
    lanes = lane_count(width)
    for lane in range(lanes):
        # each pair is visited once, and V counts each edge twice
        environment[SENSED_LYAPUNOV * lanes + lane] = 2.0 * pair[(d + 1) * lanes + lane]
        environment[SQUARE_CLOSEST * lanes + lane] = pair[(d + 2) * lanes + lane]


@inner_kernel(inline="code")
def _sight(width, axes, here, there, gain, pair):
    """``sighting`` of two robots in every lane."""
    lanes, d = lane_count(width), len(axes)
    for lane in range(lanes):
        offset, square, distance, factor = sighting(
            load_fields(here, 0, lane, lanes, axes),
            load_fields(there, 0, lane, lanes, axes),
            gain[lane],
        )
        store_fields(offset, pair, 0, lane, lanes)
        pair[d * lanes + lane] = factor
        pair[(d + 1) * lanes + lane] += gain[lane] * distance
        least = pair[(d + 2) * lanes + lane]
        nearer = (gain[lane] > 0.0) & (square < least)
        pair[(d + 2) * lanes + lane] = square if nearer else least


@inner_kernel(inline="code")
def _store_sight(width, axes, entries, pair, sign, robot, row):
    """Write one robot's row about the other robot of a pair, in its local frame.

    The sign is −1 for the second robot.
    """
    lanes, d = lane_count(width), len(axes)
    for lane in range(lanes):
        frame = load_fields(robot, d, lane, lanes, entries)
        offset = load_fields(pair, 0, lane, lanes, axes)
        write_row(observed(frame, offset, sign * pair[d * lanes + lane]), row, lane)


@kernel
def sense_links(axes, entries, first, last, slots, links, robots, counts, environments, rows, over):
    """Sense every link of environments with a list of links or a matrix of arcs.

    The order of robots is that of the rows. ``counts``, (n,), is working memory. ``over``, (B,),
    receives a robot with more neighbours than ``slots``.
    """
    n = robots.shape[1]
    for block in range(first, last):
        rows[block - first] = 0.0
        counts[:] = 0
        half_lyapunov, closest = 0.0, np.inf
        is_matrix = links.form == ARCS
        for e in range(n * n if is_matrix else links.first.shape[1]):
            if is_matrix:
                i, j = e // n, e % n
                back = links.weights[block, j * n + i, 0]
                weight = 0.5 * (links.weights[block, e, 0] + back) if i < j else 0.0
            else:
                i, j = links.first[block, e], links.second[block, e]
                weight = links.weights[block, e, 0]
            if weight > 0.0:
                offset, square, distance, _ = sighting(
                    load_fields(robots[block, i], 0, 0, 1, axes),
                    load_fields(robots[block, j], 0, 0, 1, axes),
                    weight,
                )
                half_lyapunov += weight * distance
                closest = min(closest, square)
                for end in range(2):
                    a, b = (j, i) if end else (i, j)
                    gain = edge_weight(links, block, n, a, b, weight)
                    if gain > 0.0:
                        # with a row for each other robot arcs have their own, others the next one
                        own = is_matrix and slots == n - 1
                        slot = b - (b > a) if own else counts[a]
                        counts[a] += 1
                        if slot < slots:
                            frame = load_fields(robots[block, a], len(axes), 0, 1, entries)
                            factor = bearing_factor(-gain if end else gain, distance)
                            seen = observed(frame, offset, factor)
                            write_row(seen, rows[block - first, a, slot], 0)
                        else:
                            over[block] = a
        environments[block, SENSED_LYAPUNOV] = 2.0 * half_lyapunov
        environments[block, SQUARE_CLOSEST] = closest


@kernel
def update_links(
    axes,
    entries,
    first,
    last,
    moves,
    duration,
    changes,
    seeds,
    episodes,
    robots,
    merged_into,
    environments,
    links,
):
    """Replace arcs by those at the time of sensing."""
    for block in range(first, last):
        time = sensed_step(environments[block], 0, 1, moves) * duration
        key = seeds[block], episodes[block]
        _follow(axes, entries, time, key, changes, robots[block], merged_into[block], links, block)


@inner_kernel
def _follow(axes, entries, time, key, changes, robots, into, links, block):
    """Write the arcs of one environment at a time (s) of its episode.

    They are those of the current graph, contracted to active robots, and visible.

        a_IJ = max over i in I, j in J of a_ij                       (assumption 2)
    """
    n = robots.shape[0]
    arcs = links.weights[block].reshape(n, n)
    graph = _current_graph(time, stream_key(key[0], key[1], SWITCHING), changes)
    stream = stream_key(key[0], key[1], GRAPH)
    low, high = changes.lows[graph], changes.highs[graph]
    arcs[:] = 0.0
    for i in range(n):
        for j in range(n):
            base, a, b = changes.bases[graph, i, j], into[i], into[j]
            if base > 0.0 and a != b:
                counter = graph * (n * (n - 1) // 2)
                gain = base * drawn_factor(stream, counter, i, j, n, low, high)
                arcs[a, b] = max(arcs[a, b], gain)
    if changes.by_sight:
        _keep_in_sight(axes, entries, robots, arcs, changes)


@inner_kernel
def _current_graph(time, key, changes):
    """Index of the graph at a time of the episode."""
    count, period = changes.bases.shape[0], math.floor(time / changes.dwell + _ROUNDING)
    if changes.at_random:
        return int(uniform(key, period) * count)
    return int(period % count)


@inner_kernel
def drawn_factor(key, counter, i, j, n, low, high):
    """Factor of the weights a_ij and a_ji in an episode, from low to high.

    It uses the same numbers of the stream as a fixed graph with sampled weights.
    """
    return low + (high - low) * uniform(key, counter + pair_index(min(i, j), max(i, j), n))


@inner_kernel
def _keep_in_sight(axes, entries, robots, arcs, changes):
    """Drop arcs to robots out of range or outside the field of view."""
    for i in range(arcs.shape[0]):
        here = load_fields(robots[i], 0, 0, 1, axes)
        frame = load_fields(robots[i], len(axes), 0, 1, entries)
        for j in range(arcs.shape[0]):
            if arcs[i, j] > 0.0:
                offset = subtract(load_fields(robots[j], 0, 0, 1, axes), here)
                if not is_seen(offset, frame, changes.reach, changes.half_field):
                    arcs[i, j] = 0.0


@kernel
def hide_docked(lanes, first, last, docked, robots, positions, rows):
    """Zero the rows of robots whose bodies touch, as a link ends with a merge.

    A robot in contact with all others keeps its rows, because it would observe nothing otherwise.

    ``docked``, m, is halfway into the merge radius: bodies at its edge would alternate between
    contact and no contact. ``positions``, (n, 2), is working memory.
    """
    n = positions.shape[0]
    for block in range(first, last):
        for lane in range(lanes):
            load_positions(robots[block], lane, lanes, positions)
            for i in range(n):
                touched = 0
                for j in range(n):
                    touched += j != i and apart(positions, i, j) <= docked
                for j in range(n):
                    if touched < n - 1 and j != i and apart(positions, i, j) <= docked:
                        row = rows[block - first, i, j - (j > i)]
                        row[2 * lane : 2 * lane + 2] = 0.0
