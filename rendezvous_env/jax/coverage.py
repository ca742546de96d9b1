"""Scenarios that the JAX form covers; it rejects all others and names the field."""

from typing import NoReturn

from ..checks import short_repr
from ..graphs.random_graphs import DrawnGraph
from ..obstacles.fields import ObstacleField
from ..obstacles.moving import moves
from ..obstacles.parsing import max_count
from ..robots.robot_models import is_custom
from ..scenario.scenario import Scenario
from .imperfections import not_covered
from .obstacles.fields import MAX_SPHERES

_REMEDY = "not covered by JAX; use rendezvous_env.make_vec, which supports it"


def raise_not_covered(field: str, value: str) -> NoReturn:
    """Reject a field that ``rendezvous_env.jax`` does not support."""
    raise NotImplementedError(f"{field} is {value}: {_REMEDY}")


def _is_rare_field(scenario: Scenario) -> bool:
    """True for a random field with a minimum passage, or many spheres."""
    field = scenario.obstacles
    if not isinstance(field, ObstacleField):
        return False
    return field.passage > 0.0 or (scenario.dim == 3 and field.most > MAX_SPHERES)


def check_covered(scenario: Scenario) -> None:
    """Reject a scenario that the JAX form cannot step exactly as the engine does.

    Raises:
        NotImplementedError: naming the first such field and its value.
    """
    graph, layout = scenario.sensing_graph, scenario.observation_layout
    most = graph.most_neighbours(scenario.n_robots)
    slots, sensing = scenario.neighbour_slots, not_covered(scenario.sensing)
    rejected = {
        "obstacles": moves(scenario.obstacles) or _is_rare_field(scenario),
        "obstacle_slots": layout.obstacle_slots < max_count(scenario.obstacles),
        "graph": graph.changes or isinstance(graph, DrawnGraph),
        "robot_model": is_custom(scenario.model),
        "start_region": scenario.start_region is not None,
        "meeting": scenario.meeting != "merge",
        "sensing": bool(sensing),
        "neighbour_slots": slots is not None and slots != most,
        "neighbour_overflow": scenario.neighbour_overflow != "error",
        "costs": bool(set(scenario.costs) - {"contact", "link_lost"}),
        "events": not scenario.events.none,
        "activation": not scenario.activation.synchronous,
        "reward": bool(scenario.reward.custom),
    }
    rejected |= dict.fromkeys(scenario.per_robot, True)
    shown = {"graph": graph.kind, "sensing": f"Sensing({sensing})"}
    for field, is_rejected in rejected.items():
        if is_rejected:
            raise_not_covered(field, shown.get(field) or short_repr(getattr(scenario, field)))
