"""Random graphs, sampled per episode from their own random stream."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import Registry
from ..compilation import inner_kernel, kernel
from ..field_checks import known_arguments
from ..physics.random_streams import GRAPH, uniform
from .edges import pair_index, sort_links
from .fixed import CompleteGraph, Weight, as_range
from .graph import KINDS, Graph, GraphNumbers, LinkArrays, step_degree
from .weights import checked_edges, read_edges

FIXED_EDGES, RANDOM_TREE, ERDOS_RENYI = range(3)
"""What is sampled: weights only, a random tree, or an Erdős–Rényi graph."""
_TRIES_FOR_CONNECTED = 100
_NO_LINKS = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))


@dataclass(frozen=True)
class DrawnGraph(CompleteGraph):
    """Family of connected random graphs.

    By default quantities are those of the complete graph and a* is the minimum weight.
    """

    fixed: ClassVar[bool] = False


@dataclass(frozen=True)
class RandomTree(DrawnGraph, kinds=("random_tree",)):
    """A uniformly random labelled tree."""

    def numbers(self, n: int) -> GraphNumbers:
        """Quantities for n − 1 edges and a mean degree of two."""
        found, high = super().numbers(n), self.weight_range[1]
        step = step_degree(n, found.max_degree, 4.0 * (n - 1) / n * high)
        return found._replace(most_links=n - 1, step_degree=step, weight_sum=(n - 1) * high)


@dataclass(frozen=True)
class ErdosRenyi(DrawnGraph, kinds=("erdos_renyi",)):
    """Connected Erdős–Rényi graph."""

    def numbers(self, n: int) -> GraphNumbers:
        """Quantities; more than ``most_links`` (ten standard deviations) has probability < 10⁻⁹."""
        found, chance = super().numbers(n), self.probability
        spread = 10 * np.sqrt(found.most_links * chance * (1 - chance))
        most_links = min(found.most_links, int(np.ceil(found.most_links * chance + spread)) + n)
        step = step_degree(n, found.max_degree, 2.0 * chance * (n - 1) * self.weight_range[1])
        return found._replace(most_links=most_links, step_degree=step)


@known_arguments
def random_tree(weight: Weight = 1.0) -> Graph:
    """Uniformly random labelled tree, sampled per episode."""
    return Graph("random_tree", as_range(weight))


@known_arguments
def erdos_renyi(probability: float, weight: Weight = 1.0) -> Graph:
    """Connected Erdős–Rényi graph, sampled per episode.

    Sampling is repeated until the graph is connected. After 100 attempts a uniformly random
    spanning tree is added to the last sample.
    """
    return Graph("erdos_renyi", as_range(weight), probability=probability)


DrawEdges = Callable[[int, np.random.Generator], Iterable[tuple[int, int]]]
FAMILIES = Registry("family of graphs", "rv.graphs.family")


@dataclass(frozen=True)
class CustomFamily(DrawnGraph):
    """Random graph sampled by a registered function, see ``family``."""

    def check_fits(self, scenario: Any) -> None:
        """Sample once to detect errors of the function before any episode."""
        self.draw(scenario.n_robots, 0, 0, connected=scenario.require_connected)

    def draw(self, n: int, seed: int, episode: int, *, connected: bool) -> LinkArrays:
        """Edges of one episode, a function of seed and episode number.

        Raises:
            ValueError: for invalid edges or, with ``connected``, a disconnected graph.
        """
        random = np.random.default_rng((int(seed), int(episode), GRAPH))
        try:
            drawn = read_edges(FAMILIES[self.kind](n, random))
            if any(weight != 1.0 for *_, weight in drawn):
                raise ValueError("graph: weights come from weight_range; give edges as (i, j)")
            edges = checked_edges(drawn, n, directed=False)
        except ValueError as error:
            raise ValueError(f"family {self.kind!r} for {n} robots: {error}") from error
        low, high = self.weight_range
        why = Graph("edges", edges=edges, n_nodes=n).connectivity_error(n) if connected else None
        if why is not None:
            raise ValueError(f"family {self.kind!r} returned a graph that is not connected: {why}")
        return edges.first, edges.second, low + (high - low) * random.random(len(edges))


def family(name: str, draw: DrawEdges | None = None) -> Any:
    """Register a custom family of random graphs.

    ``draw`` maps the number of robots n and a NumPy ``Generator`` to edges (i, j). Use it with
    ``Scenario(graph=name)`` or ``graphs.parse({"kind": name, "weight_range": [low, high]})``.
    Weights are sampled after the edges. Theorems assume an arbitrary connected graph with these
    weights. An existing family of the same name is replaced. Without ``draw`` this is a decorator.

    Raises:
        ValueError: for the name of another kind of graph, or a ``draw`` that is not callable.
    """
    if isinstance(name, str) and KINDS.get(name, CustomFamily) is not CustomFamily:
        raise ValueError(f"name is {name!r}; it must be new: {', '.join(KINDS)} are taken")

    def register(draw: Any) -> Any:
        FAMILIES.add(name, draw)
        KINDS[name] = CustomFamily
        return draw

    return register if draw is None else register(draw)


class GraphRules(NamedTuple):
    """Sampling rules of a random graph, or of random weights on a fixed graph."""

    topology: int  # FIXED_EDGES, RANDOM_TREE or ERDOS_RENYI
    probability: float  # probability of a link, for ERDOS_RENYI
    weight_range: tuple[float, float]  # each weight is multiplied by a number from this range
    first: NDArray[np.int64]  # (E,), the lower robots of FIXED_EDGES, sorted
    second: NDArray[np.int64]  # (E,), the others
    weights: NDArray[np.float64]  # (E,), m/s


def graph_rules(graph: Graph, n: int) -> GraphRules | None:
    """Sampling rules of an undirected graph; None if nothing is random."""
    low, high = graph.weight_range
    if not graph.undirected or (graph.fixed and low == high) or isinstance(graph, CustomFamily):
        return None
    topologies = {"random_tree": RANDOM_TREE, "erdos_renyi": ERDOS_RENYI}
    listed = graph.links(n) if graph.fixed else _NO_LINKS
    topology = topologies.get(graph.kind, FIXED_EDGES)
    return GraphRules(topology, float(graph.probability), (low, high), *listed)


@kernel
def draw_links(key, n, rules, first, second, weights, places):
    """Sample the links of one episode, sorted by robots, into three arrays.

    Returns their number, or −1 if the arrays are too short. ``places`` is (n,) working memory.
    """
    capacity, counter, count = len(first), 0, 0
    if rules.topology == FIXED_EDGES:
        count = len(rules.first)
        for e in range(count):
            first[e], second[e], weights[e] = rules.first[e], rules.second[e], rules.weights[e]
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
    """Sample every pair with equal probability; returns the number of links and the counter."""
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
    """Add a uniform random tree (Aldous–Broder), except edges among the sorted ``count``."""
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
            if not are_linked(low, high, (first[:drawn], second[:drawn])):
                if count < len(first):
                    first[count], second[count] = low, high
                count += 1
            left -= 1
        here = there
    return count, counter


@kernel
def are_linked(i, j, links):
    """True if robots i < j are linked, given sorted links (first, second, …)."""
    first, second = links[0], links[1]
    low, high = 0, len(first)
    while low < high:
        middle = (low + high) // 2
        if first[middle] < i or (first[middle] == i and second[middle] < j):
            low = middle + 1
        else:
            high = middle
    return low < len(first) and first[low] == i and second[low] == j


@inner_kernel
def _is_connected(first, second, count, places):
    """True if the links connect all robots; ``places`` holds the union-find parents."""
    n = len(places)
    for i in range(n):
        places[i] = i
    groups = n
    for e in range(count):
        groups -= join(first[e], second[e], places)
    return groups == 1


@kernel
def join(i, j, places):
    """Union of the groups of two robots; 1, or 0 if they are equal."""
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
