"""Base class of sensing graphs: fields, the quantities used by theorems, and the known kinds.

Every kind is a subclass in its own module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from .. import checks, field_checks
from ..checks import short_repr
from ..limits import MAX_ROBOTS
from . import reading
from . import weights as matrices
from .weights import Edges, checked_edges, weighted_links

GraphLike = Any
"""A Graph, the name of a kind, a matrix of weights, an edge list, a networkx graph, plain data."""
LinkArrays = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]
"""Edges: robots (E,), (E,), weights (E,), m/s; for directed ones observer and observed robot."""
_LARGE_TEAM = 48  # number of robots from which the default step follows D_i before merges
KINDS: dict[str, type[Graph]] = {}
"""Class by kind of graph."""


def _check_probability(field: str, value: Any) -> float:
    if not 0 < checks.to_float(value) <= 1:
        checks.raise_invalid(field, value, "in (0, 1]")
    return checks.to_float(value)


class GraphNumbers(NamedTuple):
    """Quantities of a graph of n robots for theorems and engine; each is a method of ``Graph``."""

    most_links: int
    """Maximum number of links in an episode."""
    most_neighbours: int
    """Maximum number of neighbours of a robot in any episode, merges included, see
    ``weights.max_degree``."""
    max_degree: float
    """D̄, m/s: the maximum D_i = Σ_j a_ij in any episode, merges included (theory 4)."""
    step_degree: float
    """D_i, m/s, for the default time step of single integrators: D̄ for few robots; for many the
    maximum of a fixed graph before merges, or twice the mean of a random graph."""
    bottleneck_weight: float
    """a*, m/s: minimum over all graphs of an episode (theory 3). For directed or time-varying
    links, a lower bound of D_i of a robot with a neighbour."""
    weight_sum: float
    """W, m/s: maximum sum of edge weights, half of it for directed edges, so that V ≤ 2 W × the
    maximum distance."""
    extreme_weights: tuple[float, float]
    """Minimum and maximum edge weight a_ij, m/s; inf and 0 without edges."""


@lru_cache(maxsize=64)
def _numbers(graph: Graph, n: int) -> GraphNumbers:
    return graph.numbers(n)


def _number(name: str) -> Callable[[Graph, int], Any]:
    def of_robots(graph: Graph, n: int) -> Any:
        return getattr(_numbers(graph, n), name)

    return of_robots


def step_degree(n: int, worst: float, usual: float) -> float:
    """D_i, m/s, for the default time step, from D̄ (``worst``) and D_i before any merge.

    Merges could turn a large sparse graph into a star, whose certified step would be hundreds of
    times shorter. Robots with a larger D_i scale their velocity instead (theory 4).
    """
    return worst if n < _LARGE_TEAM else min(worst, usual)


_BY_WEIGHT = ("complete", "path", "cycle", "star", "random_tree", "directed_cycle", "proximity")
"""Kinds that a function of this package of the same name creates from weights alone."""
_BY_EDGES = {"edges": "from_edges", "directed": "directed"}
"""Functions that create the kinds with listed edges."""


@dataclass(frozen=True)
class Graph:
    """Weighted sensing graph for any number of robots, or a family of random graphs.

    Use the functions of ``graphs`` to create one. This base class has the same edges in every
    episode; subclasses document differences.
    """

    kind: str
    """complete, path, cycle, star, edges, random_tree, erdos_renyi, directed, directed_cycle,
    switching, proximity, or a registered family."""
    weight_range: Annotated[tuple[float, float], partial(checks.number_range, unit="m/s")] = (
        1.0,
        1.0,
    )
    """Range of the uniformly sampled weights a_ij, m/s; factors for listed edges."""
    edges: Iterable[Sequence[float]] = ()
    """Edges (i, j, a_ij), i < j if undirected; for kinds with listed edges only."""
    n_nodes: int | None = None
    """Number of robots; None is the largest index + 1."""
    probability: Annotated[float, _check_probability] = 0.5
    """Edge probability; for kind "erdos_renyi" only."""

    listed: ClassVar[str] = ""
    """Kind with listed edges, if any."""
    fixed: ClassVar[bool] = True
    """True if all episodes have the same edges."""
    directed: ClassVar[bool] = False
    """True if visibility may be one-way."""
    changes: ClassVar[bool] = False
    """True if edges change within an episode other than by merging."""
    keys: ClassVar[tuple[str, ...]] = ("edges", "kind", "n_nodes", "probability", "weight_range")
    """Keys of plain data."""

    def __init_subclass__(cls, kinds: Sequence[str] = ()) -> None:
        """Register a subclass for its kinds; all have one ``repr``."""
        KINDS.update(dict.fromkeys(kinds, cls))
        if "__repr__" not in vars(cls):
            cls.__repr__ = Graph.__repr__  # type: ignore[method-assign]

    def __new__(cls, kind: Any = None, *_: Any, **__: Any) -> Self:
        """Create an instance of the class of the given kind."""
        return object.__new__(class_of(kind) if cls is Graph else cls)  # type: ignore[return-value]

    def __post_init__(self) -> None:
        if type(self) is not class_of(self.kind):
            raise ValueError(f"graph: {short_repr(self.kind)} is not a {type(self).__name__}")
        field_checks.check_fields(self, "graph: {}")
        if self.kind == self.listed:
            edges = self.edges if isinstance(self.edges, Edges) else matrices.read_edges(self.edges)
            count = self.n_nodes or (1 + max(max(0, i, j) for i, j, _ in edges) if edges else None)
            n = checks.check_int("graph: n_nodes", count, 1, MAX_ROBOTS)
            object.__setattr__(self, "n_nodes", n)
            kept = checked_edges(edges, n, directed=self.directed)
            object.__setattr__(self, "edges", kept)
        elif self.edges != () or self.n_nodes is not None:
            raise ValueError(f"graph: a {self.kind} has neither edges nor n_nodes")
        if self.probability != Graph.probability and self.kind != "erdos_renyi":
            kinds = f"only kind 'erdos_renyi' has one, not {self.kind!r}"
            raise ValueError(f"graph: probability is {self.probability}; {kinds}")

    def __repr__(self) -> str:
        """Call of ``rendezvous_env.graphs`` that creates an equal graph."""
        low, high = self.weight_range
        weights = [] if low == high == 1.0 else [repr(low if low == high else (low, high))]
        if self.kind in _BY_WEIGHT:
            return f"graphs.{self.kind}({', '.join(weights)})"
        if self.kind == "erdos_renyi":
            return f"graphs.erdos_renyi({', '.join([repr(self.probability), *weights])})"
        if self.kind in _BY_EDGES and not weights:
            return f"graphs.{_BY_EDGES[self.kind]}({self.edges!r}, n_robots={self.n_nodes})"
        return f"graphs.parse({self.to_plain()!r})"

    def check_fits(self, scenario: Any) -> None:
        """Raise a ValueError if the graph does not fit the other fields of a scenario."""

    @property
    def undirected(self) -> bool:
        """True if it is neither directed nor time-varying, as theorems A, C and D require."""
        return not (self.directed or self.changes)

    def links(self, n: int) -> LinkArrays:
        """Sorted edges before sampling; a ValueError for another number of robots."""
        if not isinstance(self.edges, Edges) or n != self.n_nodes:
            given = f"its matrix or edge list is for {self.n_nodes} robots"
            raise ValueError(f"graph: {given}, not for {n}")
        return self.edges.first, self.edges.second, self.edges.weight

    def sparse_weights(self, n: int) -> Any:
        """``base_weights`` as a sparse matrix."""
        from scipy.sparse import csr_array

        first, second, weight = self.links(n)
        if not self.directed:
            first, second = np.concatenate([first, second]), np.concatenate([second, first])
            weight = np.concatenate([weight, weight])
        return csr_array((weight, (first, second)), shape=(n, n))

    def base_weights(self, n: int) -> NDArray[np.float64]:
        """Weights before sampling, (n, n): an episode keeps some edges and scales each."""
        weights: NDArray[np.float64] = self.sparse_weights(n).toarray()
        return weights

    def components(self, n: int) -> list[list[int]]:
        """Connected components as lists of robot indices; random graphs are connected."""
        return [list(piece) for piece in _groups(self, n, matrices.components)]

    def closed_groups(self, n: int) -> list[list[int]]:
        """Groups of robots without edges to other robots, see ``weights.closed_groups``."""
        return [list(group) for group in _groups(self, n, matrices.closed_groups)]

    def connectivity_error(self, n: int) -> str | None:
        """Reason why rendezvous is impossible (theorem 1) or not guaranteed; None without one.

        It is not guaranteed on some directed or time-varying graphs (guarantees, section 10).
        """
        pieces = self.components(n) if self.undirected else self.closed_groups(n)
        listed = " and ".join(map(str, pieces))
        if len(pieces) == 1:
            return None
        if self.undirected:
            return f"components {listed} can never meet (theorem 1); connect them by an edge"
        return (
            f"{listed} observe no robot outside their own group, so they need not meet "
            "(guarantees, section 10); some robot must be reachable from all others"
        )

    def numbers(self, n: int) -> GraphNumbers:
        """All quantities of this graph for n robots, also available as methods."""
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
        """Maximum length of links that must connect sampled initial positions, m; inf for none."""
        return float(np.inf)

    def to_plain(self) -> str | dict[str, Any]:
        """Plain data for TOML; ``parse`` is the inverse."""
        if self.kind != self.listed and self == Graph(self.kind):
            return self.kind
        plain: dict[str, Any] = {"kind": self.kind, "weight_range": list(self.weight_range)}
        if self.kind == self.listed:
            plain |= {"n_nodes": self.n_nodes, "edges": [list(edge) for edge in self.edges]}
        if self.probability != Graph.probability:
            plain["probability"] = self.probability
        return plain


@lru_cache(maxsize=16)  # cached, since certificates need it repeatedly
def _groups(graph: Graph, n: int, found_by: Callable[[Any], list[list[int]]]) -> list[list[int]]:
    return found_by(graph.sparse_weights(n))


def class_of(kind: Any) -> type[Graph]:
    """Class of a kind of graph; a ValueError for an unknown kind names the closest match."""
    return KINDS[checks.choice("graph", kind, KINDS)]


def parse(value: Any, n: int | None = None) -> Graph:
    """Graph from a name, plain data, a matrix of weights, an edge list, or a networkx graph.

    Plain data are those of ``Graph.to_plain``; a Graph is returned unchanged. A table of n rows is
    a matrix where it can be one; others with rows of two or three entries are edges. A directed
    networkx graph gives a directed graph.
    """
    if isinstance(value, Graph):
        return value
    if not isinstance(value, str) and not reading.is_plain(value):
        return _of_links(value, n)
    plain = {"kind": value} if isinstance(value, str) else value
    if not all(isinstance(key, str) for key in plain):
        checks.raise_invalid("graph", value, f"{reading.GIVEN}; {reading.REMEDY}")
    kind = plain.get("kind", "edges" if "edges" in plain else "complete")
    field_checks.known_fields(plain, class_of(kind).keys, "graph", "key")
    try:
        return Graph(**{**plain, "kind": kind})
    except ValueError as error:
        if plain is value:
            raise
        made = f"created by rendezvous_env.graphs, not given by name: {error}"
        raise ValueError(f"graph: {short_repr(value)} needs {made}") from error


def _of_links(value: Any, n: int | None) -> Graph:
    """Graph from a networkx graph, an edge list or a matrix."""
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
    """Graph from a matrix; the error for other values has a remedy."""
    try:
        return from_matrix_of("edges", value)
    except ValueError as error:
        if reading.is_square(value):
            raise
        raise ValueError(f"{error}; {reading.REMEDY}") from error


def from_networkx(kind: str, graph: Any) -> Graph:
    """Graph with listed edges from a networkx graph with the attribute "weight" as a_ij, m/s."""
    directed, edges = class_of(kind).directed, reading.networkx_edges(graph)
    if graph.is_directed() and not directed:
        checks.raise_invalid("graph", graph, "undirected; graphs.directed takes directed graphs")
    if directed and not graph.is_directed():
        edges += [(j, i, weight) for i, j, weight in edges]
    return Graph(kind, edges=edges, n_nodes=len(graph))


def from_matrix_of(kind: str, weights: Any, n: int | None = None) -> Graph:
    """Graph with listed edges from an (n, n) matrix of weights a_ij, m/s; 0 = no edge."""
    if reading.is_networkx(weights):
        return from_networkx(kind, weights)
    matrix = reading.as_matrix("graph", weights)
    edges = Edges(*weighted_links(matrix, n, directed=class_of(kind).directed))
    return Graph(kind, edges=edges, n_nodes=matrix.shape[0])
