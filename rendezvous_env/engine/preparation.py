"""From a scenario to what the kernels work on: empty state, constants, working memory, rules."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..equations.motion import is_described
from ..experiment import packing
from ..experiment.checks import shown
from ..experiment.graphs import FIXED
from ..experiment.obstacles import Field
from ..experiment.scenario import CONTACT_MODES, Scenario
from .draw_graph import GraphRules
from .field_rules import field_rules
from .memory import (
    MIN_CLEARANCE,
    SCORED,
    SCORES,
    SQUARE_CLOSEST,
    STATISTICS,
    AtHand,
    Constants,
    Lanes,
    Layout,
    Links,
    ListedLinks,
    ManyTeams,
    OneTeam,
    PairLinks,
    Robot,
    Teams,
)
from .starts import Drafts, StartRules

_FEWEST_SIDE_BY_SIDE = 5
"""Teams from which a block of 32 lanes pays; a processor does four of them at once."""
_SPARSE_FROM = 48
"""Robots from which a list of links is walked faster, one by one, than all pairs in lanes."""
_SPARSE_SHARE = 0.25
"""Share of all pairs above which it is not."""


class Arrangement:
    """How the teams of a scenario lie in memory.

    Args:
        scenario: the experiment.
        batch: B.
    """

    def __init__(self, scenario: Scenario, batch: int) -> None:
        n = scenario.n_robots
        most = scenario.sensing_graph.most_links(n)
        self.sparse = n >= _SPARSE_FROM and most <= _SPARSE_SHARE * n * (n - 1) / 2
        self.width = OneTeam() if self.sparse or batch < _FEWEST_SIDE_BY_SIDE else ManyTeams()
        self.lanes = self.width.lanes
        self.blocks = -(-batch // self.lanes)
        self.n_links = most if self.sparse else n * (n - 1) // 2


def empty_teams(scenario: Scenario, batch: int) -> Teams:
    """State of teams that no reset has touched yet."""
    place = Arrangement(scenario, batch)
    n, d, blocks, lanes = scenario.n_robots, scenario.dim, place.blocks, place.lanes
    statistics = np.zeros((blocks, len(STATISTICS) * lanes))
    for entry in (MIN_CLEARANCE, SQUARE_CLOSEST):
        statistics[:, entry * lanes : (entry + 1) * lanes] = np.inf
    return Teams(
        positions=np.zeros((blocks, n, d * lanes)),
        frames=np.zeros((blocks, n, d * d * lanes)),
        memory=np.zeros((blocks, n, scenario.model.memory_size(d) * lanes)),
        merged_into=np.tile(np.arange(n), (batch, 1)),
        statistics=statistics,
    )


def empty_links(scenario: Scenario, batch: int) -> Links:
    """Links that no reset has touched yet: those of all pairs weigh 0, a list has none."""
    place = Arrangement(scenario, batch)
    if place.sparse:
        size = (batch, place.n_links)
        return ListedLinks(np.zeros(size, np.int64), np.zeros(size, np.int64), np.zeros(size))
    first, second = (pairs.astype(np.int64) for pairs in np.triu_indices(scenario.n_robots, 1))
    return PairLinks(first, second, np.zeros((place.blocks, place.n_links, place.lanes)))


def empty_obstacles(scenario: Scenario, batch: int) -> Any:
    """Balls or Shapes with a leading axis B, all slots absent; None where there are no slots."""
    slots = scenario.observation_layout.obstacle_slots
    if slots == 0:
        return None
    table = packing.pack((), slots, packing.row_width(scenario.obstacles))
    return packing.world_of(
        np.repeat(table[None], batch, axis=0), packing.only_balls(scenario.obstacles)
    )


def layout(scenario: Scenario, batch: int) -> Layout:
    """How the numbers of these teams lie in memory."""
    d = scenario.dim
    return Layout(Arrangement(scenario, batch).width, tuple(range(d)), tuple(range(d * d)))


def robot(scenario: Scenario) -> Robot:
    """The robot model of a scenario."""
    return Robot(
        model=constants_of(scenario),
        inputs=tuple(range(scenario.action_size)),
        memories=tuple(range(scenario.model.memory_size(scenario.dim))),
    )


def constants(scenario: Scenario, max_steps: int) -> tuple[Any, ...]:
    """The fields of Constants, as a plain tuple."""
    reward = scenario.reward
    found = Constants(
        duration=float(scenario.tau),
        merge_radius=float(scenario.merge_radius),
        speed_limit=float(constants_of(scenario).speed_limit),
        max_steps=max_steps,
        contact_mode=CONTACT_MODES.index(scenario.obstacle_contact),
        obstacle_range=float(scenario.obstacle_range),
        neighbour_slots=scenario.observation_layout.neighbour_slots,
        rows=scenario.observation_layout.rows,
        reward_weights=(
            reward.progress,
            reward.time_penalty,
            reward.collision_penalty,
            reward.rendezvous_bonus,
            reward.clearance_penalty,
        ),
        all_earn=scenario.on_merge == "follow",
    )
    return tuple(found)


def constants_of(scenario: Scenario) -> Any:
    """The constants that the equations of the scenario's robot model take.

    Raises:
        ValueError: if they are not what the step needs.
    """
    model = scenario.model.constants(scenario)
    who = f"the constants of robot model {scenario.robot_model!r}"
    if not is_described(type(model)):
        raise ValueError(
            f"{who} are a {type(model).__name__}; describe_motion must have said how that moves"
        )
    for field, least in (("duration", scenario.tau), ("speed_limit", 0.0)):
        value = getattr(model, field, None)
        if not isinstance(value, float) or not least <= value < np.inf:
            wanted = f"the step, {least:g} s" if field == "duration" else "a float of 0 m/s or more"
            raise ValueError(f"{who} have {field} = {shown(value)}; it must be {wanted}")
    return model


def _zeros(threads: int, *shape: int, kind: Any = np.float64) -> NDArray[Any]:
    return np.zeros((threads, *shape), dtype=kind)


def lanes_of_threads(scenario: Scenario, batch: int, threads: int) -> Lanes:
    """Working memory for blocks, with a leading axis for the threads."""
    place, layout = Arrangement(scenario, batch), scenario.observation_layout
    n, d, size, lanes = scenario.n_robots, scenario.dim, scenario.action_size, place.lanes
    neighbours = layout.neighbour_slots if place.sparse else n - 1
    n_rows = n * (neighbours + layout.rows - layout.neighbour_slots)
    action = _zeros(threads, n, size * lanes)
    rows = _zeros(threads, n_rows, d * lanes, kind=np.float32)
    balls = _zeros(threads, layout.obstacle_slots, (d + 2) * lanes)
    balls[:] = np.nan
    return Lanes(
        action=action,
        taken=action.reshape(threads, n * size, lanes),
        displacement=_zeros(threads, n, (d + 1) * lanes),
        tally=_zeros(threads, (SCORED + SCORES) * lanes),
        took_part=_zeros(threads, lanes, n, kind=np.bool_),
        pair=_zeros(threads, (4 + d) * lanes),
        rows=rows,
        whole_rows=whole_rows(rows, d),
        balls=balls,
        disc=_zeros(threads, 8 * lanes),
    )


def whole_rows(rows: NDArray[np.float32], dim: int) -> NDArray[Any]:
    """The same memory, both numbers of a row of the plane in one piece: half as many to copy."""
    return rows.view(np.float64) if dim == 2 else rows


def hands_of_threads(scenario: Scenario, batch: int, threads: int) -> AtHand:
    """Working memory for one team, with a leading axis for the threads."""
    layout, links = scenario.observation_layout, Arrangement(scenario, batch).n_links
    n, d = scenario.n_robots, scenario.dim
    return AtHand(
        positions=_zeros(threads, n, d),
        displacements=_zeros(threads, n, d),
        here=_zeros(threads, n, d),
        lengths=_zeros(threads, n),
        resting=_zeros(threads, n, kind=np.bool_),
        first=_zeros(threads, links, kind=np.int64),
        second=_zeros(threads, links, kind=np.int64),
        weights=_zeros(threads, links),
        moments=_zeros(threads, links),
        counts=_zeros(threads, n, kind=np.int64),
        normals=_zeros(threads, 2 * layout.obstacle_slots, 3),
        silhouette=_zeros(threads, layout.silhouette_points, d),
        report=_zeros(threads, 4),
    )


def drafts(scenario: Scenario, batch: int, count: int) -> Drafts:
    """Room for the starts of ``count`` teams."""
    links = (count, Arrangement(scenario, batch).n_links)
    return Drafts(
        positions=np.empty((count, scenario.n_robots, scenario.dim)),
        first=np.empty(links, np.int64),
        second=np.empty(links, np.int64),
        weights=np.empty(links),
        n_links=np.empty(count, np.int64),
        chains=np.empty((scenario.observation_layout.obstacle_slots, 2), np.int64),
    )


def start_rules(scenario: Scenario) -> StartRules:
    """The rules of a start of which nothing is given."""
    field = scenario.obstacles if scenario.observation_layout.obstacle_slots else ()
    is_field = isinstance(field, Field)
    fixed_frame = scenario.model.n_angles == 0
    return StartRules(
        draw_positions=True,
        draw_frames=fixed_frame and scenario.local_frames == "random",
        draw_memory=True,
        draw_weights=True,
        draw_obstacles=is_field,
        spawn_size=float(scenario.spawn_size),
        least_distance=2.0 * scenario.merge_radius,
        keep_out=float(field.keep_out) if isinstance(field, Field) else 0.0,
        graph=_graph_rules(scenario),
        field=field_rules(field) if isinstance(field, Field) else None,
    )


def _graph_rules(scenario: Scenario) -> GraphRules | None:
    """None where every episode has the same links."""
    graph = scenario.sensing_graph
    low, high = graph.weight_range
    if graph.topology == FIXED and low == high:
        return None
    fixed = graph.topology == FIXED
    first, second, weights = graph.links(scenario.n_robots) if fixed else _NO_LINKS
    return GraphRules(
        topology=graph.topology,
        probability=float(graph.probability),
        weight_range=(low, high),
        first=first,
        second=second,
        weights=weights,
    )


_NO_LINKS = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))


def fixed_links(
    scenario: Scenario,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]] | None:
    """The links of every episode: robots (E,), (E,), weights (E,), m/s; None if they are drawn."""
    if _graph_rules(scenario) is not None:
        return None
    first, second, weights = scenario.sensing_graph.links(scenario.n_robots)
    return first, second, weights * scenario.sensing_graph.weight_range[0]


def fixed_obstacles(scenario: Scenario) -> NDArray[np.float64] | None:
    """The table of the scenario's obstacles, (1, M, width); None if they are drawn."""
    if isinstance(scenario.obstacles, Field):
        return None
    return packing.pack(scenario.obstacles, scenario.observation_layout.obstacle_slots)[None]
