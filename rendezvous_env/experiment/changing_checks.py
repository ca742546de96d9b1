"""What a graph that changes within an episode asks of the other fields of a scenario."""

from __future__ import annotations

import math

from .derived_constants import DerivedConstants
from .sensing import Sensing
from .topologies import PROXIMITY


def check_sight(scenario: DerivedConstants) -> None:
    """Links by sight need a limit of sight, and one that lets a drawn start be connected.

    Raises:
        ValueError: naming the graph, or the range that is too short.
    """
    sensing = scenario.sensing
    if scenario.sensing_graph.topology != PROXIMITY:
        return
    if sensing.range is None and sensing.field_of_view == Sensing().field_of_view:
        raise ValueError(
            "graph: proximity links whom a robot sees, and these see everyone; give sensing a "
            "range or a field_of_view, or take graphs.complete()"
        )
    if scenario.start_reach <= 2.0 * scenario.merge_radius:
        raise ValueError(
            f"sensing.range is {sensing.range}; at the start links of 2 merge_radius or longer "
            "must stay below range − (n − 1) merge_radius/2 = "
            f"{scenario.start_reach:.6g} m (guarantees, section 12); enlarge it, take fewer robots "
            "or a smaller merge_radius, or pass require_connected=False"
        )


def check_dwell(scenario: DerivedConstants) -> None:
    """A graph that holds for less than a step would never be seen.

    Raises:
        ValueError: naming dwell and step.
    """
    dwell = getattr(scenario.sensing_graph, "dwell", math.inf)
    if dwell < scenario.tau * (1 - 1e-9):
        raise ValueError(
            f"graph: dwell is {dwell:g} s, shorter than the time step {scenario.tau:g} s; it must "
            "be at least a step"
        )
