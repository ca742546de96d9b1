"""How the links of B teams are kept, and the list of one team that the equations take.

Stages choose by these types while they are compiled: a step contains the code of one kind alone.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import by_type, inner_kernel, kernel


class DenseEdges(NamedTuple):
    """Links as a weight for each pair i < j of robots, 0 where there is none."""

    first: NDArray[np.int64]  # (pairs,), i of every pair, for all teams
    second: NDArray[np.int64]  # (pairs,), j
    weights: NDArray[np.float64]  # (blocks, pairs, L), a_ij, m/s


class EdgeList(NamedTuple):
    """Links as a list for each team; only where a block holds one team."""

    first: NDArray[np.int64]  # (B, E), the lower robot of each link, sorted
    second: NDArray[np.int64]  # (B, E), the other robot
    weights: NDArray[np.float64]  # (B, E), a_ij, m/s; 0 behind the last one


class Changes(NamedTuple):
    """How arcs follow the moment: a list of graphs that take turns, and what is in sight."""

    bases: NDArray[np.float64]  # (G, n, n), a_ij of each graph before drawing, m/s
    # (G,), each arc's weight is multiplied by a number from low to high, drawn for every pair and
    # episode
    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    dwell: float  # how long a graph holds, s; inf for ever
    at_random: bool  # whether the next graph is drawn from the list rather than the next in it
    by_sight: bool  # whether a robot has arcs only to robots that it sees
    reach: float  # range of sight, m
    half_field: float  # half the field of view, rad
    seeds: NDArray[np.uint64]  # (B,), of the teams
    episodes: NDArray[np.int64]  # (B,), their numbers


class DirectedEdges(NamedTuple):
    """Links that can be one-way, as a matrix for each team; only where a block holds one team.

    As pairs they are those that a_ij or a_ji joins, with the mean ā_ij of the two: then
    V = 2 Σ ā_ij ‖p_i − p_j‖ over pairs is Σ_i Σ_j a_ij ‖p_i − p_j‖.
    """

    weights: NDArray[np.float64]  # (B, n, n), a_ij, what robot i gives to robot j, m/s
    changes: Changes | None  # None where only merges change them


Links = DenseEdges | EdgeList | DirectedEdges


def _arcs(links, team):
    return DirectedEdges(links.weights[team], None)


@by_type("links", lambda kind: _arcs if kind is DirectedEdges else None)
def arcs_of(links, team):
    """DirectedEdges of one team, whose weights are (n, n); None of links that go both ways."""


@inner_kernel(inline="code")
def _load_pairs(block, lane, links, scratch):
    """List a team's links with a weight, in the order of their robots; how many there are."""
    count = 0
    for pair in range(links.first.shape[0]):
        weight = links.weights[block, pair, lane]
        if weight > 0.0:
            scratch.first[count] = links.first[pair]
            scratch.second[count] = links.second[pair]
            scratch.weights[count] = weight
            count += 1
    return count


@inner_kernel(inline="code")
def _load_list(block, lane, links, scratch):
    count = 0
    for e in range(links.first.shape[1]):
        if links.weights[block, e] > 0.0:
            scratch.first[count] = links.first[block, e]
            scratch.second[count] = links.second[block, e]
            scratch.weights[count] = links.weights[block, e]
            count += 1
    return count


@inner_kernel(inline="code")
def _load_arcs(block, lane, links, scratch):
    count, n = 0, links.weights.shape[1]
    for i in range(n):
        for j in range(i + 1, n):
            both = links.weights[block, i, j] + links.weights[block, j, i]
            if both > 0.0:
                scratch.first[count], scratch.second[count] = i, j
                scratch.weights[count] = 0.5 * both
                count += 1
    return count


@by_type(
    "links", {DenseEdges: _load_pairs, EdgeList: _load_list, DirectedEdges: _load_arcs}.__getitem__
)
def load_links(block, lane, links, scratch):
    """Bring the links of one team into working memory; how many there are."""


@inner_kernel(inline="code")
def _store_pairs(block, lane, count, links, scratch):
    n = scratch.lengths.shape[0]
    for pair in range(links.first.shape[0]):
        links.weights[block, pair, lane] = 0.0
    for e in range(count):
        if scratch.weights[e] > 0.0:
            i, j = scratch.first[e], scratch.second[e]
            links.weights[block, pair_index(i, j, n), lane] = scratch.weights[e]


@inner_kernel(inline="code")
def _store_list(block, lane, count, links, scratch):
    sort_links(scratch.first, scratch.second, scratch.weights, count)
    kept = 0
    for e in range(count):
        if scratch.weights[e] > 0.0:
            links.first[block, kept] = scratch.first[e]
            links.second[block, kept] = scratch.second[e]
            links.weights[block, kept] = scratch.weights[e]
            kept += 1
    for e in range(kept, links.first.shape[1]):
        links.weights[block, e] = 0.0


@inner_kernel(inline="code")
def _store_arcs(block, lane, count, links, scratch):
    """Nothing: merges contract the matrix itself, see ``merge_swept``."""


@by_type(
    "links",
    {DenseEdges: _store_pairs, EdgeList: _store_list, DirectedEdges: _store_arcs}.__getitem__,
)
def store_links(block, lane, count, links, scratch):
    """Put the first ``count`` links of working memory back; those of weight 0 are gone."""


@kernel
def pair_index(i, j, n):
    """Place of the pair i < j in the list of all pairs of n robots, in the order of indices."""
    return i * n - i * (i + 1) // 2 + j - i - 1


@kernel
def sort_links(first, second, weights, count):
    """Sort the first links by their robots. By insertion: merging leaves most of them in order."""
    for e in range(1, count):
        i, j, weight = first[e], second[e], weights[e]
        place = e
        while place > 0 and (
            first[place - 1] > i or (first[place - 1] == i and second[place - 1] > j)
        ):
            first[place], second[place] = first[place - 1], second[place - 1]
            weights[place] = weights[place - 1]
            place -= 1
        first[place], second[place], weights[place] = i, j, weight
