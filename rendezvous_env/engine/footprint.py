"""How much memory a batch needs, and whether the machine has it: asked before it is taken."""

from __future__ import annotations

import os
from pathlib import Path

from ..experiment.packing import row_width
from ..experiment.scenario import Scenario
from .allocation import Arrangement
from .memory import STATISTICS

_UNSEEN = 2**28
"""Bytes that are never asked for: to look up what is free takes longer than a small team."""
_KEPT_OBSERVATIONS = 3
"""That exist at a time: what a step gives out, what the one before gave, and the caller's copy."""
_BOUNDS = 4
"""Arrays in a space: its bounds, and whether each is finite."""


def needed_bytes(scenario: Scenario, num_envs: int) -> int:
    """Bytes of the state of B teams, of a reset, of observations and of their spaces."""
    n, d, layout = scenario.n_robots, scenario.dim, scenario.observation_layout
    place = Arrangement(scenario, num_envs)
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
    return min(_system_bytes(), _group_bytes())


def _system_bytes() -> int:
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if "MemAvailable" in line)
    except (OSError, StopIteration, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return 2**40


def _group_bytes() -> int:
    try:
        return int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 2**63


def _gigabytes(count: int) -> str:
    return f"{count / 2**30:.3g} GiB"
