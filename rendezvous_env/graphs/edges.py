"""Links of one team between the way they are kept and the list that the equations take."""

from ..compilation import by_type, inner_kernel, kernel
from .edge_kinds import DenseEdges, DirectedEdges, EdgeList


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
def copy_links(source, target, count):
    """Copy the first ``count`` of some links (first, second, weights)."""
    for e in range(count):
        target[0][e] = source[0][e]
        target[1][e] = source[1][e]
        target[2][e] = source[2][e]


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
