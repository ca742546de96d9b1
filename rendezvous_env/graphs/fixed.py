"""Undirected graphs with the same edges in every episode."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from ..checks import number_range
from ..field_checks import known_arguments
from .graph import Graph, GraphNumbers, LinkArrays, from_matrix_of, from_networkx
from .reading import is_networkx

Weight = float | tuple[float, float]
"""Weight of every edge, m/s, or a range to sample from."""
as_range = partial(number_range, "graph: weight_range", unit="m/s")


@dataclass(frozen=True)
class CompleteGraph(Graph, kinds=("complete",)):
    """Complete graph, before and after merges, in closed form."""

    def links(self, n: int) -> LinkArrays:
        """All pairs."""
        first, second = np.triu_indices(n, 1)
        return first.astype(np.int64), second.astype(np.int64), np.ones(len(first))

    def components(self, n: int) -> list[list[int]]:
        """The single component."""
        return [list(range(n))]

    closed_groups = components

    def numbers(self, n: int) -> GraphNumbers:
        """Numbers for n − 1 neighbours with the largest weights."""
        (low, high), pairs = self.weight_range, n * (n - 1) // 2
        most = (n - 1) * high
        return GraphNumbers(pairs, n - 1, most, most, low, pairs * high, self.weight_range)


@dataclass(frozen=True)
class NamedGraph(Graph, kinds=("path", "cycle", "star")):
    """Graph whose edges are determined by the number of robots."""

    def links(self, n: int) -> LinkArrays:
        """Edges of weight 1 m/s."""
        others = np.arange(1, n)
        first, second = (0 * others if self.kind == "star" else others - 1), others
        if self.kind == "cycle" and n > 2:
            first, second = np.insert(first, 1, 0), np.insert(second, 1, n - 1)
        return first, second, np.ones(len(first))


@dataclass(frozen=True)
class ListedGraph(Graph, kinds=("edges",)):
    """Graph with listed edges."""

    listed: ClassVar[str] = "edges"


@known_arguments
def complete(weight: Weight = 1.0) -> Graph:
    """Complete graph; ``weight`` in m/s, or a range to sample from."""
    return Graph("complete", as_range(weight))


@known_arguments
def path(weight: Weight = 1.0) -> Graph:
    """Path graph: robot i observes i − 1 and i + 1."""
    return Graph("path", as_range(weight))


@known_arguments
def cycle(weight: Weight = 1.0) -> Graph:
    """Cycle graph."""
    return Graph("cycle", as_range(weight))


@known_arguments
def star(weight: Weight = 1.0) -> Graph:
    """Star graph centred at robot 0."""
    return Graph("star", as_range(weight))


@known_arguments
def from_edges(edges: Iterable[Sequence[float]], n_robots: int | None = None) -> Graph:
    """Graph from edges (i, j) or (i, j, weight) with indices from 0; default weight 1 m/s.

    Also accepts an undirected networkx graph, or a view of its edges; "weight" is a_ij, m/s.

    Raises:
        ValueError: for a loop, a repeated edge, an index out of range or an invalid weight.
    """
    if is_networkx(edges) and n_robots is None:
        return from_networkx("edges", edges)
    return Graph("edges", edges=edges, n_nodes=n_robots)


@known_arguments
def from_matrix(weights: Any) -> Graph:
    """Graph from a symmetric (n, n) matrix of weights a_ij, m/s; 0 = no edge.

    The matrix is an array or a sparse matrix of SciPy; if a_ij and a_ji differ by rounding, their
    mean is used.

    Raises:
        ValueError: naming the entry that is not finite, negative, on the diagonal or not symmetric.
    """
    return from_matrix_of("edges", weights)
