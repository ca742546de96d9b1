"""Storage of links of B environments, and the list of one environment for equations.

There are three forms of storage, of one type; kernels select by a form number.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import inner_kernel, kernel

DENSE, LISTED, ARCS = range(3)
"""Forms: a weight for each pair i < j of robots, 0 without a link; a list of links per
environment; a matrix a_ij per environment, for directed links."""


class Links(NamedTuple):
    """Links of B environments; LISTED and ARCS only with one environment per block.

    Arcs as pairs are those that a_ij or a_ji connects, with the mean ā_ij of the two. Then V = 2 Σ
    ā_ij ‖p_i − p_j‖ over pairs equals Σ_i Σ_j a_ij ‖p_i − p_j‖.
    """

    form: int  # DENSE, LISTED or ARCS
    first: NDArray[np.int64]  # (1, pairs) or (B, E), lower robot, sorted; empty for arcs
    second: NDArray[np.int64]  # the other robot
    weights: NDArray[np.float64]
    """Weights, m/s: (blocks, pairs, L); (B, E, 1), 0 for unused entries; or (B, n·n, 1), a_ij of
    robot i for robot j at i·n + j."""


class Changes(NamedTuple):
    """Time dependence of arcs: a list of alternating graphs, and visibility."""

    bases: NDArray[np.float64]  # (G, n, n), nominal a_ij of each graph, m/s
    # (G,), range of the factor of each arc's weight, sampled for every pair and
    # episode
    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    dwell: float  # dwell time of a graph, s; inf without switching
    at_random: bool  # whether the next graph is sampled from the list
    by_sight: bool  # whether a robot has arcs only to visible robots
    reach: float  # sensing range, m
    half_field: float  # half the field of view, rad


@inner_kernel
def load_links(links, block, lane, n, first, second, weights):
    """List the nonzero links of one environment, in the order of its robots, into three arrays.

    Returns their number.
    """
    count, kept = 0, links.weights[block]
    if links.form == ARCS:
        for i in range(n):
            for j in range(i + 1, n):
                both = kept[i * n + j, 0] + kept[j * n + i, 0]
                if both > 0.0:
                    first[count], second[count], weights[count] = i, j, 0.5 * both
                    count += 1
        return count
    row = block if links.form == LISTED else 0
    for e in range(links.first.shape[1]):
        weight = kept[e, lane]
        if weight > 0.0:
            first[count], second[count] = links.first[row, e], links.second[row, e]
            weights[count] = weight
            count += 1
    return count


@inner_kernel
def list_pairs(links, block, n, first, second, weights):
    """``load_links`` for all lanes of a block: of DENSE links all pairs, linked or not.

    Returns their number; weights of DENSE links are not written.
    """
    if links.form == DENSE:
        for e in range(links.first.shape[1]):
            first[e], second[e] = links.first[0, e], links.second[0, e]
        return links.first.shape[1]
    return load_links(links, block, 0, n, first, second, weights)


@inner_kernel
def store_links(links, block, lane, n, first, second, weights, count):
    """Store the first ``count`` links of three arrays; those of weight 0 are dropped.

    No effect for arcs: merges contract the matrix itself, see ``merge_swept``.
    """
    kept = links.weights[block]
    if links.form == DENSE:
        for e in range(kept.shape[0]):
            kept[e, lane] = 0.0
        for e in range(count):
            if weights[e] > 0.0:
                kept[pair_index(first[e], second[e], n), lane] = weights[e]
    elif links.form == LISTED:
        sort_links(first, second, weights, count)
        used = 0
        for e in range(count):
            if weights[e] > 0.0:
                links.first[block, used], links.second[block, used] = first[e], second[e]
                kept[used, 0] = weights[e]
                used += 1
        for e in range(used, kept.shape[0]):
            kept[e, 0] = 0.0


@inner_kernel
def are_linked(links, block, lane, n, i, j):
    """True if two robots i < j are linked."""
    if links.form == DENSE:
        return links.weights[block, pair_index(i, j, n), lane] > 0.0
    if links.form == ARCS:
        return links.weights[block, i * n + j, 0] + links.weights[block, j * n + i, 0] > 0.0
    for e in range(links.first.shape[1]):
        if links.first[block, e] == i and links.second[block, e] == j:
            return links.weights[block, e, 0] > 0.0
    return False


@inner_kernel(inline="text")
def arcs_of(links, block, n):
    """Matrix a_ij, (n, n), m/s, of one environment; (0, 0) if links are not arcs."""
    size = n if links.form == ARCS else 0
    return links.weights[block][: size * size].reshape(size, size)


@inner_kernel(inline="code")
def edge_weight(links, block, n, i, j, weight):
    """Weight of robot i for robot j: that of the link, or that of the arc."""
    if links.form == ARCS:
        return links.weights[block, i * n + j, 0]
    return weight


@kernel
def pair_index(i, j, n):
    """Index of the pair i < j in the list of all pairs of n robots, in index order."""
    return i * n - i * (i + 1) // 2 + j - i - 1


@kernel
def sort_links(first, second, weights, count):
    """Sort the first links by their robots, by insertion: merging keeps most of them in order."""
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
