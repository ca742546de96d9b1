"""Proximity graphs: links follow visibility."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from ..field_checks import known_arguments
from .fixed import CompleteGraph, Weight, as_range
from .graph import Graph


@dataclass(frozen=True)
class ProximityGraph(CompleteGraph, kinds=("proximity",)):
    """Graph in which robot i observes robot j while j is within range and field of view.

    Its quantities are those of the complete graph, which it may become. With a limited field of
    view, links can be one-way.
    """

    fixed: ClassVar[bool] = False
    changes: ClassVar[bool] = True

    def check_fits(self, scenario: Any) -> None:
        """Raise a ValueError without a sensor limit, or if no connected start can be sampled."""
        sensing = scenario.sensing
        for name in ("range", "field_of_view"):
            if isinstance(given := getattr(sensing, name), tuple):
                raise ValueError(
                    f"sensing.{name} is {list(given)}; it must be one number for all robots with a "
                    "proximity graph, whose links follow it, or use a fixed graph"
                )
        if sensing.range is None and sensing.field_of_view == type(sensing)().field_of_view:
            raise ValueError(
                "graph: proximity links follow visibility, which has no limits here; give "
                "sensing a "
                "range or a field_of_view, or take graphs.complete()"
            )
        if (reach := self.start_reach(scenario)) <= 2.0 * scenario.merge_radius:
            raise ValueError(
                f"sensing.range is {sensing.range}; initial links of 2 merge_radius or longer "
                f"must stay below range − (n − 1) merge_radius/2 = {reach:.6g} m (guarantees, "
                "section 12); enlarge it, take fewer robots or a smaller merge_radius, or pass "
                "require_connected=False"
            )

    def start_reach(self, scenario: Any) -> float:
        """R − (n − 1) r/2, m, for a range R (guarantees, section 12).

        Infinite without a range, or if the initial graph need not be connected.
        """
        sight = scenario.sensing.range
        if sight is None or not scenario.require_connected:
            return math.inf
        return float(sight - (scenario.n_robots - 1) * scenario.merge_radius / 2.0)


@known_arguments
def proximity(weight: Weight = 1.0) -> Graph:
    """Graph in which robot i observes robot j within range and field of view of the sensor.

    The limits are those of ``Scenario.sensing``. Every pair has one symmetric weight.
    """
    return Graph("proximity", as_range(weight))
