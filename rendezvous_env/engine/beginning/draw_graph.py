"""The links of one episode, drawn from the stream of its graph."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import inner_kernel, kernel
from ...equations.random_streams import uniform
from ...experiment.topologies import ERDOS_RENYI, FIXED
from ..links import copy_links, pair_index, sort_links

_TRIES_FOR_CONNECTED = 100


class GraphRules(NamedTuple):
    """A family of graphs, or one graph whose weights are drawn."""

    topology: int
    """FIXED, RANDOM_TREE or ERDOS_RENYI."""
    probability: float
    """Chance of a link, for ERDOS_RENYI."""
    weight_range: tuple[float, float]
    """Each link's weight is multiplied by a number from this range."""
    first: NDArray[np.int64]
    """(E,), the lower robots of the links of a FIXED graph, sorted."""
    second: NDArray[np.int64]
    """(E,), the others."""
    weights: NDArray[np.float64]
    """(E,), m/s."""


@kernel
def draw_links(key, n, rules, first, second, weights, places):
    """Draw the links of one episode, sorted by their robots.

    Args:
        key: random stream.
        n: number of robots.
        rules: GraphRules.
        first: (capacity,) array for the lower robots of the links.
        second: likewise, for the others.
        weights: likewise, for a_ij, m/s.
        places: (n,) working memory.

    Returns:
        Number of links; −1 if there are more than the arrays hold.
    """
    capacity, counter, count = len(first), 0, 0
    if rules.topology == FIXED:
        count = len(rules.first)
        copy_links((rules.first, rules.second, rules.weights), (first, second, weights), count)
    else:
        joined = False
        if rules.topology == ERDOS_RENYI:
            for _ in range(_TRIES_FOR_CONNECTED):
                count, counter = _draw_pairs(key, counter, n, rules.probability, first, second)
                if count > capacity:
                    return -1
                joined = _is_connected(first, second, count, places)
                if joined:
                    break
        if not joined:
            count, counter = _add_tree(key, counter, n, first, second, count, places)
            if count > capacity:
                return -1
        weights[:count] = 1.0
        sort_links(first, second, weights, count)
    low, high = rules.weight_range
    for e in range(count):
        share = uniform(key, counter + pair_index(first[e], second[e], n))
        weights[e] *= low + (high - low) * share
    return count


@inner_kernel
def _draw_pairs(key, counter, n, probability, first, second):
    """Every pair with the same chance; number of links, those without room too, and the counter."""
    count = 0
    for i in range(n):
        for j in range(i + 1, n):
            if uniform(key, counter) < probability:
                if count < len(first):
                    first[count], second[count] = i, j
                count += 1
            counter += 1
    return count, counter


@inner_kernel
def _add_tree(key, counter, n, first, second, count, places):
    """First-entry edges of a random walk on the complete graph: a uniform tree (Aldous–Broder)."""
    places[:] = 0  # 1: visited
    here, left = 0, n - 1
    places[here] = 1
    drawn = count
    while left > 0:
        there = int(uniform(key, counter) * n)
        counter += 1
        if places[there] == 0:
            places[there] = 1
            low, high = min(here, there), max(here, there)
            if not _is_listed(low, high, first, second, drawn):
                if count < len(first):
                    first[count], second[count] = low, high
                count += 1
            left -= 1
        here = there
    return count, counter


@inner_kernel
def _is_listed(low, high, first, second, count):
    for e in range(count):
        if first[e] == low and second[e] == high:
            return True
    return False


@inner_kernel
def _is_connected(first, second, count, places):
    """Whether the links join all robots; ``places`` holds the leader of each one's group."""
    n = len(places)
    for i in range(n):
        places[i] = i
    groups = n
    for e in range(count):
        groups -= join(first[e], second[e], places)
    return groups == 1


@kernel
def join(i, j, places):
    """Make one group of those of two robots; 1, or 0 if they are in one already."""
    a, b = _leader(i, places), _leader(j, places)
    if a == b:
        return 0
    places[max(a, b)] = min(a, b)
    return 1


@inner_kernel
def _leader(i, places):
    while places[i] != i:
        places[i] = places[places[i]]
        i = places[i]
    return i
