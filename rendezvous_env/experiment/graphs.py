"""Sensing graphs: undirected or directed, fixed, drawn for every episode, or changing in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .changing_graphs import ProximityGraph, SwitchingGraph
from .checks import floats, refuse, shown
from .directed_graphs import DirectedGraph
from .graph_checks import as_edge, as_range, check_weights, listed_edges
from .graph_kinds import Graph as Graph
from .graph_numbers import bottleneck_weight as bottleneck_weight
from .graph_numbers import components as components
from .topologies import ERDOS_RENYI as ERDOS_RENYI
from .topologies import FIXED as FIXED
from .topologies import PROXIMITY as PROXIMITY
from .topologies import RANDOM_TREE as RANDOM_TREE

GraphLike = Graph | str | Sequence[Sequence[float]] | NDArray[Any]


def complete(weight: float | tuple[float, float] = 1.0) -> Graph:
    """Everyone sees everyone; ``weight`` in m/s, or a range to draw from."""
    return Graph("complete", as_range(weight))


def path(weight: float | tuple[float, float] = 1.0) -> Graph:
    """Robot i sees i - 1 and i + 1."""
    return Graph("path", as_range(weight))


def cycle(weight: float | tuple[float, float] = 1.0) -> Graph:
    """A path whose ends see each other."""
    return Graph("cycle", as_range(weight))


def star(weight: float | tuple[float, float] = 1.0) -> Graph:
    """Everyone sees robot 0 and is seen by it."""
    return Graph("star", as_range(weight))


def random_tree(weight: float | tuple[float, float] = 1.0) -> Graph:
    """A uniformly random labelled tree, drawn anew for every episode."""
    return Graph("random_tree", as_range(weight))


def erdos_renyi(probability: float, weight: float | tuple[float, float] = 1.0) -> Graph:
    """A connected Erdős–Rényi graph, drawn anew for every episode.

    Draws are repeated until one is connected; after 100 in vain a uniformly random spanning tree is
    added to the last one.
    """
    return Graph("erdos_renyi", as_range(weight), probability=probability)


def from_edges(edges: Iterable[Sequence[float]], n_robots: int | None = None) -> Graph:
    """A graph from (i, j) or (i, j, weight) with robot indices from 0; weight 1 m/s if not given.

    Raises:
        ValueError: for a loop, a repeated edge, an index out of range or a bad weight.
    """
    listed = listed_edges(edges)
    return Graph("edges", edges=listed, n_nodes=n_robots or _count_of(listed))


def from_matrix(weights: ArrayLike) -> Graph:
    """A graph from its symmetric (n, n) matrix of weights a_ij, m/s; 0 = no edge.

    Raises:
        ValueError: naming the entry that is not finite, negative, on the diagonal or not symmetric.
    """
    matrix = floats("graph", weights)
    check_weights(matrix)
    rows, columns = np.nonzero(np.triu(matrix))
    edges = zip(rows.tolist(), columns.tolist(), matrix[rows, columns].tolist(), strict=True)
    return Graph("edges", edges=tuple(edges), n_nodes=len(matrix))


def directed(arcs: Any, n_robots: int | None = None) -> Graph:
    """Robot i sees robot j where there is an arc (i, j); j need not see i.

    Args:
        arcs: an (n, n) matrix of weights, row i what robot i gives to those it sees, m/s, 0 = no
            arc; or a list of (i, j) or (i, j, weight), weight 1 m/s if not given. An array or a
            square list of lists is a matrix, tuples are arcs.
        n_robots: for a list of arcs; without it the largest index is the last robot's.

    Raises:
        ValueError: naming the arc or the entry that is wrong.
    """
    if _is_matrix(arcs):
        matrix = floats("graph", arcs)
        check_weights(matrix, n_robots, directed=True)
        sees, seen = np.nonzero(matrix)
        weights = matrix[sees, seen].tolist()
        listed = tuple(zip(sees.tolist(), seen.tolist(), weights, strict=True))
        return DirectedGraph("directed", edges=listed, n_nodes=len(matrix))
    listed = listed_edges(arcs)
    return DirectedGraph("directed", edges=listed, n_nodes=n_robots or _count_of(listed))


def _is_matrix(arcs: Any) -> bool:
    if isinstance(arcs, np.ndarray):
        return True
    return isinstance(arcs, list) and all(
        isinstance(row, list | np.ndarray) and len(row) == len(arcs) for row in arcs
    )


def _count_of(edges: Iterable[Any]) -> int:
    """One more than the largest index."""
    last = max((max(i, j) for i, j, _ in map(as_edge, edges)), default=0)
    return 1 + max(0, last)


def directed_cycle(weight: float | tuple[float, float] = 1.0) -> Graph:
    """Robot i sees i + 1, the last one robot 0: cyclic pursuit."""
    return DirectedGraph("directed_cycle", as_range(weight))


def switching(
    graphs: Iterable[GraphLike | dict[str, Any]], dwell: float = 1.0, order: str = "cyclic"
) -> Graph:
    """A list of fixed graphs of which each holds for a dwell time.

    Args:
        graphs: what ``parse`` takes, undirected or directed; their weights may be drawn from a
            range for every episode.
        dwell: s, at least a step.
        order: "cyclic", one after another, or "random", each time drawn anew.

    Raises:
        ValueError: naming the entry of the list that has no fixed edges, or the bad dwell or order.
    """
    if not isinstance(graphs, Iterable) or isinstance(graphs, str | bytes | dict | Graph):
        refuse("graph: graphs", graphs, "a list of graphs")
    listed = tuple(_member(k, graph) for k, graph in enumerate(graphs))
    return SwitchingGraph("switching", graphs=listed, dwell=dwell, order=order)


def _member(k: int, graph: Any) -> Graph:
    # looked at before it is parsed: tables could be nested without end
    if isinstance(graph, dict) and graph.get("kind") == "switching":
        raise ValueError(f"graph: graphs[{k}] is itself a switching graph; list its graphs instead")
    return parse(graph)


def proximity(weight: float | tuple[float, float] = 1.0) -> Graph:
    """Robot i sees robot j while j is within the range and field of view of ``Scenario.sensing``.

    Every pair has a weight of its own, which both give.
    """
    return ProximityGraph("proximity", as_range(weight))


def parse(value: GraphLike | dict[str, Any]) -> Graph:
    """A Graph from a Graph, a name, a matrix, or the plain data of ``Graph.to_plain``."""
    if isinstance(value, Graph):
        return value
    if isinstance(value, str):
        return _from_plain({"kind": value})
    if isinstance(value, dict):
        return _from_plain(value)
    return from_matrix(value)


_KINDS: dict[str, type[Graph]] = {
    "directed": DirectedGraph,
    "directed_cycle": DirectedGraph,
    "switching": SwitchingGraph,
    "proximity": ProximityGraph,
}
_KEYS = {"kind", "weight_range", "edges", "n_nodes", "probability"}


def _from_plain(plain: dict[str, Any]) -> Graph:
    kind = plain.get("kind", "edges" if "edges" in plain else "complete")
    known = {"kind", "graphs", "dwell", "order"} if kind == "switching" else _KEYS
    if unknown := [key for key in plain if key not in known]:
        raise ValueError(
            f"graph: unknown key {shown(unknown[0])}; known keys are {', '.join(sorted(known))}"
        )
    if kind == "switching":
        return switching(
            plain.get("graphs", ()), plain.get("dwell", 1.0), plain.get("order", "cyclic")
        )
    made = _KINDS.get(kind, Graph) if isinstance(kind, str) else Graph
    fields = {**plain, "kind": kind, "weight_range": as_range(plain.get("weight_range", 1.0))}
    if kind in ("edges", "directed"):
        fields["edges"] = listed_edges(plain.get("edges", ()))
        fields["n_nodes"] = plain.get("n_nodes") or _count_of(fields["edges"])
    return made(**fields)
