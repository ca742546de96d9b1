"""Memory for B teams of a scenario: empty state, and room for what threads are at work on."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..obstacles import obstacle_set, parsing
from ..obstacles.parsing import row_width
from ..outcome import SCORES, StepOutput
from ..scenario.scenario import Scenario
from .memory import STATISTICS, BlockScratch, ManyTeams, OneTeam, Tally, Teams, TeamScratch
from .reset.starts import SampledStarts

_FLOAT32, _BOOL, _INT64 = np.dtype(np.float32), np.dtype(np.bool_), np.dtype(np.int64)
_LINE = 64
"""Bytes of a cache line."""
_FEWEST_SIDE_BY_SIDE = 5
"""Teams from which a block of 32 lanes pays; a processor does four of them at once."""
_SPARSE_FROM = 48
"""Robots from which a list of links is walked faster, one by one, than all pairs in lanes."""
_SPARSE_SHARE = 0.25
"""Share of all pairs above which it is not."""


class MemoryLayout:
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


def empty_teams(place: MemoryLayout) -> Teams:
    """State of teams that no reset has touched yet."""
    scenario, blocks, lanes = place.scenario, place.blocks, place.lanes
    n, d = scenario.n_robots, scenario.dim
    statistics = _zeros(blocks, len(STATISTICS), lanes)
    for entry in ("min_clearance", "square_closest"):
        statistics[:, STATISTICS.index(entry)] = np.inf
    return Teams(
        positions=_zeros(blocks, n, d, lanes),
        frames=_zeros(blocks, n, d * d, lanes),
        memory=_zeros(blocks, n, scenario.model.memory_size(d), lanes),
        merged_into=np.tile(np.arange(n), (place.batch, 1)),
        statistics=statistics,
    )


def empty_obstacles(place: MemoryLayout) -> Any:
    """An ObstacleSet with a leading axis B, all slots absent; None where there are no slots."""
    scenario = place.scenario
    slots = scenario.observation_layout.obstacle_slots
    if slots == 0:
        return None
    table = obstacle_set.pack((), slots, parsing.row_width(scenario.obstacles))
    return obstacle_set.world_of(
        np.repeat(table[None], place.batch, axis=0), parsing.only_balls(scenario.obstacles)
    )


def empty_past(place: MemoryLayout) -> NDArray[np.float32]:
    """What a sensor with a delay has seen, (B, delay + 1, n, K + M·S, d); of none without one."""
    layout, delay = place.scenario.observation_layout, place.scenario.sensing.delay
    shape = place.scenario.n_robots, layout.obstacles.stop, layout.dim
    return np.zeros((place.batch, delay + 1 if delay else 0, *shape), np.float32)


def scratch(place: MemoryLayout) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Working memory of one thread: the fields of BlockScratch and of TeamScratch."""
    return tuple(_block_scratch(place)), tuple(_team_scratch(place))


def _block_scratch(place: MemoryLayout) -> BlockScratch:
    scenario, lanes = place.scenario, place.lanes
    n, d, layout = scenario.n_robots, scenario.dim, scenario.observation_layout
    slots = layout.obstacle_slots
    n_rows = place.neighbours + layout.rows - layout.neighbour_slots
    rows = _zeros(n, n_rows, lanes * d, kind=np.float32)
    return BlockScratch(
        action=_zeros(n, scenario.action_size, lanes),
        displacement=_zeros(n, d + 1, lanes),
        tally=_zeros(len(Tally._fields), lanes),
        took_part=_zeros(lanes, n, kind=np.bool_),
        pair=_zeros(d + 4, lanes),
        rows=rows,
        whole_rows=whole_rows(rows, d).reshape(n * n_rows, -1),
        centres=_zeros(slots, d, lanes),
        bounds=np.full((slots, lanes), np.nan),
        radii=np.full((slots, lanes), np.nan),
        disc=_zeros(3, 2, lanes),
        keys=_zeros(2, lanes, kind=np.uint64),
        words=_zeros(3, 4, lanes, kind=np.uint32),
    )


def _team_scratch(place: MemoryLayout) -> TeamScratch:
    scenario, links = place.scenario, place.n_links
    layout = scenario.observation_layout
    n, d = scenario.n_robots, scenario.dim
    return TeamScratch(
        positions=_zeros(n, d),
        displacements=_zeros(n, d),
        here=_zeros(n, d),
        lengths=_zeros(n),
        resting=_zeros(n, kind=np.bool_),
        first=_zeros(links, kind=np.int64),
        second=_zeros(links, kind=np.int64),
        weights=_zeros(links),
        moments=_zeros(links),
        counts=_zeros(n, kind=np.int64),
        normals=_zeros(2 * layout.obstacle_slots, 3),
        silhouette=_zeros(layout.silhouette_points, d),
        report=_zeros(4),
    )


def sampled_starts(place: MemoryLayout, count: int) -> SampledStarts:
    """Room for the starts of ``count`` teams."""
    scenario, links = place.scenario, (count, place.n_links)
    return SampledStarts(
        positions=np.empty((count, scenario.n_robots, scenario.dim)),
        first=np.empty(links, np.int64),
        second=np.empty(links, np.int64),
        weights=np.empty(links),
        n_links=np.empty(count, np.int64),
        chains=np.empty((scenario.observation_layout.obstacle_slots, 2), np.int64),
    )


class OutputBuffers:
    """Room for what steps give out, in which nobody touches an obstacle and no robot has merged, as
    in most steps. Kernels write what is otherwise: flags fill less than a processor's nearest
    memory, and to fill them in one piece is quicker than block by block.

    Args:
        place: of the teams.
    """

    def __init__(self, place: MemoryLayout) -> None:
        batch, n = place.batch, place.scenario.n_robots
        rows, d = place.observed
        self._dim = d
        self._observed, self._whole = (batch, n, rows, d), (batch, n * rows * (1 if d == 2 else d))
        self._scores, self._numbers, self._robots = (SCORES, batch), (batch,), (batch, n)
        self._everybody = np.ones((batch, n), np.bool_)  # to copy it is quicker than to fill
        self._crowded = np.full(batch, -1)

    def new(self) -> StepOutput:
        """Fresh arrays, but for ``crowded``."""
        empty, robots, numbers = np.empty, self._robots, self._numbers
        observations = empty(self._observed, _FLOAT32)
        return StepOutput(
            observations,
            whole_rows(observations, self._dim).reshape(self._whole),
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


def _zeros(*shape: int, kind: Any = np.float64) -> NDArray[Any]:
    """Zeros that begin with a cache line, as numpy's seldom do: each vector of eight lanes fills a
    whole line, and one that lay across two would be read and written as two.
    """
    size = math.prod(shape) * np.dtype(kind).itemsize
    memory = np.zeros(size + _LINE, np.uint8)
    start = -memory.ctypes.data % _LINE
    return memory[start : start + size].view(kind).reshape(shape)


# ---- how much there is --------------------------------------------------------------------------

_UNSEEN = 2**28
"""Bytes that are never asked for: to look up what is free takes longer than a small team."""
_KEPT_OBSERVATIONS = 3
"""That exist at a time: what a step gives out, what the one before gave, and the caller's copy."""
_BOUNDS = 4
"""Arrays in a space: its bounds, and whether each is finite."""


def needed_bytes(scenario: Scenario, num_envs: int) -> int:
    """Bytes of the state of B teams, of a reset, of observations and of their spaces."""
    n, d, layout = scenario.n_robots, scenario.dim, scenario.observation_layout
    place = MemoryLayout(scenario, num_envs)
    obstacles = layout.obstacle_slots * row_width(scenario.obstacles)
    links = n * n if place.one_way else place.n_links * (3 if place.sparse else 1)
    in_lanes = n * (d + d * d + scenario.model.memory_size(d)) + links + len(STATISTICS)
    drawn = n * d + 3 * place.n_links + obstacles
    observed = n * layout.rows * d
    delay = scenario.sensing.delay
    past = (delay + 1) * n * layout.obstacles.stop * d if delay else 0
    state = place.blocks * place.lanes * in_lanes + num_envs * (obstacles + n + drawn)
    kept = num_envs * _KEPT_OBSERVATIONS + _BOUNDS
    return 8 * state + 4 * (observed * kept + num_envs * past)


def check_memory(scenario: Scenario, num_envs: int) -> None:
    """Refuse a batch that does not fit into memory.

    Raises:
        ValueError: saying how much it needs and how much there is.
    """
    needed = needed_bytes(scenario, num_envs)
    if needed > _UNSEEN and needed > (available := available_bytes()):
        raise ValueError(
            f"num_envs is {num_envs}: {num_envs} teams of {scenario.n_robots} robots with "
            f"{scenario.observation_layout.rows} rows each need {_gigabytes(needed)} of memory, "
            f"{_gigabytes(available)} are free; take fewer teams, robots or slots"
        )


def available_bytes() -> int:
    """Free memory: what the system calls available, or the limit of our group if that is less."""
    found = 2**40
    with suppress(AttributeError, OSError, ValueError):
        found = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, StopIteration, ValueError, IndexError):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        found = next(int(line.split()[1]) * 1024 for line in lines if "MemAvailable" in line)
    with suppress(OSError, ValueError):
        group = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")
        found = min(found, int(group))
    return found


def _gigabytes(count: int) -> str:
    return f"{count / 2**30:.3g} GiB"
