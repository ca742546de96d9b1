"""Kernel inputs of a scenario: constants, robot model, rules of initial conditions."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..graphs.random_graphs import GraphRules, graph_rules
from ..obstacles import obstacle_set
from ..obstacles.fields import Field, Rules
from ..obstacles.moving import (
    Traffic,
    max_speed,
    moves,
    moving_slots,
    traffic_of,
    walks,
)
from ..obstacles.obstacle_set import ObstacleSet
from ..obstacles.shape import ABSENT, KIND
from ..physics.random_streams import ignore_overflow
from ..rewards.terms import CLEARANCE_PENALTY
from ..robots.activation import ActivationRules
from ..robots.activation import rules_of as activation_rules
from ..robots.events import EventRules
from ..robots.events import rules_of as event_rules
from ..robots.mixed_team import mixed_limits
from ..robots.motion import init_memory
from ..robots.robot_models import constants_of, limits_of
from ..scenario.scenario import CONTACT_MODES, Scenario
from ..scenario.start_region import triangles_of
from ..sensors.effects import (
    Effects,
    Redraws,
    effects_of,
    memory_of_errors,
    redraws_of,
    samples_of,
)
from ..sensors.imperfections import imperfections_of
from .edge_tables import LinkList
from .memory import Robot
from .state import BatchState


class Constants(NamedTuple):
    """Constants of a scenario for stages, without its robot model."""

    duration: float
    merge_radius: float
    speed_limit: float
    max_steps: int
    contact_mode: int
    obstacle_range: float
    neighbour_slots: int
    reward_weights: tuple[float, ...]
    weighs_clearance: bool  # Whether the reward has a term of clearance
    all_earn: bool  # Whether merged robots receive the team reward, too
    body_radius: float  # Largest body radius, m
    body_radii: NDArray[np.float64]  # Of robots that occlude others, (n,), m
    packs: bool  # Whether bodies stop at contact, instead of merging
    merges_through: bool  # Whether robots merge through obstacles
    obstacle_reach: float  # Largest displacement of an obstacle in a step, m


class Sensor(NamedTuple):
    """Imperfect sensor."""

    errors: NDArray[np.float64]  # table of ``Imperfections``, a row for each robot
    listed: bool
    """True if the rows of a block are in the order of links, rather than of robots."""
    packed: bool
    """True if the rows of visible neighbours come first, rather than each in its own."""
    effects: Effects | None
    observer_bias: NDArray[np.float64]  # of each robot, (n,), rad
    redraws: Redraws  # of the memory of detection
    errors_kept: NDArray[np.float32]  # of the memory of noise, see ``memory_of_errors``
    samples: NDArray[np.float64]  # in a step, (1,) or (n,); 0 without a sample period
    delays: NDArray[np.int64]  # of each robot, (n,), steps


def robot(scenario: Scenario) -> Robot:
    """Robot model of a scenario; its constants are those of the largest limits."""
    d = scenario.dim
    return Robot(
        model=constants_of(scenario),
        inputs=tuple(range(scenario.action_size)),
        axes=tuple(range(d)),
        entries=tuple(range(d * d)),
        memories=tuple(range(scenario.model.memory_size(d))),
        limits=mixed_limits(scenario) if scenario.mixes_models else limits_of(scenario),
    )


def speed_limits_of(robot: Robot) -> NDArray[np.float64]:
    """Speed limit of each robot, (n,), or of all, (1,), m/s."""
    if robot.limits is None:
        return np.array([robot.model.speed_limit], np.float64)
    column = type(robot.model)._fields.index("speed_limit")
    return np.asarray(robot.limits[:, column])


def sensor(state: BatchState) -> Sensor | None:
    """Sensor of a scenario's robots; None if it is exact."""
    scenario, place = state.scenario, state.place
    sensing, tau, n = scenario.sensing, scenario.tau, scenario.n_robots
    errors = imperfections_of(sensing, n)
    if errors is None:
        return None
    in_order = place.neighbours == scenario.observation_layout.neighbour_slots
    return Sensor(
        errors=errors,
        listed=place.packed and in_order,
        packed=place.packed,
        effects=effects_of(sensing, n),
        observer_bias=sensing.each("observer_bias", n),
        redraws=redraws_of(sensing, n, tau),
        errors_kept=memory_of_errors(sensing, n, tau),
        samples=samples_of(sensing, n, tau),
        delays=sensing.delays(n, tau),
    )


def constants(scenario: Scenario, robot: Robot, max_steps: int) -> Constants:
    """Constants of a scenario."""
    weights, n = scenario.reward.built_in, scenario.n_robots
    given = np.array(scenario.body_radius or 0.5 * scenario.merge_radius, np.float64)
    radii = np.broadcast_to(given, (n,))
    return Constants(
        duration=float(scenario.tau),
        merge_radius=float(scenario.merge_radius),
        speed_limit=float(speed_limits_of(robot).max()),
        max_steps=max_steps,
        contact_mode=CONTACT_MODES.index(scenario.obstacle_contact),
        obstacle_range=float(scenario.obstacle_range),
        neighbour_slots=scenario.observation_layout.neighbour_slots,
        reward_weights=weights,
        weighs_clearance=weights[CLEARANCE_PENALTY] != 0.0,
        all_earn=scenario.on_merge == "follow",
        body_radius=float(radii.max()),
        body_radii=np.ascontiguousarray(radii),
        packs=scenario.meeting == "pack",
        merges_through=scenario.merges_through,
        obstacle_reach=max_speed(scenario.obstacles) * float(scenario.tau),
    )


def clocks(scenario: Scenario) -> ActivationRules | None:
    """Clocks of a scenario's robots; None if every robot is active in every step."""
    if scenario.activation.synchronous:
        return None
    return activation_rules(scenario.activation, scenario.hold, scenario.n_robots)


def events(scenario: Scenario) -> EventRules | None:
    """Failures and disturbances of a scenario's robots; None if there are none."""
    return None if scenario.events.none else event_rules(scenario)


class StartRules(NamedTuple):
    """Rules of initial conditions: sampled quantities and their ranges."""

    draw_positions: bool
    draw_frames: bool
    draw_memory: bool
    draw_weights: bool
    draw_obstacles: bool
    spawn_edges: tuple[float, float, float]  # m; the third is unused in the plane
    region: NDArray[np.float64] | None  # Triangles in which positions are sampled, or None
    least_distance: float
    keep_out: float
    factors: tuple[float, float] | None  # The range of factors of given arcs, or None
    reach: float | None
    """For changing links: length up to which links must connect the initial condition, m; inf
    without this requirement. All robots then keep their distance from each other. None: robots
    keep their distance from neighbours only."""
    graph: GraphRules | None  # None if no part of the graph is sampled
    field: Rules | None  # None if obstacles are not sampled


def start_rules(scenario: Scenario) -> StartRules:
    """Rules of an initial condition without given parts."""
    graph = scenario.sensing_graph
    field = scenario.obstacles if isinstance(scenario.obstacles, Field) else None
    if not scenario.observation_layout.obstacle_slots:
        field = None
    return StartRules(
        draw_positions=True,
        draw_frames=scenario.model.n_angles == 0 and scenario.local_frames == "random",
        draw_memory=True,
        draw_weights=True,
        draw_obstacles=field is not None,
        spawn_edges=_three_edges(*scenario.spawn_edges),
        region=None if scenario.start_region is None else triangles_of(scenario.start_region),
        least_distance=(1.0 if scenario.meeting == "pack" else 2.0) * scenario.merge_radius,
        keep_out=float(field.keep_out) if field else 0.0,
        graph=graph_rules(graph, scenario.n_robots),
        factors=_factors(scenario),
        reach=float(scenario.start_reach) if graph.changes else None,
        field=field.rules if field else None,
    )


def _three_edges(x: float, y: float, z: float = 0.0) -> tuple[float, float, float]:
    return x, y, z


def _factors(scenario: Scenario) -> tuple[float, float] | None:
    """Weight range of a directed graph; None if no weights are sampled initially."""
    graph = scenario.sensing_graph
    drawn = graph.directed and not graph.changes and graph.weight_range[0] < graph.weight_range[1]
    return graph.weight_range if drawn else None


def fixed_links(scenario: Scenario) -> LinkList | None:
    """Links of every episode; None if they are sampled or change.

    Those of a directed graph do not yet include sampled factors.
    """
    graph = scenario.sensing_graph
    if graph.changes or (_draws_links(scenario) and not graph.directed):
        return None
    first, second, weights = graph.links(scenario.n_robots)
    return first, second, weights if _factors(scenario) else weights * graph.weight_range[0]


def has_fixed_start(scenario: Scenario) -> bool:
    """True if all episodes are identical: positions, attitudes, graph and obstacles are given.

    Frames may be sampled: they rotate observations and actions alike.
    """
    if scenario.events.is_random or scenario.activation.kind == "random":
        return False
    rules, model = start_rules(scenario), scenario.model
    if walks(scenario.obstacles):
        return False
    if scenario.start_positions is None or _draws_links(scenario) or rules.draw_obstacles:
        return False
    given = 0 if scenario.start_headings is None else model.n_angles
    if model.memory_size(scenario.dim) == given:
        return True
    begin = ignore_overflow(init_memory)
    one, other = (begin(constants_of(scenario), np.uint64(key), 0) for key in (1, 2))
    return bool(one[given:] == other[given:])


def _draws_links(scenario: Scenario) -> bool:
    """True if any part of an episode's links is sampled."""
    graph = scenario.sensing_graph
    if not (graph.fixed or graph.changes):
        return True
    listed = getattr(graph, "graphs", (graph,))
    drawn = any(one.weight_range[0] < one.weight_range[1] for one in listed)
    return drawn or getattr(graph, "order", "cyclic") == "random"


def fixed_obstacles(scenario: Scenario) -> ObstacleSet | None:
    """The scenario's obstacles, leading axis 1; None if they are sampled, or have no slots."""
    slots = scenario.obstacle_places
    if isinstance(scenario.obstacles, Field) or slots == 0:
        return None
    table = obstacle_set.pack(scenario.obstacles, slots)
    world = obstacle_set.world_of(table[None], dim=scenario.dim)
    return world._replace(skins=_skins_of_still(scenario, table)[None])


def traffic(scenario: Scenario) -> Traffic | None:
    """Motion of a scenario's obstacles; None if all are still."""
    if not isinstance(scenario.obstacles, tuple) or not moves(scenario.obstacles):
        return None
    table = obstacle_set.pack(scenario.obstacles, scenario.observation_layout.obstacle_slots)
    pushes = scenario.obstacle_push == "push"
    return traffic_of(scenario.obstacles, table, _skins_of_still(scenario, table), pushes)


def _skins_of_still(scenario: Scenario, table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Skins of the obstacles of a table (M, width), (M,), m, without those that move."""
    still = table.copy()
    still[moving_slots(scenario.obstacles), KIND] = ABSENT
    return np.asarray(obstacle_set.world_of(still[None], dim=scenario.dim).skins[0])
