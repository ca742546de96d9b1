"""Sensing graphs: fixed ones, and families from which every episode draws its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checks import floats, is_whole, real, refuse, shown, whole
from .limits import LARGEST, MOST_ROBOTS, SMALLEST

FIXED, RANDOM_TREE, ERDOS_RENYI = range(3)
"""How an episode chooses its edges."""
_TOPOLOGIES = {"random_tree": RANDOM_TREE, "erdos_renyi": ERDOS_RENYI}
_FIXED_KINDS = ("complete", "path", "cycle", "star")


@dataclass(frozen=True)
class Graph:
    """An undirected weighted sensing graph for any number of robots, or a family of them.

    Make one with the functions of this module rather than by hand.
    """

    kind: str
    """complete, path, cycle, star, edges, random_tree or erdos_renyi."""
    weight_range: tuple[float, float] = (1.0, 1.0)
    """Each edge draws its weight a_ij uniformly from this range, m/s; factors for kind "edges"."""
    edges: tuple[tuple[int, int, float], ...] = ()
    """(i, j, a_ij) with i < j; for kind "edges" only."""
    n_nodes: int | None = None
    """Number of robots that the edges are for; for kind "edges" only."""
    probability: float = 0.5
    """Chance of each edge; for kind "erdos_renyi" only."""

    def __post_init__(self) -> None:
        kinds = (*_FIXED_KINDS, "edges", *_TOPOLOGIES)
        if not isinstance(self.kind, str) or self.kind not in kinds:
            raise ValueError(
                f"graph: {shown(self.kind)} is not a graph; choose one of {', '.join(kinds)}"
            )
        object.__setattr__(self, "weight_range", _as_range(self.weight_range))
        if not 0 < real(self.probability) <= 1:
            raise ValueError(f"graph: probability {shown(self.probability)} must be in (0, 1]")
        object.__setattr__(self, "probability", real(self.probability))
        self._check_edges()

    def _check_edges(self) -> None:
        if self.kind != "edges":
            if self.edges or self.n_nodes is not None:
                raise ValueError(f"graph: a {self.kind} has neither edges nor n_nodes")
            return
        n = whole("graph: n_nodes", self.n_nodes, 1, MOST_ROBOTS)
        object.__setattr__(self, "edges", _ordered_edges(self.edges, n))
        object.__setattr__(self, "n_nodes", n)

    @property
    def topology(self) -> int:
        """How an episode draws its edges: FIXED, RANDOM_TREE or ERDOS_RENYI."""
        return _TOPOLOGIES.get(self.kind, FIXED)

    def base_weights(self, n: int) -> NDArray[np.float64]:
        """Weights before drawing, (n, n): an episode keeps some edges and scales each by a draw.

        Raises:
            ValueError: if the graph's edges are for another number of robots.
        """
        weights = np.zeros((n, n))
        if self.kind == "edges":
            if n != self.n_nodes:
                raise ValueError(
                    f"graph: its matrix or edge list is for {self.n_nodes} robots, not for {n}"
                )
            for i, j, weight in self.edges:
                weights[i, j] = weights[j, i] = weight
        elif self.kind == "path":
            weights = np.eye(n, k=1) + np.eye(n, k=-1)
        elif self.kind == "cycle":
            weights = np.eye(n, k=1) + np.eye(n, k=-1)
            weights[0, -1] = weights[-1, 0] = 1.0
        elif self.kind == "star":
            weights[0, 1:] = weights[1:, 0] = 1.0
        else:
            weights = 1.0 - np.eye(n)
        return weights

    def most_neighbours(self, n: int) -> int:
        """The most neighbours that a robot can have in any episode, merges included.

        Contraction leaves a path a path and a cycle a cycle; others it can turn into a star.
        """
        if self.kind in ("path", "cycle"):
            return min(2, n - 1)
        if self.kind == "edges":
            counts = np.bincount([robot for i, j, _ in self.edges for robot in (i, j)], minlength=n)
            return min(2, n - 1) if counts.max(initial=0) <= 2 else n - 1
        return n - 1

    def links(self, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """The edges before drawing: lower and higher robots, sorted, and weights in m/s; each (E,).

        The same as ``base_weights``, in memory that follows the edges.
        """
        if self.kind == "path":
            pairs = [(i, i + 1, 1.0) for i in range(n - 1)]
        elif self.kind == "cycle":
            pairs = sorted({*((i, i + 1, 1.0) for i in range(n - 1)), (0, n - 1, 1.0)})
        elif self.kind == "star":
            pairs = [(0, j, 1.0) for j in range(1, n)]
        elif self.kind == "edges":
            if n != self.n_nodes:
                raise ValueError(
                    f"graph: its matrix or edge list is for {self.n_nodes} robots, not for {n}"
                )
            pairs = list(self.edges)
        else:
            first, second = np.triu_indices(n, 1)
            return first.astype(np.int64), second.astype(np.int64), np.ones(len(first))
        table = np.array(pairs, dtype=np.float64).reshape(-1, 3)
        return table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2].copy()

    def most_links(self, n: int) -> int:
        """Links that an episode can have; of a random family, with a chance of 10⁻⁹ at most to have
        more (ten standard deviations).
        """
        pairs = n * (n - 1) // 2
        if self.topology == RANDOM_TREE:
            return n - 1
        if self.topology == ERDOS_RENYI:
            spread = 10 * np.sqrt(pairs * self.probability * (1 - self.probability))
            return min(pairs, int(np.ceil(pairs * self.probability + spread)) + n)
        return len(self.links(n)[0])

    def components(self, n: int) -> list[list[int]]:
        """Connected components as lists of robot indices; a family only draws connected graphs."""
        return components(self.base_weights(n))

    def max_degree(self, n: int) -> float:
        """D̄, m/s: the largest D_i = Σ_j a_ij that an episode or its merges can produce (theory
        4).
        """
        base, (_, high) = self.base_weights(n), self.weight_range
        if self.topology == RANDOM_TREE:
            return (n - 1) * high
        return max((max_degree(base[np.ix_(c, c)] * high) for c in components(base)), default=0.0)

    def bottleneck_weight(self, n: int) -> float:
        """a*, m/s: the least a* over all graphs that an episode can draw (theory 3)."""
        low, _ = self.weight_range
        return low if self.topology != FIXED else bottleneck_weight(self.base_weights(n) * low)

    def weight_sum(self, n: int) -> float:
        """W, m/s: the largest sum of edge weights that an episode can draw."""
        high = self.weight_range[1]
        if self.topology == RANDOM_TREE:
            return (n - 1) * high
        return float(np.triu(self.base_weights(n)).sum()) * high

    def to_plain(self) -> str | dict[str, Any]:
        """The graph as plain data for TOML; ``parse`` turns it back into an equal graph."""
        if self.kind != "edges" and self == Graph(self.kind):
            return self.kind
        plain: dict[str, Any] = {"kind": self.kind, "weight_range": list(self.weight_range)}
        if self.kind == "edges":
            plain |= {"n_nodes": self.n_nodes, "edges": [list(edge) for edge in self.edges]}
        if self.kind == "erdos_renyi" or self.probability != Graph("complete").probability:
            plain["probability"] = self.probability
        return plain


GraphLike = Graph | str | Sequence[Sequence[float]] | NDArray[Any]


def complete(weight: float | tuple[float, float] = 1.0) -> Graph:
    """Everyone sees everyone; ``weight`` in m/s, or a range to draw from."""
    return Graph("complete", _as_range(weight))


def path(weight: float | tuple[float, float] = 1.0) -> Graph:
    """Robot i sees i - 1 and i + 1."""
    return Graph("path", _as_range(weight))


def cycle(weight: float | tuple[float, float] = 1.0) -> Graph:
    """A path whose ends see each other."""
    return Graph("cycle", _as_range(weight))


def star(weight: float | tuple[float, float] = 1.0) -> Graph:
    """Everyone sees robot 0 and is seen by it."""
    return Graph("star", _as_range(weight))


def random_tree(weight: float | tuple[float, float] = 1.0) -> Graph:
    """A uniformly random labelled tree, drawn anew for every episode."""
    return Graph("random_tree", _as_range(weight))


def erdos_renyi(probability: float, weight: float | tuple[float, float] = 1.0) -> Graph:
    """A connected Erdős–Rényi graph, drawn anew for every episode.

    Draws are repeated until one is connected; after 100 in vain a uniformly random spanning tree is
    added to the last one.
    """
    return Graph("erdos_renyi", _as_range(weight), probability=probability)


def from_edges(edges: Iterable[Sequence[float]], n_robots: int | None = None) -> Graph:
    """A graph from (i, j) or (i, j, weight) with robot indices from 0; weight 1 m/s if not given.

    Raises:
        ValueError: for a loop, a repeated edge, an index out of range or a bad weight.
    """
    listed = _listed(edges)
    last = max((max(i, j) for i, j, _ in map(_edge, listed)), default=0)
    return Graph("edges", edges=listed, n_nodes=n_robots or 1 + max(0, last))


def _listed(edges: Any) -> tuple[Any, ...]:
    if not isinstance(edges, Iterable) or isinstance(edges, str | bytes):
        refuse("graph: edges", edges, "a sequence of (i, j) or (i, j, weight)")
    return tuple(edges)


def _edge(edge: Any) -> tuple[int, int, float]:
    """One edge, its weight 1 m/s if it is not given; whole numbers may come as floats."""
    row = edge.tolist() if isinstance(edge, np.ndarray) else edge
    if not isinstance(row, Sequence) or isinstance(row, str | bytes) or len(row) not in (2, 3):
        refuse("graph: an edge", edge, "(i, j) or (i, j, weight) with indices of robots")
    i, j, weight = (*row, 1.0)[:3]
    if not all(is_whole(k) or real(k).is_integer() for k in (i, j)):
        refuse("graph: an edge", edge, "(i, j) or (i, j, weight) with whole indices of robots")
    if not SMALLEST <= real(weight) <= LARGEST:
        raise ValueError(
            f"graph: edge ({int(i)}, {int(j)}) has weight {shown(weight)}; it must be positive and "
            f"finite, from {SMALLEST:g} to {LARGEST:g} m/s"
        )
    return int(i), int(j), real(weight)


def _ordered_edges(edges: Any, n: int) -> tuple[tuple[int, int, float], ...]:
    ordered: dict[tuple[int, int], float] = {}
    for i, j, weight in map(_edge, _listed(edges)):
        pair = (min(i, j), max(i, j))
        if i == j or pair in ordered or pair[0] < 0 or pair[1] >= n:
            raise ValueError(
                f"graph: edge ({i}, {j}) must join two different robots of 0..{n - 1}, once"
            )
        ordered[pair] = weight
    return tuple((i, j, weight) for (i, j), weight in sorted(ordered.items()))


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


def parse(value: GraphLike | dict[str, Any]) -> Graph:
    """A Graph from a Graph, a name, a matrix, or the plain data of ``Graph.to_plain``."""
    if isinstance(value, Graph):
        return value
    if isinstance(value, str):
        return Graph(value)
    if isinstance(value, dict):
        return _from_plain(value)
    return from_matrix(value)


def _from_plain(plain: dict[str, Any]) -> Graph:
    known = {"kind", "weight_range", "edges", "n_nodes", "probability"}
    if unknown := [key for key in plain if key not in known]:
        raise ValueError(
            f"graph: unknown key {shown(unknown[0])}; known keys are {', '.join(sorted(known))}"
        )
    weight_range = _as_range(plain.get("weight_range", 1.0))
    kind = plain.get("kind", "edges" if "edges" in plain else "complete")
    if kind == "edges":
        graph = from_edges(plain.get("edges", ()), plain.get("n_nodes"))
        return Graph("edges", weight_range, graph.edges, graph.n_nodes)
    return Graph(kind, weight_range, probability=plain.get("probability", 0.5))


def check_weights(weights: NDArray[np.float64], n: int | None = None, field: str = "graph") -> None:
    """Refuse a matrix that is no set of sensing weights.

    Args:
        weights: to be (n, n), symmetric, non-negative, finite, zero on the diagonal.
        n: number of robots, if known.
        field: what the message calls the matrix.

    Raises:
        ValueError: naming the shape or the first entry that is wrong.
    """
    size = n if n is not None else (weights.shape[0] if weights.ndim else 0)
    if weights.shape != (size, size):
        raise ValueError(
            f"{field}: weights have shape {weights.shape}; they must be ({size}, {size})"
        )
    reasons = (
        (~np.isfinite(weights), "must be finite"),
        (weights < 0, "must not be negative"),
        (
            (weights != 0) & ((weights < SMALLEST) | (weights > LARGEST)),
            f"must be 0, or from {SMALLEST:g} to {LARGEST:g} m/s",
        ),
        (np.diag(np.diag(weights) != 0), "must be 0: no robot is its own neighbour"),
        (
            weights != weights.T,
            "must equal its mirror image: the graph is undirected (a_ij = a_ji)",
        ),
    )
    for wrong, reason in reasons:
        if np.any(wrong):
            i, j = (int(k) for k in np.argwhere(wrong)[0])
            raise ValueError(f"{field}: weight a[{i}, {j}] = {weights[i, j]} {reason}")


def components(weights: NDArray[np.float64]) -> list[list[int]]:
    """Connected components of a weight matrix, as lists of indices."""
    from scipy.sparse.csgraph import connected_components

    count, labels = connected_components(weights > 0, directed=False)
    return [np.flatnonzero(labels == label).tolist() for label in range(count)]


def max_degree(weights: NDArray[np.float64]) -> float:
    """D̄ of one connected weight matrix: the largest D_i that merging can produce (theory 4)."""
    if not np.any(weights > 0):
        return 0.0
    n, heaviest = len(weights), float(weights.max())
    neighbours = int((weights > 0).sum(axis=1).max())
    most = 2 if neighbours <= 2 else n - 1
    return min(most * heaviest, float(np.triu(weights).sum()))


def bottleneck_weight(weights: NDArray[np.float64]) -> float:
    """a* of a weight matrix: the least edge of a maximum spanning tree (of each component)."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    links = csr_array(np.where(weights > 0, -weights, 0.0))  # of dense ones SciPy drops small links
    tree = minimum_spanning_tree(links)
    return float(-tree.data.max()) if tree.nnz else 0.0


def _as_range(weight: Any) -> tuple[float, float]:
    pair = tuple(weight) if isinstance(weight, list | tuple) else (weight, weight)
    if len(pair) != 2 or not SMALLEST <= real(pair[0]) <= real(pair[1]) <= LARGEST:
        raise ValueError(
            f"graph: weight_range {shown(pair)} must be finite, 0 < low <= high, from "
            f"{SMALLEST:g} to {LARGEST:g} m/s"
        )
    return real(pair[0]), real(pair[1])
