"""Graphs that take turns within an episode."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .. import checks
from ..checks import known_fields, refuse, shown
from . import weights as matrices
from .graph import Graph, GraphNumbers, LinkArrays, parse, step_degree

ORDERS = ("cyclic", "random")


@dataclass(frozen=True)
class SwitchingGraph(Graph, kinds=("switching",)):
    """A list of fixed graphs of which each holds for a dwell time.

    Whom a merge has made one stays one in all of them. Their numbers are the worst of the list,
    where robots may merge that are no neighbours in the graph at hand. It has no weights of its
    own: ``weight_range`` is 1.
    """

    fixed: ClassVar[bool] = False
    changes: ClassVar[bool] = True

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
            if not isinstance(graph, Graph) or not graph.fixed:
                kind = getattr(graph, "kind", graph)
                raise ValueError(
                    f"graph: graphs[{k}] is {shown(kind)}; switching takes graphs with fixed "
                    "edges: complete, path, cycle, star, directed_cycle, matrices and edge lists"
                )
        object.__setattr__(self, "graphs", tuple(listed))
        object.__setattr__(self, "dwell", checks.positive("graph: dwell", self.dwell, "s"))
        checks.choice("graph: order", self.order, ORDERS)

    def check_fits(self, scenario: Any) -> None:
        """A graph that holds for less than a step would never be seen."""
        if self.dwell < scenario.tau * (1 - 1e-9):
            raise ValueError(
                f"graph: dwell is {self.dwell:g} s, shorter than the time step {scenario.tau:g} s; "
                "it must be at least a step"
            )

    @property
    def directed(self) -> bool:  # type: ignore[override]
        """Whether a graph of the list is."""
        return any(graph.directed for graph in self.graphs)

    def base_weights(self, n: int) -> NDArray[np.float64]:
        """All graphs of the list together, (n, n), m/s: the heaviest a_ij that each pair can have.

        Raises:
            ValueError: if a graph of the list is for another number of robots.
        """
        listed = [graph.base_weights(n) * graph.weight_range[1] for graph in self.graphs]
        union: NDArray[np.float64] = np.max(listed, axis=0)
        return union

    def sparse_weights(self, n: int) -> Any:
        """The same as a sparse matrix."""
        return matrices.sparse(self.base_weights(n))

    def links(self, n: int) -> LinkArrays:
        """The edges of all graphs together: who sees, who is seen, and weights in m/s."""
        union = self.base_weights(n)
        sees, seen = np.nonzero(union)
        return sees, seen, union[sees, seen]

    def why_not_joined(self, n: int) -> str | None:
        """Why the graphs of the list together need not make all meet, in words; or None."""
        return matrices.why_not_led_together(self.closed_groups(n))

    def numbers(self, n: int) -> GraphNumbers:
        """The worst of the list, whoever has merged: merges in one graph gather the neighbours of
        another. Graphs without links make nobody's D_i small.
        """
        found = [graph.numbers(n) for graph in self.graphs]
        totals = [
            one.weight_sum * (2.0 if graph.directed else 1.0)
            for one, graph in zip(found, self.graphs, strict=True)
        ]
        heaviest = [(n - 1) * one.extreme_weights[1] for one in found]
        worst = max(map(min, heaviest, totals))
        return GraphNumbers(
            most_links=len(self.links(n)[0]),
            most_neighbours=n - 1,
            max_degree=worst,
            step_degree=step_degree(n, worst, max(one.step_degree for one in found)),
            bottleneck_weight=min(
                (one.bottleneck_weight for one in found if one.bottleneck_weight > 0.0), default=0.0
            ),
            weight_sum=max(one.weight_sum for one in found),
            extreme_weights=(
                min(one.extreme_weights[0] for one in found),
                max(one.extreme_weights[1] for one in found),
            ),
        )

    def to_plain(self) -> dict[str, Any]:
        """The graph as plain data for TOML."""
        listed = [graph.to_plain() for graph in self.graphs]
        return {"kind": self.kind, "graphs": listed, "dwell": self.dwell, "order": self.order}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Graph:
        """A graph from the plain data of ``to_plain``, some keys left out."""
        known_fields(plain, ("dwell", "graphs", "kind", "order"), "graph", "key")
        return switching(**{"graphs": (), **{k: v for k, v in plain.items() if k != "kind"}})


def switching(graphs: Iterable[Any], dwell: float = 1.0, order: str = "cyclic") -> Graph:
    """A list of fixed graphs of which each holds for a dwell time.

    Args:
        graphs: what ``parse`` takes, undirected or directed; their weights may be drawn from a
            range for every episode.
        dwell: s, at least a step.
        order: "cyclic", one after another, or "random", each time drawn anew.

    Raises:
        ValueError: naming the entry of the list that has no fixed edges, or the bad dwell or order.
    """
    if not isinstance(graphs, Iterable) or isinstance(graphs, str | bytes | Mapping | Graph):
        refuse("graph: graphs", graphs, "a list of graphs")
    listed = tuple(_member(k, graph) for k, graph in enumerate(graphs))
    return SwitchingGraph("switching", graphs=listed, dwell=dwell, order=order)


def _member(k: int, graph: Any) -> Graph:
    # looked at before it is parsed: tables could be nested without end
    if isinstance(graph, Mapping) and graph.get("kind") == "switching":
        raise ValueError(f"graph: graphs[{k}] is itself a switching graph; list its graphs instead")
    return parse(graph)
