"""The state of B teams: arrays by team outside, lane blocks inside."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..graphs.edges import DenseEdges, EdgeList
from ..obstacles import obstacle_set, parsing
from .edge_tables import empty_links, matrices
from .memory import STATISTICS, Teams
from .memory_layout import MemoryLayout, allocate

KEPT = {
    "status": np.int64,
    "steps": np.int64,
    "contacts": np.int64,
    "path_length": np.float64,
    "initial_lyapunov": np.float64,
    "min_clearance": np.float64,
}
"""What of a team's statistics belongs to its state, and as what; the rest follows."""


class State:
    """State of B teams of one scenario."""

    def __init__(self, place: MemoryLayout) -> None:
        self.place, self.scenario, self.batch = place, place.scenario, place.batch
        self.lanes = place.lanes
        self.teams = allocate(Teams, place.sizes)
        self.teams.merged_into[:] = np.arange(self.scenario.n_robots)
        self.teams.discs[:] = np.nan
        for entry in ("min_clearance", "clearance", "square_closest"):
            self.teams.statistics[:, STATISTICS.index(entry)] = np.inf
        self.obstacles = self._no_obstacles()
        """With a leading axis B; None where there are no slots."""
        self.seed = np.zeros(place.batch, dtype=np.uint64)
        """(B,), of each team."""
        self.number = np.full(place.batch, -1)
        """(B,), of the team's episode, −1 before its first."""
        self.links = empty_links(place, self.seed, self.number)
        rows, delay = self.scenario.observation_layout, self.scenario.sensing.delay
        seen = delay + 1 if delay else 0, self.scenario.n_robots, rows.obstacles.stop, rows.dim
        self.past = np.zeros((place.batch, *seen), np.float32)
        """What a sensor with a delay has seen, see ``Sensor.past``; of none without one."""
        self._everybody = np.arange(place.batch)
        names = EdgeList._fields if isinstance(self.links, EdgeList) else ("weights",)
        links = {name: getattr(self.links, name) for name in names}
        own = {"seed": self.seed, "episode": self.number, "past": self.past}
        world = {} if self.obstacles is None else self.obstacles._asdict()
        self._arrays: dict[str, NDArray[Any]] = {**self.teams._asdict(), **links, **own, **world}
        self._in_blocks = {"positions", "frames", "memory", "statistics", "discs"}
        """Of these arrays those that lie in blocks, (blocks, …, L); others by team, (B, …)."""
        if isinstance(self.links, DenseEdges):
            self._in_blocks.add("weights")
        self._told = ["positions", "memory", "merged_into", *links, "seed", "episode"]
        """Of these arrays those that neither are constant nor follow from the rest."""
        self._told += ["frames"] if self.scenario.model.n_angles == 0 else []
        self._told += ["past"] if delay else []
        self._begun_anew = [k for k, array in self._arrays.items() if k != "past" and array.size]

    def _no_obstacles(self) -> Any:
        obstacles, slots = self.scenario.obstacles, self.place.sizes["M"]
        if slots == 0:
            return None
        table = obstacle_set.pack((), slots, parsing.row_width(obstacles))
        tables = np.repeat(table[None], self.batch, axis=0)
        return obstacle_set.world_of(tables, parsing.only_balls(obstacles))

    @property
    def nbytes(self) -> int:
        """Bytes of the state of all teams."""
        return sum(array.nbytes for array in self._arrays.values())

    def parts(self) -> tuple[Any, ...]:
        """The fields of BatchState, those of Teams as a tuple."""
        changes = getattr(self.links, "changes", None)
        return tuple(self.teams), self.links, changes, self.obstacles

    def of_teams(self, name: str) -> NDArray[Any]:
        """An array of all teams, (B, …), as a copy."""
        return self._copies([name], self._everybody)[name]

    def give(self, which: NDArray[np.int64], **arrays: NDArray[Any]) -> None:
        """Write arrays of these teams, (count or 1, …)."""
        places = self._places(which) if arrays else ()
        for name, values in arrays.items():
            self._arrays[name][places[name in self._in_blocks]] = values

    def copy_of(self, which: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """All that a reset of these teams may change, for ``give``."""
        return self._copies(self._begun_anew, which)

    def _copies(self, names: Iterable[str], which: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        places = self._places(which)
        return {name: self._arrays[name][places[name in self._in_blocks]] for name in names}

    def _places(self, which: NDArray[np.int64]) -> tuple[Any, Any]:
        """Where these teams stand in arrays (B, …), and in those of blocks."""
        block, lane = np.divmod(which, self.lanes)
        return which, (block, ..., lane)

    def statistic(self, name: str) -> NDArray[np.float64]:
        """One of STATISTICS of every team, (B,), as a copy."""
        return self.teams.statistics[:, STATISTICS.index(name)].flatten()[: self.batch]

    def weights(self) -> NDArray[np.float64]:
        """a_ij, (B, n, n), m/s."""
        return matrices(self.links, self.batch, self.scenario.n_robots)

    def obstacle_table(self) -> NDArray[np.float64]:
        """Obstacles as tables, (B, M, width), see ``obstacles.obstacle_set``."""
        if self.obstacles is None:
            return np.zeros((self.batch, 0, parsing.row_width(self.scenario.obstacles)))
        return obstacle_set.table_of(self.obstacles)

    def as_dict(self) -> dict[str, NDArray[Any]]:
        """All that is neither constant nor follows from the rest, as copies with leading axis B."""
        state = self._copies(self._told, self._everybody)
        state |= {name: self.statistic(name).astype(kind) for name, kind in KEPT.items()}
        return state | {"obstacles": self.obstacle_table().copy()}

    def put(self, state: dict[str, NDArray[Any]]) -> None:
        """Put back what ``as_dict`` gave; unchecked."""
        self.give(self._everybody, **{name: state[name] for name in self._told})
        active = (self.teams.merged_into == np.arange(self.scenario.n_robots)).sum(axis=1)
        block, _, lane = self._places(self._everybody)[1]
        for name, values in {**{name: state[name] for name in KEPT}, "active": active}.items():
            self.teams.statistics[block, STATISTICS.index(name), lane] = values
        if self.obstacles is not None:
            world = obstacle_set.world_of(state["obstacles"], dim=self.scenario.dim)
            for array, numbers in zip(self.obstacles, world, strict=True):
                array[...] = numbers
