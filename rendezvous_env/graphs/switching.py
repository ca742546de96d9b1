"""Switching graphs: several fixed graphs in sequence within an episode."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from ..checks import format_limit, raise_invalid, short_repr
from ..field_checks import Seconds, known_arguments
from .graph import Graph, GraphNumbers, LinkArrays, parse, step_degree


def _check_graphs(field: str, value: Any) -> tuple[Graph, ...]:
    if not isinstance(value, Iterable) or isinstance(value, str | bytes | Mapping | Graph):
        raise_invalid(field, value, "a list of graphs")
    listed = []
    for k, given in enumerate(value):
        # checked before parsing, since tables could be nested infinitely
        if isinstance(given, Mapping) and given.get("kind") == "switching":
            raise ValueError(f"{field}[{k}] is itself a switching graph; list its graphs instead")
        graph = parse(given)
        if not graph.fixed:
            raise ValueError(
                f"{field}[{k}] is {short_repr(graph.kind)}; switching takes graphs with fixed "
                "edges: "
                "complete, path, cycle, star, directed_cycle, matrices and edge lists"
            )
        listed.append(graph)
    if not listed:
        raise_invalid(field, (), "a list of at least one fixed graph")
    return tuple(listed)


@dataclass(frozen=True)
class SwitchingGraph(Graph, kinds=("switching",)):
    """Switching sequence of fixed graphs with a dwell time; merges apply to all of them.

    Quantities are the worst of the list, since robots may merge that are not neighbours in the
    current graph. It has no weights itself: ``weight_range`` is 1.
    """

    fixed: ClassVar[bool] = False
    changes: ClassVar[bool] = True
    keys: ClassVar[tuple[str, ...]] = ("dwell", "graphs", "kind", "order")

    graphs: Annotated[tuple[Graph, ...], _check_graphs] = ()
    """Fixed graphs of the same number of robots, undirected or directed."""
    dwell: Seconds = 1.0
    """Dwell time, s. Switches are due at its multiples and happen at the next start of a step."""
    order: Literal["cyclic", "random"] = "cyclic"
    """Order: cyclic, or random at every switch."""

    def __repr__(self) -> str:
        """As ``Graph``."""
        order = "" if self.order == "cyclic" else f", order={self.order!r}"
        return f"graphs.switching({list(self.graphs)}, dwell={self.dwell}{order})"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.weight_range != (1.0, 1.0):
            raise ValueError("graph: a switching graph has only the weights of its list")

    def check_fits(self, scenario: Any) -> None:
        """Raise a ValueError if the dwell time is shorter than a step."""
        if self.dwell < scenario.tau * (1 - 1e-9):
            raise ValueError(
                f"graph: dwell is {format_limit(self.dwell)} s, shorter than the time step "
                f"{format_limit(scenario.tau)} s; it must be at least a step"
            )

    @property
    def directed(self) -> bool:  # type: ignore[override]
        """True if any graph of the list is directed."""
        return any(graph.directed for graph in self.graphs)

    def links(self, n: int) -> LinkArrays:
        """Union of the edges of all graphs, with their maximum weights a_ij."""
        listed = [graph.base_weights(n) * graph.weight_range[1] for graph in self.graphs]
        union = np.max(listed, axis=0)
        sees, seen = np.nonzero(union if self.directed else np.triu(union))
        return sees, seen, union[sees, seen]

    def numbers(self, n: int) -> GraphNumbers:
        """Worst quantities of the list, since merges in one graph combine neighbours of another.

        Graphs without links are ignored for lower bounds of D_i.
        """
        found = [graph.numbers(n) for graph in self.graphs]
        worst = max(
            min((n - 1) * one.extreme_weights[1], one.weight_sum * (2.0 if graph.directed else 1.0))
            for one, graph in zip(found, self.graphs, strict=True)
        )
        sure = [one.bottleneck_weight for one in found if one.bottleneck_weight > 0.0]
        least, largest = zip(*(one.extreme_weights for one in found), strict=True)
        return GraphNumbers(
            most_links=len(self.links(n)[0]),
            most_neighbours=n - 1,
            max_degree=worst,
            step_degree=step_degree(n, worst, max(one.step_degree for one in found)),
            bottleneck_weight=min(sure, default=0.0),
            weight_sum=max(one.weight_sum for one in found),
            extreme_weights=(min(least), max(largest)),
        )

    def to_plain(self) -> dict[str, Any]:
        """Plain data for TOML."""
        listed = [graph.to_plain() for graph in self.graphs]
        return {"kind": self.kind, "graphs": listed, "dwell": self.dwell, "order": self.order}


@known_arguments
def switching(
    graphs: Iterable[Any], dwell: float = 1.0, order: Literal["cyclic", "random"] = "cyclic"
) -> Graph:
    """Switching sequence of fixed graphs.

    Args:
        graphs: arguments of ``parse``, undirected or directed; weights may be random per episode.
        dwell: dwell time, s, at least one step.
        order: "cyclic", or "random" at every switch.

    Raises:
        ValueError: naming an entry without fixed edges, or an invalid dwell time or order.
    """
    listed = _check_graphs("graph: graphs", graphs)
    return SwitchingGraph("switching", graphs=listed, dwell=dwell, order=order)
