"""Memory for B environments of a scenario: layout, allocation and size."""

import math
import os
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..obstacles import parsing
from ..obstacles.moving import moves
from ..obstacles.obstacle_set import ObstacleSet, pack, world_of
from ..scenario.scenario import Scenario
from ..sensors.effects import has_memory
from ..traffic.motion import STATE
from .memory import N_FIELDS, LaneBlock, ScalarBlock

_LINE = 64  # size of a cache line, bytes
_FEWEST_SIDE_BY_SIDE = 5
"""Minimum number of environments for blocks of 32 lanes; a processor handles four at a time."""
_SPARSE_FROM = 48
"""Number of robots from which a sequential list of links is faster than all pairs in lanes."""
_SPARSE_SHARE = 0.25  # fraction of all pairs above which the list is slower
_NEAR_CACHE = 2**20  # scratch memory that stays in the cache between stages, bytes
Floats = NDArray[np.float64]


class MemoryLayout:
    """Memory layout of ``batch`` environments of a scenario."""

    def __init__(self, scenario: Scenario, batch: int) -> None:
        self.scenario, self.batch = scenario, batch
        n, d, layout = scenario.n_robots, scenario.dim, scenario.observation_layout
        most = scenario.sensing_graph.most_links(n)
        self.one_way = not scenario.sensing_graph.undirected
        few = n >= _SPARSE_FROM and most <= _SPARSE_SHARE * n * (n - 1) / 2
        few = few and scenario.neighbour_overflow == "error"  # else each row belongs to one robot
        self.sparse = few and not self.one_way
        alone = self.sparse or self.one_way
        self.indexed = scenario.indexes_obstacles
        """True if obstacles have a spatial index."""
        self.width = (
            ScalarBlock() if alone or self.indexed or batch < _FEWEST_SIDE_BY_SIDE else LaneBlock()
        )
        self.lanes = self.width.lanes
        self.blocks = -(-batch // self.lanes)
        self.n_links = most if self.sparse else n * (n - 1) // 2
        self.neighbours = layout.neighbour_slots if alone else n - 1
        self.rows = self.neighbours + layout.rows - layout.neighbour_slots
        self.packed = self.sparse or layout.neighbour_slots != n - 1
        self.only_balls = parsing.only_balls(scenario.obstacles)
        self.moving = moves(scenario.obstacles)
        self.n_obstacles, self.points = scenario.obstacle_places, layout.rows_per_obstacle
        self.discs = self.n_obstacles if d == 2 and not self.indexed else 0
        self.fields = d + d * d + scenario.model.memory_size(d)
        """Numbers per robot: position, frame, memory."""
        self.moves = d + 1 + scenario.action_size
        self.direct = self.lanes == 1 and (alone or not self.packed)
        """True if sensing writes directly to the output: one lane and ordered rows."""
        read_again = not (self.direct and scenario.sensing.exact)
        together = self.lanes * n * (8 * self.moves + 4 * d * self.rows * read_again)
        self.group = min(self.blocks, max(1, _NEAR_CACHE // together))
        """Number of blocks that a stage processes before the next stage."""

    @property
    def sensor_memory(self) -> tuple[int, int, int]:
        """Sizes of sensor memory: detection, noise (two steps each), and held rows of a robot."""
        sensing, n = self.scenario.sensing, self.scenario.n_robots
        pairs, silhouettes = n * (n - 1), n * self.n_obstacles * self.points
        remembers = sensing.largest("persistence") > 0.0
        drifts = bool(has_memory(sensing, n).any())
        holds = sensing.largest("sample_period") > 0.0
        held = self.scenario.observation_layout.obstacles.stop * holds
        return pairs * remembers, (pairs + silhouettes) * drifts, held

    @property
    def nbytes(self) -> int:
        """Size of the arrays of robots, environments and discs, bytes."""
        n, lanes = self.scenario.n_robots, self.lanes
        numbers = n * self.fields + N_FIELDS + 3 * self.discs
        numbers += (STATE * self.n_obstacles + 3 * n) if self.moving else 0
        clocked, events = not self.scenario.activation.synchronous, self.scenario.events
        size = self.scenario.action_size
        own = 1 + clocked * (1 + size) + 4 * events.fails
        return 8 * (self.blocks * lanes * numbers + self.batch * n * own)


def aligned(*shape: int, kind: Any = np.float64) -> NDArray[Any]:
    """Allocate zeros aligned to a cache line, which NumPy does not guarantee.

    A vector of eight lanes across two lines would need two accesses.
    """
    size = math.prod(shape) * np.dtype(kind).itemsize
    memory = np.zeros(size + _LINE, np.uint8)
    start = -memory.ctypes.data % _LINE
    return memory[start : start + size].view(kind).reshape(shape)


class Scratch(NamedTuple):
    """Working memory of one thread."""

    moves: Floats
    """(group, n, (d + 1 + a)·L): displacement of each robot and the length of its path, m; and
    its action."""
    rows: NDArray[np.float32]
    """Observations, (group, n, rows, L·d), neighbours first; the d numbers of a lane are
    adjacent. Empty if sensing writes directly to the output."""
    pair: Floats  # ((d + 3)·L,), for ``sense_pairs``
    disc: Floats  # (6·L,), for ``sense_discs``
    keys: NDArray[np.uint64]  # (2, L), for ``apply_noise``
    words: NDArray[np.uint32]  # (3, 4, L), for ``apply_noise``
    vectors: Floats  # (3, n, d), of one environment, as are all below
    numbers: Floats  # (4, max(n, E, 4))
    listed: NDArray[np.int64]  # (2, max(n, E)), its links
    counts: NDArray[np.int64]  # (n,)
    flags: NDArray[np.bool_]  # (n,)
    normals: Floats  # (2M, 3), of the obstacles in contact
    silhouette: Floats  # (S, d), of one obstacle
    chains: NDArray[np.int64]  # (M, 2), for ``reachability``
    near: ObstacleSet | None  # (M,), obstacles near a robot, with a spatial index
    near_listed: NDArray[np.int64] | None  # (M,), their numbers
    near_distances: Floats | None  # (M,), m
    traffic: tuple[NDArray[Any], ...]  # for ``move_obstacles``; of no obstacles if none moves


def scratch(place: MemoryLayout) -> Scratch:
    """Allocate working memory of one thread."""
    n, d, lanes, slots = place.scenario.n_robots, place.scenario.dim, place.lanes, place.n_obstacles
    most = max(n, place.n_links, 4)
    near = None
    if place.indexed:
        table = pack((), slots, parsing.row_width(place.scenario.obstacles))
        near = world_of(table, place.only_balls)
    return Scratch(
        aligned(place.group, n, place.moves * lanes),
        aligned(0 if place.direct else place.group, n, place.rows, lanes * d, kind=np.float32),
        aligned((d + 3) * lanes),
        aligned(6 * lanes),
        aligned(2, lanes, kind=np.uint64),
        aligned(3, 4, lanes, kind=np.uint32),
        aligned(3, n, d),
        aligned(4, most),
        aligned(2, most, kind=np.int64),
        aligned(n, kind=np.int64),
        aligned(n, kind=np.bool_),
        aligned(2 * slots, 3),
        aligned(place.points, d),
        aligned(slots, 2, kind=np.int64),
        near,
        np.zeros(slots, np.int64) if near is not None else None,
        np.zeros(slots) if near is not None else None,
        _traffic_work(slots if place.moving else 0, n),
    )


def _traffic_work(slots: int, n: int) -> tuple[NDArray[Any], ...]:
    """Plans, normals, levels, halts, executed displacements and flags of ``move_obstacles``."""
    floats = aligned(slots, 4), aligned(2 * slots, 3), aligned(2 * slots)
    return (*floats, np.zeros((2, slots), np.bool_), aligned(n, 3), np.zeros((2, n), np.bool_))


_UNSEEN = 2**28  # bytes below which free memory is not queried, which takes longer than a step
_KEPT_OBSERVATIONS = 3  # those of this step and the previous one, and the caller's copy
_BOUNDS = 4  # arrays in a space: bounds and their finiteness


def needed_bytes(scenario: Scenario, num_envs: int) -> int:
    """Bytes of the state of B environments, its copy in a reset, observations and their spaces."""
    scenario = scenario.with_all_rows
    place, layout = MemoryLayout(scenario, num_envs), scenario.observation_layout
    n, delay = scenario.n_robots, scenario.delay_steps
    links = n * n if place.one_way else place.n_links * (3 if place.sparse else 1)
    per_obstacle = parsing.row_width(scenario.obstacles) + (5 if place.indexed else 0)
    obstacles = scenario.obstacle_places * per_obstacle
    tables = num_envs + place.indexed
    state = place.nbytes + 8 * (place.blocks * place.lanes * links + tables * obstacles)
    past = (delay + 1) * n * layout.obstacles.stop * layout.dim if delay else 0
    *kept_numbers, held = place.sensor_memory
    past += 2 * sum(kept_numbers) + n * held * layout.dim
    kept = num_envs * _KEPT_OBSERVATIONS + _BOUNDS
    return 2 * state + 4 * (n * layout.rows * layout.dim * kept + num_envs * past)


def check_memory(scenario: Scenario, num_envs: int) -> None:
    """Reject a batch that does not fit into memory; the error gives required and free memory."""
    needed = needed_bytes(scenario, num_envs)
    if needed > _UNSEEN and needed > (available := available_bytes()):
        raise ValueError(
            f"num_envs is {num_envs}: {num_envs} environments of {scenario.n_robots} robots with "
            f"{scenario.observation_layout.rows} rows each need {needed / 2**30:.3g} GiB of "
            f"memory, {available / 2**30:.3g} GiB are free; take fewer environments, robots or "
            "slots"
        )


def available_bytes() -> int:
    """Free memory, bytes: available memory of the system, or the limit of the control group."""
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
