"""The state of B teams: arrays by team outside, lane blocks inside."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..graphs.edges import DenseEdges, Links
from ..obstacles import obstacle_set, parsing
from ..obstacles.obstacle_set import ObstacleSet
from . import edge_tables as link_tables
from .edge_tables import LinkList
from .memory import STATISTICS, Teams
from .memory_layout import MemoryLayout, empty_obstacles, empty_past, empty_teams

KEPT = {
    "status": np.int64,
    "steps": np.int64,
    "contacts": np.int64,
    "path_length": np.float64,
    "initial_lyapunov": np.float64,
    "min_clearance": np.float64,
}
"""What of a team's statistics belongs to its state, and as what; the rest follows."""


class Overwritten(NamedTuple):
    """One entry of the undo log of a reset."""

    array: NDArray[Any]
    index: Any
    before: Any


class State:
    """State of B teams of one scenario.

    Args:
        place: how they lie in memory.
    """

    def __init__(self, place: MemoryLayout) -> None:
        self.place, self.scenario, self.batch = place, place.scenario, place.batch
        self.teams: Teams = empty_teams(place)
        self.obstacles: Any = empty_obstacles(place)
        self.seed = np.zeros(place.batch, dtype=np.uint64)
        """(B,), of each team."""
        self.number = np.full(place.batch, -1)
        """(B,), of the team's episode, −1 before its first."""
        self.links: Links = link_tables.empty_links(place, self.seed, self.number)
        self.past = empty_past(place)
        """What a sensor with a delay has seen, see ``Sensor.past``."""
        self.lanes = place.lanes

    @property
    def nbytes(self) -> int:
        """Bytes of the state of all teams."""
        links = link_tables.arrays_of(self.links).values()
        own = (*self.teams, *links, *(self.obstacles or ()), self.past)
        return sum(array.nbytes for array in own)

    def parts(self) -> tuple[Any, ...]:
        """The fields of BatchState, those of Teams as a tuple."""
        changes = getattr(self.links, "changes", None)
        return tuple(self.teams), self.links, changes, self.obstacles

    # ---- reading ----------------------------------------------------------------------------

    def positions(self) -> NDArray[np.float64]:
        """Places as they stand in memory, (B, n, d), m."""
        return self._by_team(self.teams.positions)

    def frames(self) -> NDArray[np.float64]:
        """(B, n, d²), row by row."""
        return self._by_team(self.teams.frames)

    def memory(self) -> NDArray[np.float64]:
        """What the robot model keeps, (B, n, k)."""
        return self._by_team(self.teams.memory)

    def statistic(self, name: str) -> NDArray[np.float64]:
        """One of STATISTICS of every team, (B,), as a copy."""
        return self.teams.statistics[:, STATISTICS.index(name)].flatten()[: self.batch]

    def weights(self) -> NDArray[np.float64]:
        """a_ij, (B, n, n), m/s."""
        return link_tables.matrices(self.links, self.batch, self.scenario.n_robots)

    def obstacle_table(self) -> NDArray[np.float64]:
        """Obstacles as tables, (B, M, width), see ``obstacles.obstacle_set``."""
        if self.obstacles is None:
            width = parsing.row_width(self.scenario.obstacles)
            return np.zeros((self.batch, 0, width))
        return obstacle_set.table_of(self.obstacles)

    def _arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
        """What of the state lies in blocks, (blocks, …, L), and what by team, (B, …), by name."""
        teams = self.teams
        in_blocks: dict[str, NDArray[Any]] = {"positions": teams.positions, "memory": teams.memory}
        if self.scenario.model.n_angles == 0:
            in_blocks["frames"] = teams.frames
        by_team: dict[str, NDArray[Any]] = {"merged_into": teams.merged_into}
        if self.past.shape[1] > 1:
            by_team["past"] = self.past
        links = link_tables.arrays_of(self.links)
        (in_blocks if isinstance(self.links, DenseEdges) else by_team).update(links)
        return in_blocks, by_team

    def as_dict(self) -> dict[str, NDArray[Any]]:
        """All that is neither constant nor follows from the rest, as copies with leading axis B."""
        in_blocks, by_team = self._arrays()
        state = {name: self._by_team(array).copy() for name, array in in_blocks.items()}
        state |= {name: array.copy() for name, array in by_team.items()}
        kept = {name: self.statistic(name).astype(kind) for name, kind in KEPT.items()}
        return state | {"obstacles": self.obstacle_table().copy()} | kept

    # ---- writing ----------------------------------------------------------------------------

    def put(self, state: dict[str, NDArray[Any]]) -> None:
        """Put back what ``as_dict`` gave; unchecked."""
        in_blocks, by_team = self._arrays()
        for name, blocks in in_blocks.items():
            self._to_lanes(state[name], blocks)
        for name, array in by_team.items():
            array[...] = state[name]
        for name in KEPT:
            self._put_statistic(name, state[name])
        if self.obstacles is not None:
            given = obstacle_set.world_of(state["obstacles"])
            for array, numbers in zip(self.obstacles, given, strict=True):
                array[...] = numbers
        active = (self.teams.merged_into == np.arange(self.scenario.n_robots)).sum(axis=1)
        self._put_statistic("active", active)

    def give(
        self,
        name: str,
        values: NDArray[np.float64],
        which: NDArray[np.int64],
        log: list[Overwritten],
    ) -> None:
        """Write the given part of a start, (count or 1, n, numbers), of these teams."""
        index = (which // self.lanes, slice(None), slice(None), which % self.lanes)
        overwrite(getattr(self.teams, name), index, values, log)

    def as_kept(self, listed: Sequence[LinkList]) -> tuple[NDArray[Any], ...]:
        """Lists of links in the form in which they are kept, see ``link_tables``."""
        return link_tables.as_kept(self.links, listed, self.scenario.n_robots)

    def give_links(
        self, kept: tuple[NDArray[Any], ...], which: NDArray[np.int64], log: list[Overwritten]
    ) -> None:
        """Write links, of ``as_kept``: the same for all of these teams, or of each."""
        if isinstance(self.links, DenseEdges):
            index = (which // self.lanes, slice(None), which % self.lanes)
            overwrite(self.links.weights, index, kept[0], log)
        else:
            arrays = link_tables.arrays_of(self.links).values()
            for array, values in zip(arrays, kept, strict=True):
                overwrite(array, which, values, log)

    def give_obstacles(
        self, world: ObstacleSet, which: NDArray[np.int64], log: list[Overwritten]
    ) -> None:
        """Write obstacles: the same for all of these teams, or of each."""
        for array, numbers in zip(self.obstacles, world, strict=True):
            overwrite(array, which, numbers, log)

    def _put_statistic(self, name: str, values: NDArray[Any]) -> None:
        team = np.arange(self.batch)
        table = self.teams.statistics[:, STATISTICS.index(name)]
        table[team // self.lanes, team % self.lanes] = values

    def _by_team(self, blocks: NDArray[np.float64]) -> NDArray[np.float64]:
        """Numbers of each team from blocks, (blocks, …, L) → (B, …)."""
        by_team = np.moveaxis(blocks, -1, 1)
        return by_team.reshape(len(blocks) * self.lanes, *by_team.shape[2:])[: self.batch]

    def _to_lanes(self, values: NDArray[np.float64], blocks: NDArray[np.float64]) -> None:
        """Write (B, …) into blocks, (blocks, …, L)."""
        team = np.arange(len(values))
        np.moveaxis(blocks, -1, 1)[team // self.lanes, team % self.lanes] = values


def overwrite(array: NDArray[Any], index: Any, values: ArrayLike, log: list[Overwritten]) -> None:
    """Write into the state, and add what was there to the log; the index has a list or array of
    teams in it, so that what it reads is a copy.
    """
    log.append(Overwritten(array, index, array[index]))
    array[index] = values


def undo(log: list[Overwritten]) -> None:
    """Put back all that was overwritten."""
    for array, index, before in reversed(log):
        array[index] = before
