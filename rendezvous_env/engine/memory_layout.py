"""Memory for B teams of a scenario: how it is laid out, allocated, and how much there is."""

import math
import os
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np

from ..obstacles import parsing
from ..scenario.scenario import Scenario
from .memory import STATISTICS, BlockScratch, ManyTeams, OneTeam, Tally, Teams, TeamScratch

_LINE = 64  # Bytes of a cache line
_FEWEST_SIDE_BY_SIDE = 5
"""Teams from which a block of 32 lanes pays; a processor does four of them at once."""
_SPARSE_FROM = 48
"""Robots from which a list of links is walked faster, one by one, than all pairs in lanes."""
_SPARSE_SHARE = 0.25  # Share of all pairs above which it is not
Arrays = TypeVar("Arrays", bound=tuple[Any, ...])


class MemoryLayout:
    """How ``batch`` teams of a scenario lie in memory."""

    def __init__(self, scenario: Scenario, batch: int) -> None:
        self.scenario, self.batch = scenario, batch
        n, d, layout = scenario.n_robots, scenario.dim, scenario.observation_layout
        most = scenario.sensing_graph.most_links(n)
        self.one_way = not scenario.sensing_graph.undirected
        few = n >= _SPARSE_FROM and most <= _SPARSE_SHARE * n * (n - 1) / 2
        few = few and scenario.neighbour_overflow == "error"  # else each row is to be of one robot
        self.sparse = few and not self.one_way
        alone = self.sparse or self.one_way
        self.width = OneTeam() if alone or batch < _FEWEST_SIDE_BY_SIDE else ManyTeams()
        self.lanes = self.width.lanes
        self.blocks = -(-batch // self.lanes)
        self.n_links = most if self.sparse else n * (n - 1) // 2
        self.neighbours = layout.neighbour_slots if alone else n - 1
        self.rows = self.neighbours + layout.rows - layout.neighbour_slots
        self.packed = self.sparse or layout.neighbour_slots != n - 1
        memory, slots = scenario.model.memory_size(d), layout.obstacle_slots
        self.sizes = {
            **{"B": batch, "blocks": self.blocks, "L": self.lanes, "L·d": self.lanes * d},
            **{"n": n, "a": scenario.action_size, "k": memory, "rows": self.rows},
            **{"d": d, "d+1": d + 1, "d+3": d + 3, "d²": d * d},
            **{"M": slots, "2M": 2 * slots, "discs": slots if d == 2 else 0},
            **{"S": layout.silhouette_points, "E": self.n_links},
            **{"statistics": len(STATISTICS), "tally": len(Tally._fields)},
        }
        """Lengths of the axes that annotations of arrays name."""


def _described(
    kind: type[tuple[Any, ...]], sizes: dict[str, int]
) -> list[tuple[tuple[int, ...], np.dtype[Any]]]:
    """Shape and type of each array of a tuple, as the annotations of its class say."""
    found = []
    for annotation in kind.__annotations__.values():
        array, axes = get_args(annotation)
        (number,) = get_args(get_args(array)[1])
        shape = tuple(sizes[axis] if axis in sizes else int(axis) for axis in axes.split())
        found.append((shape, np.dtype(number)))
    return found


def allocate(kind: type[Arrays], sizes: dict[str, int]) -> Arrays:
    """A tuple of arrays of zeros, see ``MemoryLayout.sizes``.

    Each begins with a cache line, as numpy's seldom do: a vector of eight lanes that lay across two
    lines would be read and written as two.
    """
    arrays = []
    for shape, number in _described(kind, sizes):
        size = math.prod(shape) * number.itemsize
        memory = np.zeros(size + _LINE, np.uint8)
        start = -memory.ctypes.data % _LINE
        arrays.append(memory[start : start + size].view(number).reshape(shape))
    return kind(*arrays)


def scratch(place: MemoryLayout) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Working memory of one thread: the fields of Scratch as plain tuples."""
    block, team = (allocate(kind, place.sizes) for kind in (BlockScratch, TeamScratch))
    return tuple(block), tuple(team)


_UNSEEN = 2**28  # Bytes up to which nobody looks up what is free, which takes longer than a step
_KEPT_OBSERVATIONS = 3  # At a time: this step's, the one's before, and the caller's copy
_BOUNDS = 4  # Arrays in a space: its bounds, and whether each is finite


def needed_bytes(scenario: Scenario, num_envs: int) -> int:
    """Bytes of the state of B teams and its copy in a reset, of observations and their spaces."""
    scenario = scenario.with_all_rows
    place, layout = MemoryLayout(scenario, num_envs), scenario.observation_layout
    n, delay = scenario.n_robots, scenario.sensing.delay
    described = _described(Teams, place.sizes)
    teams = sum(math.prod(shape) * number.itemsize for shape, number in described)
    links = n * n if place.one_way else place.n_links * (3 if place.sparse else 1)
    obstacles = layout.obstacle_slots * parsing.row_width(scenario.obstacles)
    state = teams + 8 * (place.blocks * place.lanes * links + num_envs * obstacles)
    past = (delay + 1) * n * layout.obstacles.stop * layout.dim if delay else 0
    kept = num_envs * _KEPT_OBSERVATIONS + _BOUNDS
    return 2 * state + 4 * (n * layout.rows * layout.dim * kept + num_envs * past)


def check_memory(scenario: Scenario, num_envs: int) -> None:
    """Refuse a batch that does not fit into memory, saying how much it needs and there is."""
    needed = needed_bytes(scenario, num_envs)
    if needed > _UNSEEN and needed > (available := available_bytes()):
        raise ValueError(
            f"num_envs is {num_envs}: {num_envs} teams of {scenario.n_robots} robots with "
            f"{scenario.observation_layout.rows} rows each need {needed / 2**30:.3g} GiB of "
            f"memory, {available / 2**30:.3g} GiB are free; take fewer teams, robots or slots"
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
