"""Graphs whose links follow sight."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from .fixed import CompleteGraph, Weight, as_range
from .graph import Graph


@dataclass(frozen=True)
class ProximityGraph(CompleteGraph, kinds=("proximity",)):
    """Robot i sees robot j while j is within its sensor's range and field of view.

    Its numbers are those of the complete graph, which it may become. With a field of view links can
    be one-way.
    """

    fixed: ClassVar[bool] = False
    changes: ClassVar[bool] = True

    def check_fits(self, scenario: Any) -> None:
        """Links by sight need a limit of sight, and one that lets a drawn start be connected."""
        sensing = scenario.sensing
        if sensing.range is None and sensing.field_of_view == type(sensing)().field_of_view:
            raise ValueError(
                "graph: proximity links whom a robot sees, and these see everyone; give sensing a "
                "range or a field_of_view, or take graphs.complete()"
            )
        if (reach := self.start_reach(scenario)) <= 2.0 * scenario.merge_radius:
            raise ValueError(
                f"sensing.range is {sensing.range}; at the start links of 2 merge_radius or longer "
                f"must stay below range − (n − 1) merge_radius/2 = {reach:.6g} m (guarantees, "
                "section 12); enlarge it, take fewer robots or a smaller merge_radius, or pass "
                "require_connected=False"
            )

    def start_reach(self, scenario: Any) -> float:
        """R − (n − 1) r/2, m, for a range R (guarantees, section 12); infinite without one, or if
        the start need not be connected.
        """
        sight = scenario.sensing.range
        if sight is None or not scenario.require_connected:
            return math.inf
        return float(sight - (scenario.n_robots - 1) * scenario.merge_radius / 2.0)


def proximity(weight: Weight = 1.0) -> Graph:
    """Robot i sees robot j while j is within the range and field of view of ``Scenario.sensing``;
    every pair has a weight of its own, which both give.
    """
    return Graph("proximity", as_range(weight))
