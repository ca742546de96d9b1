"""Scenarios that the JAX form covers; it rejects all others and names the field."""

from typing import NoReturn

from ..checks import short_repr
from ..graphs.random_graphs import DrawnGraph
from ..robots.robot_models import is_custom
from ..scenario.scenario import Scenario

_REMEDY = "not covered by JAX; use rendezvous_env.make_vec, which supports it"


def raise_not_covered(field: str, value: str) -> NoReturn:
    """Reject a field that ``rendezvous_env.jax`` does not support."""
    raise NotImplementedError(f"{field} is {value}: {_REMEDY}")


def check_covered(scenario: Scenario) -> None:
    """Reject a scenario that the JAX form cannot step exactly as the engine does.

    Raises:
        NotImplementedError: naming the first such field and its value.
    """
    graph, layout = scenario.sensing_graph, scenario.observation_layout
    most = graph.most_neighbours(scenario.n_robots)
    slots = scenario.neighbour_slots
    rejected = {
        "obstacles": bool(scenario.obstacles),
        "obstacle_slots": layout.obstacle_slots > 0,
        "graph": graph.changes or isinstance(graph, DrawnGraph),
        "robot_model": is_custom(scenario.model),
        "start_region": scenario.start_region is not None,
        "meeting": scenario.meeting != "merge",
        "sensing": not scenario.sensing.exact,
        "neighbour_slots": slots is not None and slots != most,
        "neighbour_overflow": scenario.neighbour_overflow != "error",
        "costs": bool(scenario.costs),
        "events": not scenario.events.none,
        "activation": not scenario.activation.synchronous,
        "reward": bool(scenario.reward.custom) or scenario.reward.clearance_penalty != 0.0,
    }
    shown = {"graph": graph.kind, "sensing": f"Sensing({scenario.sensing.departures()})"}
    rejected |= dict.fromkeys(scenario.per_robot, True)
    for field, is_rejected in rejected.items():
        if is_rejected:
            raise_not_covered(field, shown.get(field) or short_repr(getattr(scenario, field)))
