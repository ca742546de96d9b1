"""Memory for B teams of a scenario: empty state, and room for what threads are at work on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..experiment import packing
from ..experiment.scenario import Scenario
from .beginning.starts import Drafts
from .memory import (
    MIN_CLEARANCE,
    SCORED,
    SCORES,
    SQUARE_CLOSEST,
    STATISTICS,
    AtHand,
    Lanes,
    ManyTeams,
    OneTeam,
    Results,
    Teams,
)

_FLOAT32, _BOOL, _INT64 = np.dtype(np.float32), np.dtype(np.bool_), np.dtype(np.int64)
_FEWEST_SIDE_BY_SIDE = 5
"""Teams from which a block of 32 lanes pays; a processor does four of them at once."""
_SPARSE_FROM = 48
"""Robots from which a list of links is walked faster, one by one, than all pairs in lanes."""
_SPARSE_SHARE = 0.25
"""Share of all pairs above which it is not."""


class Arrangement:
    """How the teams of a scenario lie in memory, and how much of it they need.

    Args:
        scenario: the experiment.
        batch: B.
    """

    def __init__(self, scenario: Scenario, batch: int) -> None:
        self.scenario, self.batch = scenario, batch
        n = scenario.n_robots
        most = scenario.sensing_graph.most_links(n)
        self.one_way = not scenario.sensing_graph.undirected
        few = n >= _SPARSE_FROM and most <= _SPARSE_SHARE * n * (n - 1) / 2
        self.sparse = few and not self.one_way
        alone = self.sparse or self.one_way
        self.width = OneTeam() if alone or batch < _FEWEST_SIDE_BY_SIDE else ManyTeams()
        self.lanes = self.width.lanes
        self.blocks = -(-batch // self.lanes)
        self.n_links = most if self.sparse else n * (n - 1) // 2
        slots = scenario.observation_layout.neighbour_slots
        self.neighbours = slots if alone else n - 1
        self.packed = self.sparse or slots != n - 1
        self.observed = scenario.observation_layout.shape


def empty_teams(place: Arrangement) -> Teams:
    """State of teams that no reset has touched yet."""
    scenario, blocks, lanes = place.scenario, place.blocks, place.lanes
    n, d = scenario.n_robots, scenario.dim
    statistics = np.zeros((blocks, len(STATISTICS) * lanes))
    for entry in (MIN_CLEARANCE, SQUARE_CLOSEST):
        statistics[:, entry * lanes : (entry + 1) * lanes] = np.inf
    return Teams(
        positions=np.zeros((blocks, n, d * lanes)),
        frames=np.zeros((blocks, n, d * d * lanes)),
        memory=np.zeros((blocks, n, scenario.model.memory_size(d) * lanes)),
        merged_into=np.tile(np.arange(n), (place.batch, 1)),
        statistics=statistics,
    )


def empty_obstacles(place: Arrangement) -> Any:
    """Balls or Shapes with a leading axis B, all slots absent; None where there are no slots."""
    scenario = place.scenario
    slots = scenario.observation_layout.obstacle_slots
    if slots == 0:
        return None
    table = packing.pack((), slots, packing.row_width(scenario.obstacles))
    return packing.world_of(
        np.repeat(table[None], place.batch, axis=0), packing.only_balls(scenario.obstacles)
    )


def empty_past(place: Arrangement) -> NDArray[np.float32]:
    """What a sensor with a delay has seen, (B, delay + 1, n, K + M·S, d); of none without one."""
    layout, delay = place.scenario.observation_layout, place.scenario.sensing.delay
    shape = place.scenario.n_robots, layout.obstacles.stop, layout.dim
    return np.zeros((place.batch, delay + 1 if delay else 0, *shape), np.float32)


def lanes_of_threads(place: Arrangement, threads: int) -> Lanes:
    """Working memory for blocks, with a leading axis for the threads."""
    scenario, lanes = place.scenario, place.lanes
    n, d, size = scenario.n_robots, scenario.dim, scenario.action_size
    layout = scenario.observation_layout
    n_rows = n * (place.neighbours + layout.rows - layout.neighbour_slots)
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


def hands_of_threads(place: Arrangement, threads: int) -> AtHand:
    """Working memory for one team, with a leading axis for the threads."""
    scenario, links = place.scenario, place.n_links
    layout = scenario.observation_layout
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


def drafts(place: Arrangement, count: int) -> Drafts:
    """Room for the starts of ``count`` teams."""
    scenario, links = place.scenario, (count, place.n_links)
    return Drafts(
        positions=np.empty((count, scenario.n_robots, scenario.dim)),
        first=np.empty(links, np.int64),
        second=np.empty(links, np.int64),
        weights=np.empty(links),
        n_links=np.empty(count, np.int64),
        chains=np.empty((scenario.observation_layout.obstacle_slots, 2), np.int64),
    )


class Forms:
    """Room for what steps give out, in which nobody touches an obstacle and no robot has merged, as
    in most steps. Kernels write what is otherwise: flags fill less than a processor's nearest
    memory, and to fill them in one piece is quicker than block by block.

    Args:
        place: of the teams.
    """

    def __init__(self, place: Arrangement) -> None:
        batch, n, (rows, self._dim) = place.batch, place.scenario.n_robots, place.observed
        self._observations, self._scores = (batch, n * rows * self._dim), (SCORES, batch)
        self._numbers, self._robots = (batch,), (batch, n)
        self._everybody = np.ones((batch, n), np.bool_)  # to copy it is quicker than to fill
        self._crowded = np.full(batch, -1)

    def new(self) -> Results:
        """Fresh arrays, but for ``crowded``."""
        empty, robots, numbers = np.empty, self._robots, self._numbers
        observations = empty(self._observations, _FLOAT32)
        return Results(
            observations,
            whole_rows(observations, self._dim),
            empty(self._scores),
            np.zeros(robots, _BOOL),
            empty(robots),
            self._everybody.copy(),
            empty(numbers, _INT64),
            empty(robots),
            empty(numbers, _INT64),
            self._crowded,
        )


def whole_rows(rows: NDArray[np.float32], dim: int) -> NDArray[Any]:
    """The same memory, both numbers of a row of the plane in one piece: half as many to copy."""
    return rows.view(np.float64) if dim == 2 else rows


def _zeros(threads: int, *shape: int, kind: Any = np.float64) -> NDArray[Any]:
    return np.zeros((threads, *shape), dtype=kind)
