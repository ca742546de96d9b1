"""Which links a graph has in an episode, as the theorems tell them apart, and who leads to whom."""

from __future__ import annotations

from typing import Any

from ..experiment.graph_numbers import closed_groups
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
        Indices of robots without unit, group by group.
    """
    graph: Any = scenario.sensing_graph
    moments = graph.graphs if kind_of_links(graph) == SWITCHING else (graph,)
    groups = [closed_groups(moment.base_weights(scenario.n_robots)) for moment in moments]
    return max(groups, key=lambda found: (len(found), -len(found[0])))
