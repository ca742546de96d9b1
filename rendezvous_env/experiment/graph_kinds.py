"""The class of sensing graphs: undirected ones, fixed or families. Others are kinds of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .checks import real, shown, whole
from .graph_checks import as_range, ordered_edges
from .graph_numbers import bottleneck_weight, components, max_degree
from .limits import MOST_ROBOTS
from .topologies import ERDOS_RENYI, FIXED, RANDOM_TREE

_TOPOLOGIES = {"random_tree": RANDOM_TREE, "erdos_renyi": ERDOS_RENYI}
LARGE_TEAM = 48
"""Robots from which a step is made for what they see rather than for the worst of all merges."""
_FIXED_KINDS = ("complete", "path", "cycle", "star")


@dataclass(frozen=True)
class Graph:
    """An undirected weighted sensing graph for any number of robots, or a family of them.

    Make one with the functions of ``graphs`` rather than by hand. Graphs that are directed or
    change within an episode are kinds of it, which say for every number of it what it means there.
    """

    _KINDS: ClassVar[tuple[str, ...]] = (*_FIXED_KINDS, "edges", *_TOPOLOGIES)
    _LISTED: ClassVar[str] = "edges"
    """The kind whose edges are given one by one."""

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
        if not isinstance(self.kind, str) or self.kind not in self._KINDS:
            raise ValueError(
                f"graph: {shown(self.kind)} is not a graph; choose one of {', '.join(self._KINDS)}"
            )
        object.__setattr__(self, "weight_range", as_range(self.weight_range))
        if not 0 < real(self.probability) <= 1:
            raise ValueError(f"graph: probability {shown(self.probability)} must be in (0, 1]")
        object.__setattr__(self, "probability", real(self.probability))
        self._check_edges()

    def _check_edges(self) -> None:
        if self.kind != self._LISTED:
            if self.edges or self.n_nodes is not None:
                raise ValueError(f"graph: a {self.kind} has neither edges nor n_nodes")
            return
        n = whole("graph: n_nodes", self.n_nodes, 1, MOST_ROBOTS)
        object.__setattr__(self, "edges", self._ordered(n))
        object.__setattr__(self, "n_nodes", n)

    def _ordered(self, n: int) -> tuple[tuple[int, int, float], ...]:
        return ordered_edges(self.edges, n)

    @property
    def directed(self) -> bool:
        """Whether some robot may see another one that never sees it."""
        return False

    @property
    def changes(self) -> bool:
        """Whether edges come and go within an episode, other than by merging."""
        return False

    @property
    def undirected(self) -> bool:
        """Whether it is neither directed nor changes: what theorems A, C and D ask for."""
        return not (self.directed or self.changes)

    @property
    def topology(self) -> int:
        """How an episode chooses its edges, see ``topologies``."""
        return _TOPOLOGIES.get(self.kind, FIXED)

    def base_weights(self, n: int) -> NDArray[np.float64]:
        """Weights before drawing, (n, n): an episode keeps some edges and scales each by a draw.

        Raises:
            ValueError: if the graph's edges are for another number of robots.
        """
        weights = np.zeros((n, n))
        if self.kind == "edges":
            for i, j, weight in self._edges_for(n):
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

    def _edges_for(self, n: int) -> tuple[tuple[int, int, float], ...]:
        if n != self.n_nodes:
            raise ValueError(
                f"graph: its matrix or edge list is for {self.n_nodes} robots, not for {n}"
            )
        return self.edges

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
            pairs = list(self._edges_for(n))
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

    def why_not_joined(self, n: int) -> str | None:
        """Why robots of this graph can never all meet, in words; None if they can (theorem 1)."""
        pieces = self.components(n)
        if len(pieces) == 1:
            return None
        listed = " and ".join(map(str, pieces))
        return f"it falls into {listed}, which can never meet (theorem 1); join them by an edge"

    def max_degree(self, n: int) -> float:
        """D̄, m/s: the largest D_i = Σ_j a_ij that an episode or its merges can produce (theory
        4).
        """
        base, (_, high) = self.base_weights(n), self.weight_range
        if self.topology == RANDOM_TREE:
            return (n - 1) * high
        return max((max_degree(base[np.ix_(c, c)] * high) for c in components(base)), default=0.0)

    def step_degree(self, n: int) -> float:
        """The D_i, m/s, that a step of single integrators is made for: D̄ of a small team; of a
        large one the largest that a fixed graph has before any merge, twice the mean of a family.

        Merges could turn a large sparse graph into a star, and a step for that would be hundreds of
        times too short for the robots there are. Whoever has a larger D_i goes more slowly
        (theory 4).
        """
        worst, (_, high) = self.max_degree(n), self.weight_range
        if n < LARGE_TEAM:
            return worst
        if self.topology == FIXED:
            return min(worst, high * float(self.base_weights(n).sum(axis=1).max()))
        mean = 2.0 * (n - 1) / n if self.topology == RANDOM_TREE else self.probability * (n - 1)
        return min(worst, 2.0 * mean * high)

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
        if self.kind != self._LISTED and self == type(self)(self.kind):
            return self.kind
        plain: dict[str, Any] = {"kind": self.kind, "weight_range": list(self.weight_range)}
        if self.kind == self._LISTED:
            plain |= {"n_nodes": self.n_nodes, "edges": [list(edge) for edge in self.edges]}
        if self.kind == "erdos_renyi" or self.probability != Graph("complete").probability:
            plain["probability"] = self.probability
        return plain
