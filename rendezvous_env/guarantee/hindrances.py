"""Why no theorem speaks of a scenario: its robots, its links, or what its sensors get wrong."""

from __future__ import annotations

from ..experiment.scenario import Scenario
from ..experiment.sensing import Sensing
from .bounds import connected
from .degrees import is_complete
from .kinds_of_links import DIRECTED, PROXIMITY, SWITCHING, UNDIRECTED, kind_of_links, leaders
from .links import asymmetric_sight

COVERS = {
    "law": (UNDIRECTED, DIRECTED, SWITCHING),
    "heading": (UNDIRECTED,),
    "tank": (UNDIRECTED,),
    "gains": (UNDIRECTED, DIRECTED, SWITCHING),
    "links": (UNDIRECTED, PROXIMITY),
}
"""The kinds of links under which each theorem holds: A and G for law (1), C, D, G and R."""
_WHY_NOT = {
    DIRECTED: "V counts links both ways, and here a robot need not be seen by whom it sees",
    SWITCHING: (
        "what lets V fall in one graph lets it rise in the next: three robots on paths that take "
        "turns grow without end under law (4) for ε < 0.277"
    ),
    PROXIMITY: "robots that are moved by it may lose sight of each other for ever",
}


def hindrance(scenario: Scenario, by: str) -> str:
    """Why the theorem behind a choice does not speak of these robots and sensors.

    Args:
        scenario: the experiment.
        by: one of CHOICES.

    Returns:
        Words that begin with "none"; empty if it does speak of them.
    """
    return _of_links(scenario, by) or _of_robots(scenario, by) or _of_sensors(scenario, by)


def _of_links(scenario: Scenario, by: str) -> str:
    kind = kind_of_links(scenario.sensing_graph)
    if kind not in COVERS[by]:
        why = _WHY_NOT[kind] if by != "links" else "theorem R needs that both see each other"
        instead = "links" if kind == PROXIMITY else "gains"
        return f'none: by="{by}" has no theorem on {kind} graphs: {why}; by="{instead}" has one'
    if not connected(scenario):
        return "none: the graph is not connected, one robot per component remains (theorem 1)"
    if kind in (DIRECTED, SWITCHING) and len(groups := leaders(scenario)) > 1:
        listed = " and ".join(map(str, groups))
        when = " at some time" if kind == SWITCHING else ""
        return (
            f"none: robots {listed} see nobody outside their own group{when}; theorem G needs one "
            "that can be reached from all, always. The hull of the team never grows"
        )
    return ""


def _of_robots(scenario: Scenario, by: str) -> str:
    model = scenario.model
    if not model.bounded and model.theorem is None:
        return (
            f"none: no theorem covers {model.name} robots, whose action ({model.action}) is not "
            "their velocity; V may rise at any time"
        )
    mutual = kind_of_links(scenario.sensing_graph) == UNDIRECTED
    if not model.bounded and (by in ("gains", "links") or not mutual):
        return (
            f"none: theorems G and R are for robots whose action is their velocity, and that of "
            f"{model.name} robots is {model.action}"
        )
    return ""


def _of_sensors(scenario: Scenario, by: str) -> str:
    sensing = scenario.sensing
    if sensing.delay:
        return (
            "none: the theorems hold for exact bearings, or wrong ones that are not late, as this "
            f"sensor's are ({sensing.departures()})"
        )
    if sensing.noise or sensing.bias:
        words = (
            "none: the theorems hold for exact bearings, or errors up to a bound, and this "
            f"sensor's have none ({sensing.departures()})"
        )
        expected = by == "law" and not sensing.bias
        return words + "; see expected_time_bound for what noise leaves of law (1)" * expected
    if by == "links":
        reason = asymmetric_sight(scenario)
        return f"none: {reason}" if reason else ""
    if by in ("law", "gains") and nearest_seen(scenario):
        return ""
    if missed := _missed(scenario):
        never = " The hull of the team never grows." if by == "gains" else ""
        return (
            f"none: neighbours can be out of sight ({missed}); a theorem needs all of them.{never}"
        )
    return ""


def nearest_seen(scenario: Scenario) -> bool:
    """Whether robots miss neighbours only behind others: the nearest is always seen, and law (1)
    has gains of at least a* (guarantees 13).
    """
    only = Sensing(occlusion="robots", error=scenario.sensing.error)
    complete = is_complete(scenario.sensing_graph, scenario.n_robots)
    return complete and scenario.sensing == only and scenario.model.bounded


def _missed(scenario: Scenario) -> str:
    """The fields of a sensor that may leave out rows of neighbours, in words."""
    sensing = scenario.sensing
    seeing_all = Sensing(error=sensing.error, sectors=sensing.sectors)
    return "" if sensing == seeing_all else sensing.departures()
