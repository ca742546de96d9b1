"""Directed sensing graphs: visibility need not be mutual (guarantees, section 10)."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..field_checks import known_arguments
from .fixed import Weight, as_range
from .graph import Graph, LinkArrays, from_matrix_of
from .reading import is_networkx, is_sparse


@dataclass(frozen=True)
class DirectedGraph(Graph, kinds=("directed", "directed_cycle")):
    """Directed graph with edges i → j (robot i observes robot j) of weights a_ij, m/s.

    Row i of ``base_weights`` holds the weights of robot i. The graph counts as directed even if
    every edge has a reverse edge, since their weights are independent.
    """

    listed: ClassVar[str] = "directed"
    directed: ClassVar[bool] = True

    def links(self, n: int) -> LinkArrays:
        """Edges before sampling: observers, observed robots and weights, m/s; (E,) each."""
        if self.kind == self.listed:
            return super().links(n)
        robots = np.arange(n)
        return robots, (robots + 1) % n, np.ones(n)


@known_arguments
def directed(arcs: Any, n_robots: int | None = None) -> Graph:
    """Directed graph: with an edge (i, j), robot i observes robot j; j need not observe i.

    Args:
        arcs: an (n, n) matrix of weights a_ij of robot i for the robots it observes, m/s, 0 = no
        edge; or a list of (i, j) or (i, j, weight), weight 1 m/s if not given. An array, a
            sparse matrix or a square list of lists is a matrix, tuples are edges. Or a networkx
            graph, each edge of an undirected one in both directions.
        n_robots: for a list of edges; without it the largest index is the last robot's.

    Raises:
        ValueError: naming the invalid edge or entry.
    """
    is_table = isinstance(arcs, list) and all(
        isinstance(row, list | np.ndarray) and len(row) == len(arcs) for row in arcs
    )
    if is_table or isinstance(arcs, np.ndarray) or is_sparse(arcs) or is_networkx(arcs):
        return from_matrix_of("directed", arcs, n_robots)
    return Graph("directed", edges=arcs, n_nodes=n_robots)


@known_arguments
def directed_cycle(weight: Weight = 1.0) -> Graph:
    """Directed cycle: robot i observes i + 1, the last one robot 0 (cyclic pursuit)."""
    return Graph("directed_cycle", as_range(weight))
