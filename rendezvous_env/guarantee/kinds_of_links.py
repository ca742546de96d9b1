"""Which links a graph has in an episode, as the theorems tell them apart, and who leads to whom."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..experiment.graphs import Graph
from ..experiment.scenario import Scenario

UNDIRECTED, DIRECTED, SWITCHING, PROXIMITY = "undirected", "directed", "switching", "proximity"
"""Links that last but for merges, mutual or one-way; that take turns; that end with distance."""


def kind_of_links(graph: Graph) -> str:
    """UNDIRECTED, DIRECTED, SWITCHING or PROXIMITY.

    Args:
        graph: of a scenario.
    """
    kinds = {
        "directed": DIRECTED,
        "directed_cycle": DIRECTED,
        "switching": SWITCHING,
        "proximity": PROXIMITY,
    }
    return kinds.get(graph.kind, UNDIRECTED)


def leaders(scenario: Scenario) -> list[list[int]]:
    """Groups of robots that see nobody outside, in the graph of the moment that has most of them.

    One group means that some robot can be reached from all at any time (theorem G). If it is the
    whole team everyone always sees someone, whatever merges; a smaller one may become a single
    robot that sees nobody, and waits for the others.

    Args:
        scenario: gives n and the graph.

    Returns:
        Indices of robots, group by group.
    """
    graph: Any = scenario.sensing_graph
    moments = graph.graphs if kind_of_links(graph) == SWITCHING else (graph,)
    groups = [_closed_groups(moment.base_weights(scenario.n_robots)) for moment in moments]
    return max(groups, key=lambda found: (len(found), -len(found[0])))


def _closed_groups(weights: NDArray[np.float64]) -> list[list[int]]:
    """Strongly connected components that no arc leaves."""
    from scipy.sparse.csgraph import connected_components

    count, labels = connected_components(weights > 0, directed=True, connection="strong")
    sees, seen = np.nonzero(weights > 0)
    left = set(labels[sees][labels[sees] != labels[seen]].tolist())
    return [np.flatnonzero(labels == label).tolist() for label in range(count) if label not in left]
