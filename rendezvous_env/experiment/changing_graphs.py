"""Sensing graphs that change within an episode: lists that take turns, and links by sight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from . import checks
from .checks import refuse, shown
from .directed_graphs import why_not_led_together
from .graph_kinds import LARGE_TEAM, Graph
from .topologies import DIRECTED, FIXED, PROXIMITY, SWITCHING

ORDERS = ("cyclic", "random")


@dataclass(frozen=True)
class SwitchingGraph(Graph):
    """A list of fixed graphs of which each holds for a dwell time.

    Whom a merge has made one stays one in all of them. Their numbers are the worst of the list,
    where robots may merge that are no neighbours in the graph at hand. It has no weights of its
    own: ``weight_range`` is 1.
    """

    _KINDS: ClassVar[tuple[str, ...]] = ("switching",)

    graphs: tuple[Graph, ...] = ()
    """Fixed graphs for the same robots, undirected or directed."""
    dwell: float = 1.0
    """How long each holds, s; the switch is at the first step that begins then or later."""
    order: str = "cyclic"
    """One after another, or each time drawn anew from the list."""

    def __post_init__(self) -> None:
        """Convert and check every field."""
        super().__post_init__()
        if self.weight_range != (1.0, 1.0):
            raise ValueError("graph: a switching graph has the weights of its list, and no others")
        listed = self.graphs
        if not isinstance(listed, Sequence) or isinstance(listed, str) or not listed:
            refuse("graph: graphs", listed, "a list of at least one fixed graph")
        for k, graph in enumerate(listed):
            if not isinstance(graph, Graph) or graph.topology not in (FIXED, DIRECTED):
                kind = getattr(graph, "kind", graph)
                raise ValueError(
                    f"graph: graphs[{k}] is {shown(kind)}; switching takes graphs with fixed "
                    "edges: complete, path, cycle, star, directed_cycle, matrices and edge lists"
                )
        object.__setattr__(self, "graphs", tuple(listed))
        object.__setattr__(self, "dwell", checks.positive("graph: dwell", self.dwell, "s"))
        checks.choice("graph: order", self.order, ORDERS)

    @property
    def directed(self) -> bool:
        """Whether a graph of the list is."""
        return any(graph.directed for graph in self.graphs)

    @property
    def changes(self) -> bool:
        """True."""
        return True

    @property
    def topology(self) -> int:
        """SWITCHING."""
        return SWITCHING

    def base_weights(self, n: int) -> NDArray[np.float64]:
        """All graphs of the list together, (n, n), m/s: the heaviest a_ij that each pair can have.

        Raises:
            ValueError: if a graph of the list is for another number of robots.
        """
        listed = [graph.base_weights(n) * graph.weight_range[1] for graph in self.graphs]
        union: NDArray[np.float64] = np.max(listed, axis=0)
        return union

    def links(self, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """The arcs of all graphs together: who sees, who is seen, and weights in m/s; each (E,)."""
        union = self.base_weights(n)
        sees, seen = np.nonzero(union)
        return sees, seen, union[sees, seen]

    def why_not_joined(self, n: int) -> str | None:
        """Why the graphs of the list together need not make all meet, in words; or None."""
        return why_not_led_together(self.base_weights(n))

    def most_neighbours(self, n: int) -> int:
        """All others, n − 1: merges in one graph gather the neighbours of another."""
        return n - 1

    def max_degree(self, n: int) -> float:
        """D̄, m/s: the largest D_i in any graph of the list, whoever has merged."""
        worst = 0.0
        for graph in self.graphs:
            weights = graph.base_weights(n) * graph.weight_range[1]
            total = weights.sum() * (1.0 if graph.directed else 0.5)
            worst = max(worst, min((n - 1) * float(weights.max()), float(total)))
        return worst

    def step_degree(self, n: int) -> float:
        """The D_i, m/s, that a step is made for; of a large team the largest of the list."""
        worst = self.max_degree(n)
        if n < LARGE_TEAM:
            return worst
        return min(worst, max(graph.step_degree(n) for graph in self.graphs))

    def bottleneck_weight(self, n: int) -> float:
        """The least of the list, m/s, of those that have links: no D_i of a robot that sees someone
        falls below it.
        """
        found = [graph.bottleneck_weight(n) for graph in self.graphs]
        return min((weight for weight in found if weight > 0.0), default=0.0)

    def weight_sum(self, n: int) -> float:
        """W, m/s: the largest of the list."""
        return max(graph.weight_sum(n) for graph in self.graphs)

    def to_plain(self) -> dict[str, Any]:
        """The graph as plain data for TOML."""
        listed = [graph.to_plain() for graph in self.graphs]
        return {"kind": self.kind, "graphs": listed, "dwell": self.dwell, "order": self.order}


@dataclass(frozen=True)
class ProximityGraph(Graph):
    """Robot i sees robot j while j is within its sensor's range and field of view.

    Its numbers are those of the complete graph, which it may become. Sight within a range is
    mutual; with a field of view links can be one-way.
    """

    _KINDS: ClassVar[tuple[str, ...]] = ("proximity",)

    @property
    def changes(self) -> bool:
        """True."""
        return True

    @property
    def topology(self) -> int:
        """PROXIMITY."""
        return PROXIMITY

    def step_degree(self, n: int) -> float:
        """D̄, m/s: a team that gathers sees more and more."""
        return self.max_degree(n)

    def bottleneck_weight(self, n: int) -> float:
        """The least weight of a link, m/s: no D_i of a robot that sees someone falls below it."""
        return self.weight_range[0]
