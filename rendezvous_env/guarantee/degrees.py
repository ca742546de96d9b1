"""What is known of the degrees D_i = Σ_j a_ij while merging contracts the graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..experiment.graphs import FIXED, Graph
from ..experiment.scenario import Scenario

Array = NDArray[np.float64]


def least_degrees(scenario: Scenario) -> Array:
    """The least D_i = Σ_j a_ij that a robot can have with m robots left, for m = 2 … n.

    A complete graph stays complete and a cycle a cycle; elsewhere one link is sure, of at least
    a* (theory 3).

    Args:
        scenario: gives n and the graph.

    Returns:
        c_m, an array (n − 1,), m/s.
    """
    n, graph = scenario.n_robots, scenario.sensing_graph
    left = np.arange(2.0, n + 1.0)
    links = np.ones(n - 1)
    if is_complete(graph, n):
        links = left - 1.0
    elif _is_cycle(graph, n):
        links = np.minimum(left - 1.0, 2.0)
    weights = graph.links(n)[2] * graph.weight_range[0]
    return np.maximum(links * weights.min(initial=np.inf), scenario.bottleneck_weight)


def degrees_stay_equal(scenario: Scenario) -> bool:
    """Whether all robots that are left always have the same D_i: complete graphs and cycles of one
    weight, directed cycles too.
    """
    n, graph = scenario.n_robots, scenario.sensing_graph
    even = is_complete(graph, n) or graph.kind == "directed_cycle" or _is_cycle(graph, n)
    return even and _has_one_weight(graph, n)


def uniform_complete(scenario: Scenario) -> bool:
    """Whether everyone is linked to everyone with the same weight."""
    n, graph = scenario.n_robots, scenario.sensing_graph
    return is_complete(graph, n) and _has_one_weight(graph, n)


def _has_one_weight(graph: Graph, n: int) -> bool:
    low, high = graph.weight_range
    weights = graph.links(n)[2]
    return bool(low == high and weights.min(initial=np.inf) == weights.max(initial=0.0))


def is_complete(graph: Graph, n: int) -> bool:
    """Whether every robot is linked to every other, in every episode.

    Args:
        graph: of a scenario.
        n: how many robots.
    """
    return graph.topology == FIXED and len(graph.links(n)[2]) == n * (n - 1) // 2


def _is_cycle(graph: Graph, n: int) -> bool:
    """Whether everyone has two neighbours; the graph is taken to be connected."""
    first, second, _ = graph.links(n)
    counts = np.bincount(np.concatenate([first, second]), minlength=n)
    return graph.topology == FIXED and bool((counts == 2).all())
