"""Scenarios that the JAX form covers; it rejects all others and names the field."""

from ..graphs.random_graphs import DrawnGraph
from ..robots.robot_models import is_custom
from ..scenario.scenario import Scenario
from ..sensors.sensing import Sensing

REMEDY = "rendezvous_env.make_vec has all of it"


def check_covered(scenario: Scenario) -> None:
    """Refuse a scenario that the JAX form cannot step exactly as the engine does.

    Raises:
        NotImplementedError: naming the first such field and its value.
    """
    graph, layout = scenario.sensing_graph, scenario.observation_layout
    most = graph.most_neighbours(scenario.n_robots)
    slots = scenario.neighbour_slots
    refused = {
        "obstacles": bool(scenario.obstacles),
        "obstacle_slots": layout.obstacle_slots > 0,
        "graph": graph.changes or isinstance(graph, DrawnGraph),
        "robot_model": is_custom(scenario.model),
        "meeting": scenario.meeting != "merge",
        "sensing": scenario.sensing != Sensing(),
        "neighbour_slots": slots is not None and slots != most,
        "neighbour_overflow": scenario.neighbour_overflow != "error",
        "costs": bool(scenario.costs),
        "reward": bool(scenario.reward.custom) or scenario.reward.clearance_penalty != 0.0,
    }
    for field, is_refused in refused.items():
        if is_refused:
            value = getattr(scenario, field)
            shown = graph.kind if field == "graph" else repr(value)
            raise NotImplementedError(f"{field} is {shown[:80]}: not covered by JAX; {REMEDY}")
