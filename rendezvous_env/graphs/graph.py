"""What a sensing graph is: its fields, the numbers that theorems ask for, and the kinds there are.

Every kind is a subclass in a file of its own, which says what is particular to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from .. import checks
from ..checks import shown
from ..limits import MOST_ROBOTS
from . import reading
from . import weights as matrices
from .weights import Edges, checked_edges, weighted_links

GraphLike = Any
"""A Graph, the name of a kind, a matrix of weights, an edge list, a networkx graph, plain data."""
LinkArrays = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]
"""Edges: robots (E,), (E,), weights (E,), m/s; of directed ones who sees, and who is seen."""
_LARGE_TEAM = 48  # robots from which a step is made for what they see rather than for all merges
KINDS: dict[str, type[Graph]] = {}
"""The class of every kind of graph."""


def _check_probability(field: str, value: Any) -> float:
    if not 0 < checks.real(value) <= 1:
        checks.refuse(field, value, "in (0, 1]")
    return checks.real(value)


class GraphNumbers(NamedTuple):
    """What theorems and engine ask of a graph of n robots; ``Graph`` has a method for each."""

    most_links: int
    """The most links that an episode can have."""
    most_neighbours: int
    """The most neighbours that a robot can have in any episode, merges included, see
    ``weights.max_degree``."""
    max_degree: float
    """D̄, m/s: the largest D_i = Σ_j a_ij in any episode, merges included (theory 4)."""
    step_degree: float
    """The D_i, m/s, that a step of single integrators is made for: D̄ of a small team; of a large
    one the largest that a fixed graph has before any merge, twice the mean of a family."""
    bottleneck_weight: float
    """a*, m/s: the least a* over all graphs that an episode can draw (theory 3). Where links are
    directed or change, a number below which no D_i of a robot that sees someone falls."""
    weight_sum: float
    """W, m/s: the largest sum of edge weights that an episode can draw; of directed edges half of
    it, so that V ≤ 2 W × the largest distance."""
    extreme_weights: tuple[float, float]
    """The least and the largest a_ij that an edge can have, m/s; inf and 0 without edges."""


@lru_cache(maxsize=64)
def _numbers(graph: Graph, n: int) -> GraphNumbers:
    return graph.numbers(n)


def _number(name: str) -> Callable[[Graph, int], Any]:
    def of_robots(graph: Graph, n: int) -> Any:
        return getattr(_numbers(graph, n), name)

    return of_robots


def step_degree(n: int, worst: float, usual: float) -> float:
    """The D_i, m/s, that a step is made for, from D̄ (``worst``) and D_i before any merge.

    Merges could turn a large sparse graph into a star, and a step for that would be hundreds of
    times too short for the robots there are. Whoever has a larger D_i goes more slowly (theory 4).
    """
    return worst if n < _LARGE_TEAM else min(worst, usual)


@dataclass(frozen=True)
class Graph:
    """A weighted sensing graph for any number of robots, or a family of them.

    Make one with the functions of ``graphs``. This class is of graphs whose edges are the same in
    every episode; other kinds say what differs.
    """

    kind: str
    """complete, path, cycle, star, edges, random_tree, erdos_renyi, directed, directed_cycle,
    switching, proximity, or a family that has been registered."""
    weight_range: Annotated[tuple[float, float], partial(checks.number_range, unit="m/s")] = (
        1.0,
        1.0,
    )
    """Each edge draws its weight a_ij uniformly from this range, m/s; factors for listed edges."""
    edges: Iterable[Sequence[float]] = ()
    """(i, j, a_ij), with i < j where they are undirected; for kinds with listed edges only."""
    n_nodes: int | None = None
    """Number of robots that the edges are for; None is what the largest index asks for."""
    probability: Annotated[float, _check_probability] = 0.5
    """Chance of each edge; for kind "erdos_renyi" only."""

    listed: ClassVar[str] = ""
    """The kind, if any, whose edges are given one by one."""
    fixed: ClassVar[bool] = True
    """Whether all episodes have the same edges."""
    directed: ClassVar[bool] = False
    """Whether some robot may see another one that never sees it."""
    changes: ClassVar[bool] = False
    """Whether edges come and go within an episode, other than by merging."""
    keys: ClassVar[tuple[str, ...]] = ("edges", "kind", "n_nodes", "probability", "weight_range")
    """Of plain data."""

    def __init_subclass__(cls, kinds: Sequence[str] = ()) -> None:
        """Make a subclass the class of some kinds."""
        KINDS.update(dict.fromkeys(kinds, cls))

    def __new__(cls, kind: Any = None, *_: Any, **__: Any) -> Self:
        """An instance of the class of its kind."""
        return object.__new__(class_of(kind) if cls is Graph else cls)  # type: ignore[return-value]

    def __post_init__(self) -> None:
        if type(self) is not class_of(self.kind):
            raise ValueError(f"graph: {shown(self.kind)} is not a {type(self).__name__}")
        checks.check_fields(self, "graph: {}")
        if self.kind == self.listed:
            edges = self.edges if isinstance(self.edges, Edges) else matrices.read_edges(self.edges)
            count = self.n_nodes or (1 + max(max(0, i, j) for i, j, _ in edges) if edges else None)
            n = checks.whole("graph: n_nodes", count, 1, MOST_ROBOTS)
            object.__setattr__(self, "n_nodes", n)
            kept = checked_edges(edges, n, directed=self.directed)
            object.__setattr__(self, "edges", kept)
        elif self.edges != () or self.n_nodes is not None:
            raise ValueError(f"graph: a {self.kind} has neither edges nor n_nodes")
        if self.probability != Graph.probability and self.kind != "erdos_renyi":
            kinds = f"only kind 'erdos_renyi' has one, not {self.kind!r}"
            raise ValueError(f"graph: probability is {self.probability}; {kinds}")

    def check_fits(self, scenario: Any) -> None:
        """Refuse a scenario whose other fields this graph does not fit."""

    @property
    def undirected(self) -> bool:
        """Whether it is neither directed nor changes: what theorems A, C and D ask for."""
        return not (self.directed or self.changes)

    def links(self, n: int) -> LinkArrays:
        """The edges before drawing, sorted; refused if they are for another number of robots."""
        if not isinstance(self.edges, Edges) or n != self.n_nodes:
            given = f"its matrix or edge list is for {self.n_nodes} robots"
            raise ValueError(f"graph: {given}, not for {n}")
        return self.edges.first, self.edges.second, self.edges.weight

    def sparse_weights(self, n: int) -> Any:
        """``base_weights`` as a sparse matrix, in memory that follows the edges."""
        from scipy.sparse import csr_array

        first, second, weight = self.links(n)
        if not self.directed:
            first, second = np.concatenate([first, second]), np.concatenate([second, first])
            weight = np.concatenate([weight, weight])
        return csr_array((weight, (first, second)), shape=(n, n))

    def base_weights(self, n: int) -> NDArray[np.float64]:
        """Weights before drawing, (n, n): an episode keeps some edges and scales each by a draw."""
        weights: NDArray[np.float64] = self.sparse_weights(n).toarray()
        return weights

    def components(self, n: int) -> list[list[int]]:
        """Connected components as lists of robot indices; a family only draws connected graphs."""
        return [list(piece) for piece in _groups(self, n, matrices.components)]

    def closed_groups(self, n: int) -> list[list[int]]:
        """Groups of robots who see nobody outside, see ``weights.closed_groups``."""
        return [list(group) for group in _groups(self, n, matrices.closed_groups)]

    def why_not_joined(self, n: int) -> str | None:
        """Why robots of this graph can never all meet (theorem 1), or need not where it is directed
        or changes (guarantees, section 10); None if they do.
        """
        pieces = self.components(n) if self.undirected else self.closed_groups(n)
        listed = " and ".join(map(str, pieces))
        if len(pieces) == 1:
            return None
        if self.undirected:
            return f"it falls into {listed}, which can never meet (theorem 1); join them by an edge"
        return (
            f"{listed} each see nobody outside their own group, and so need not meet (guarantees, "
            "section 10); let some robot be reached from all"
        )

    def numbers(self, n: int) -> GraphNumbers:
        """All numbers of this graph for n robots; the methods below give them one by one."""
        (low, high), matrix, weight = self.weight_range, self.sparse_weights(n), self.links(n)[2]
        few, seen = (1 if self.directed else 2), np.diff(matrix.indptr).max()
        worst = high * matrices.max_degree(matrix, directed=self.directed)
        least, largest = float(weight.min(initial=np.inf)), float(weight.max(initial=0.0))
        sure = least if self.directed else matrices.bottleneck_weight(matrix)
        return GraphNumbers(
            most_links=len(weight),
            most_neighbours=min(few, n - 1) if seen <= few else n - 1,
            max_degree=worst,
            step_degree=step_degree(n, worst, high * float(matrix.sum(axis=1).max())),
            bottleneck_weight=low * (sure if len(weight) else 0.0),
            weight_sum=high * float(weight.sum()) * (0.5 if self.directed else 1.0),
            extreme_weights=(low * least, high * largest),
        )

    most_links = _number("most_links")
    most_neighbours = _number("most_neighbours")
    max_degree = _number("max_degree")
    step_degree = _number("step_degree")
    bottleneck_weight = _number("bottleneck_weight")
    weight_sum = _number("weight_sum")
    extreme_weights = _number("extreme_weights")

    def start_reach(self, scenario: Any) -> float:
        """Links up to this length, m, must connect every start that is drawn; inf asks nothing."""
        return float(np.inf)

    def to_plain(self) -> str | dict[str, Any]:
        """The graph as plain data for TOML; ``parse`` turns it back into an equal graph."""
        if self.kind != self.listed and self == Graph(self.kind):
            return self.kind
        plain: dict[str, Any] = {"kind": self.kind, "weight_range": list(self.weight_range)}
        if self.kind == self.listed:
            plain |= {"n_nodes": self.n_nodes, "edges": [list(edge) for edge in self.edges]}
        if self.probability != Graph.probability:
            plain["probability"] = self.probability
        return plain


@lru_cache(maxsize=16)  # as long as the team: of the last ones a certificate asks again and again
def _groups(graph: Graph, n: int, found_by: Callable[[Any], list[list[int]]]) -> list[list[int]]:
    return found_by(graph.sparse_weights(n))


def class_of(kind: Any) -> type[Graph]:
    """The class of a kind of graph; an unknown one is refused with the nearest known one."""
    return KINDS[checks.choice("graph", kind, KINDS)]


def parse(value: Any, n: int | None = None) -> Graph:
    """A Graph of n robots, if that is known, from a Graph, a name, the plain data of
    ``Graph.to_plain``, a matrix of weights, an edge list, or a networkx graph.

    A table of n rows is a matrix where it can be one; others with rows of two or three entries are
    edges. A networkx graph that is directed gives a directed graph.
    """
    if isinstance(value, Graph):
        return value
    if not isinstance(value, str) and not reading.is_plain(value):
        return _of_links(value, n)
    plain = {"kind": value} if isinstance(value, str) else value
    if not all(isinstance(key, str) for key in plain):
        checks.refuse("graph", value, f"{reading.GIVEN}; {reading.REMEDY}")
    kind = plain.get("kind", "edges" if "edges" in plain else "complete")
    checks.known_fields(plain, class_of(kind).keys, "graph", "key")
    try:
        return Graph(**{**plain, "kind": kind})
    except ValueError as error:
        if plain is value:
            raise
        made = f"more than its name, as rendezvous_env.graphs makes it: {error}"
        raise ValueError(f"graph: {shown(value)} needs {made}") from error


def _of_links(value: Any, n: int | None) -> Graph:
    """A graph from a networkx graph, an edge list or a matrix, whichever it can be."""
    if reading.is_networkx(value):
        return from_networkx("directed" if value.is_directed() else "edges", value)
    if (rows := reading.edge_rows(value)) is None:
        return _of_matrix(value)
    kind = "directed" if reading.is_directed_view(value) else "edges"
    as_edges = partial(Graph, kind, edges=rows, n_nodes=n)
    if any(len(row) != len(rows) for row in rows):
        return as_edges()
    readings = [partial(from_matrix_of, kind, rows), as_edges]
    if n not in (None, len(rows)):
        readings.reverse()
    try:
        return readings[0]()
    except ValueError:
        try:
            return readings[1]()
        except ValueError:
            pass
        raise


def _of_matrix(value: Any) -> Graph:
    """A graph from what is no edge list; what is no square matrix either has a remedy."""
    try:
        return from_matrix_of("edges", value)
    except ValueError as error:
        if reading.is_square(value):
            raise
        raise ValueError(f"{error}; {reading.REMEDY}") from error


def from_networkx(kind: str, graph: Any) -> Graph:
    """A graph with listed edges from one of networkx, whose attribute "weight" is a_ij, m/s."""
    directed, edges = class_of(kind).directed, reading.networkx_edges(graph)
    if graph.is_directed() and not directed:
        checks.refuse("graph", graph, "undirected; graphs.directed takes directed graphs")
    if directed and not graph.is_directed():
        edges += [(j, i, weight) for i, j, weight in edges]
    return Graph(kind, edges=edges, n_nodes=len(graph))


def from_matrix_of(kind: str, weights: Any, n: int | None = None) -> Graph:
    """A graph with listed edges from its (n, n) matrix of weights a_ij, m/s; 0 = no edge."""
    if reading.is_networkx(weights):
        return from_networkx(kind, weights)
    matrix = reading.as_matrix("graph", weights)
    edges = Edges(*weighted_links(matrix, n, directed=class_of(kind).directed))
    return Graph(kind, edges=edges, n_nodes=matrix.shape[0])
