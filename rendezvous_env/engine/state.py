"""State of B environments: arrays by environment for callers, lane blocks internally."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..graphs.edges import DENSE
from ..obstacles import obstacle_set, parsing, spatial_index
from ..obstacles.disc import BALL
from ..obstacles.obstacle_set import ObstacleSet
from ..obstacles.shape import BOUND, MIDDLE
from ..robots.events import NEVER
from ..traffic.motion import STATE
from .edge_tables import changes_of, empty_links, matrices, state_arrays
from .memory import (
    EPISODE_FIELDS,
    INITIAL_LYAPUNOV,
    LYAPUNOV,
    N_FIELDS,
    RUNNING,
    SENSED_LYAPUNOV,
)
from .memory_layout import MemoryLayout, aligned
from .stages.commands import find_conditions

KEPT = {
    "status": np.int64,
    "steps": np.int64,
    "contacts": np.int64,
    "path_length": np.float64,
    "initial_lyapunov": np.float64,
    "min_clearance": np.float64,
}
"""Statistics that belong to the state, with their types; the others are derived."""


_FAILURES = ("crashed", "crash"), ("adversarial", "adversary"), ("blind", "blind")
"""Infos key and kind of the events of robots."""


class BatchState:
    """State of B environments of one scenario."""

    def __init__(self, place: MemoryLayout) -> None:
        self.place, self.scenario, self.batch = place, place.scenario, place.batch
        self.lanes, n, d = place.lanes, self.scenario.n_robots, self.scenario.dim
        self.robots = aligned(place.blocks, n, place.fields * self.lanes)
        """Position, frame and memory of every robot, see ``memory``; a merged robot keeps those of
        its merge."""
        self.environments = aligned(place.blocks, N_FIELDS * self.lanes)
        self.merged_into = np.zeros((place.batch, n), np.int64)
        """(B, n), robot that each one has become part of; itself while active."""
        self.merged_into[:] = np.arange(n)
        self.discs = aligned(place.blocks, place.discs, 3 * self.lanes)
        """Obstacles that are discs in 2-D, see ``sense_obstacles.sense_discs``."""
        self.discs[:] = np.nan
        table = obstacle_set.pack((), place.n_obstacles, parsing.row_width(self.scenario.obstacles))
        shared, slots = int(place.indexed), place.n_obstacles
        tables = np.repeat(table[None], self.batch + shared, axis=0)
        self.tables = obstacle_set.world_of(tables, place.only_balls)
        """Obstacles of each environment; with an index, also those of the scenario, last."""
        own: Any = slice(self.batch)
        self.obstacles = type(self.tables)(*(array[own] for array in self.tables))
        """Obstacles, with a leading axis B; empty without slots."""
        self.index = self._empty_index(len(tables), slots) if place.indexed else None
        """Spatial index of the tables of many obstacles, or None."""
        self.seed = np.zeros(place.batch, dtype=np.uint64)
        """Seed of each environment, (B,)."""
        self.number = np.full(place.batch, -1)
        """Episode number of each environment, (B,), −1 before its first."""
        self.links, self.changes = empty_links(place), changes_of(self.scenario)
        rows, delay = self.scenario.observation_layout, self.scenario.delay_steps
        seen = delay + 1 if delay else 0, n, rows.obstacles.stop, rows.dim
        self.past = np.zeros((place.batch, *seen), np.float32)
        """Observations buffered by a delayed sensor; empty without a delay."""
        detected, erring, held = place.sensor_memory
        shape = place.blocks, 2
        self.detection = aligned(*shape, detected, self.lanes, kind=np.float32)
        """Memories of detection and of noise, see ``stages.remember``; empty without one."""
        self.errors = aligned(*shape, erring, self.lanes, kind=np.float32)
        moving = place.moving
        self.traffic = np.zeros((place.batch, place.n_obstacles if moving else 0, STATE))
        """State of moving obstacles, see ``traffic.motion``; empty without them."""
        self.arrivals = np.full((place.batch, n if moving else 0, 3), np.nan)
        """Positions after a step of robots beside moving obstacles, m; of the current step."""
        self.held = np.zeros((place.batch, n if held else 0, held, rows.dim), np.float32)
        """Observations held between samples; none without a sample period."""
        self.still_skins: Any = 0.0
        """Skins in a scenario with moving obstacles, (M,), m; those of still ones."""
        clocked = place.batch, 0 if self.scenario.activation.synchronous else n
        self.commands = np.zeros((*clocked, self.scenario.action_size), np.float32)
        """Current commands, see ``stages.commands``; empty if robots are synchronous, as the next
        two."""
        bounded = self.scenario.activation.kind == "bounded"
        self.last_activation = aligned(place.blocks * bounded, n, self.lanes, kind=np.int64)
        """Step of each robot's last activation, −1 before the first; none without an adversary."""
        self.last_activation[:] = -1
        self.activated = np.zeros(clocked, np.bool_)
        """Robots that were active in the last step."""
        events = self.scenario.events
        self.faults = np.full((place.batch, 4, n if events.fails else 0), NEVER)
        """Steps of failures, see ``robots.events``; empty without failures."""
        opposed = bounded or "adversary" in events.kinds
        self.nets = aligned(place.blocks * opposed, n, self.lanes * d, kind=np.float32)
        """f_i of every robot, see ``stages.commands.sum_bearings``; none without adversaries."""
        self.has_conditions = self.activated.size + self.faults.size > 0
        """True if ``conditions`` are not empty."""
        self._all = np.arange(place.batch)
        fields = self.robots.reshape(place.blocks, n, place.fields, self.lanes)
        self._fields = self.environments.reshape(place.blocks, N_FIELDS, self.lanes)
        for entry in ("min_clearance", "clearance", "square_closest"):
            self._fields[:, EPISODE_FIELDS.index(entry)] = np.inf
        links = state_arrays(self.links, n)
        in_blocks = {
            "positions": fields[:, :, :d],
            "frames": fields[:, :, d : d + d * d],
            "memory": fields[:, :, d + d * d :],
            "environments": self._fields,
            "discs": self.discs.reshape(place.blocks, place.discs, 3, self.lanes),
            "detection": self.detection,
            "errors": self.errors,
            "last_activation": self.last_activation,
        }
        self._arrays: dict[str, NDArray[Any]] = {**in_blocks, "merged_into": self.merged_into}
        self._arrays |= {**links, "seed": self.seed, "episode": self.number, "past": self.past}
        self._arrays["held"] = self.held
        self._arrays["traffic"] = self.traffic
        self._arrays |= {"commands": self.commands, "faults": self.faults.transpose(0, 2, 1)}
        self._arrays |= self.obstacles._asdict()
        self._arrays |= {} if self.index is None else self.index._asdict()
        self._in_blocks = set(in_blocks)
        """Arrays in blocks, (blocks, …, L); others are (B, …)."""
        if self.links.form == DENSE:
            self._in_blocks.add("weights")
        self._kept = ["positions", "memory", "merged_into", *links, "seed", "episode"]
        """Arrays that are neither constant nor derived."""
        self._kept += ["frames"] if self.scenario.model.n_angles == 0 else []
        self._kept += ["traffic"] if place.moving else []
        of_sensors = "past", "detection", "errors", "held"
        own = *of_sensors, "commands", "last_activation", "faults"
        self._kept += [name for name in own if self._arrays[name].size]
        # the first observation of an episode initialises sensor memory
        begun = {name: array for name, array in self._arrays.items() if name not in of_sensors}
        self._begun_anew = [name for name, array in begun.items() if array.size]

    @property
    def nbytes(self) -> int:
        """Size of the state of all environments, bytes."""
        return sum(array.nbytes for array in self._arrays.values())

    def of_teams(self, name: str) -> NDArray[Any]:
        """Copy of an array of all environments, (B, …)."""
        return self._copies([name], self._all)[name]

    def give(self, which: NDArray[np.int64], **arrays: NDArray[Any]) -> None:
        """Write arrays of these environments, (count or 1, …)."""
        places = self._places(which) if arrays else ()
        for name, values in arrays.items():
            self._arrays[name][places[name in self._in_blocks]] = values

    def copy_of(self, which: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """Copy of everything that a reset of these environments may change, for ``give``."""
        return self._copies(self._begun_anew, which)

    def _copies(self, names: Iterable[str], which: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        places = self._places(which)
        return {name: self._arrays[name][places[name in self._in_blocks]] for name in names}

    def _places(self, which: NDArray[np.int64]) -> tuple[Any, Any]:
        """Indices of these environments in arrays (B, …), and in those of blocks."""
        block, lane = np.divmod(which, self.lanes)
        return which, (block, ..., lane)

    def statistic(self, name: str) -> NDArray[np.float64]:
        """Copy of one of EPISODE_FIELDS of every environment, (B,)."""
        return self._fields[:, EPISODE_FIELDS.index(name)].flatten()[: self.batch]

    def weights(self) -> NDArray[np.float64]:
        """Weights a_ij, (B, n, n), m/s."""
        return matrices(self.links, self.batch, self.scenario.n_robots)

    def obstacle_table(self) -> NDArray[np.float64]:
        """Obstacles as tables, (B, M, width), see ``obstacles.obstacle_set``."""
        return obstacle_set.table_of(self.obstacles)

    def _empty_index(self, tables: int, slots: int) -> spatial_index.SpatialIndex:
        """Index of tables without obstacles; all environments use the last."""
        own = spatial_index.empty(tables, slots)
        return own._replace(source=np.full(self.batch, tables - 1))

    def share(self, world: ObstacleSet | None) -> dict[str, NDArray[Any]]:
        """Set the obstacles of the scenario, leading axis 1; returns their arrays for ``give``.

        None for a scenario without fixed obstacles.
        """
        if world is None or self.index is None:
            return {} if world is None else world._asdict()
        index = spatial_index.index_of(world)
        for table, given in zip((*self.tables, *self.index[1:]), (*world, *index[1:]), strict=True):
            table[-1] = given[0]
        return {**world._asdict(), "source": np.array(self.batch)}

    def with_index(
        self, world: ObstacleSet | None, which: NDArray[np.int64]
    ) -> dict[str, NDArray[Any]]:
        """Arrays of obstacles of environments, (count or 1, …), for ``give``; {} for None."""
        if world is None or self.index is None:
            return {} if world is None else world._asdict()
        kept = [self._are_shared(world, b) for b in range(len(world.kinds))]
        source = np.where(kept, self.batch, which)
        index = {} if all(kept) else spatial_index.index_of(world)._asdict()
        return {**world._asdict(), **index, "source": source}

    def _are_shared(self, world: ObstacleSet, b: int) -> bool:
        """True if these are the obstacles of the scenario."""
        pairs = zip(world, self.tables, strict=True)
        return all(np.array_equal(given[b], table[-1]) for given, table in pairs)

    def conditions(self) -> dict[str, NDArray[np.bool_]]:
        """Condition of robots in the last step, (B, n) each, by infos key."""
        if not self.has_conditions:
            return {}
        found = {"activated": self.activated.copy()} if self.activated.size else {}
        if self.faults.size:
            kinds, (batch, n) = self.scenario.events.kinds, self.merged_into.shape
            marks = [np.zeros((batch, n * (kind in kinds)), np.bool_) for _, kind in _FAILURES]
            given = self.statistic("steps"), self.merged_into, self.faults
            find_conditions(*given, *marks)
            named = zip(_FAILURES, marks, strict=True)
            found |= {key: array for (key, kind), array in named if kind in kinds}
        return found

    def lay_out_discs(self, which: NDArray[np.int64]) -> None:
        """Copy the discs of some environments into their lanes; a radius of NaN marks no disc."""
        if self.discs.size:
            block, lane = np.divmod(which, self.lanes)
            shapes, is_disc = self.obstacles.shapes[which], self.obstacles.kinds[which] == BALL
            discs = self._arrays["discs"]
            discs[block, :, :2, lane] = shapes[..., MIDDLE : MIDDLE + 2]
            discs[block, :, 2, lane] = np.where(is_disc, shapes[..., BOUND], np.nan)

    def begin(self, which: NDArray[np.int64], status: int) -> None:
        """Initialise the statistics of episodes with known positions and links.

        The initial V is −1, unknown, until the first observation. It is 0 for environments that are
        observed in a step.
        """
        n = self.scenario.n_robots
        known = {"status": status, "active": n, "initial_lyapunov": -float(status == RUNNING)}
        far = dict.fromkeys(("min_clearance", "clearance", "square_closest"), np.inf)
        fields = np.zeros(N_FIELDS)
        for name, value in {**known, **far}.items():
            fields[EPISODE_FIELDS.index(name)] = value
        self.give(which, environments=fields[None], merged_into=np.arange(n))
        if self.commands.size:
            self.commands[which], self.activated[which] = 0.0, False
        if self.last_activation.size:
            self.give(which, last_activation=np.array(-1))

    def settle(self) -> None:
        """Set V of all environments from an observation without a step."""
        initial, now = self._fields[:, INITIAL_LYAPUNOV], self._fields[:, SENSED_LYAPUNOV]
        self._fields[:, LYAPUNOV] = now
        np.copyto(initial, now, where=initial < 0.0)

    def as_dict(self) -> dict[str, NDArray[Any]]:
        """Copies of everything that is neither constant nor derived, with leading axis B."""
        state = self._copies(self._kept, self._all)
        state |= {name: self.statistic(name).astype(kind) for name, kind in KEPT.items()}
        return state | {"obstacles": self.obstacle_table().copy()}

    def put(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore the result of ``as_dict``, without validation."""
        self.give(self._all, **{name: state[name] for name in self._kept})
        active = (self.merged_into == np.arange(self.scenario.n_robots)).sum(axis=1)
        block, _, lane = self._places(self._all)[1]
        for name, values in {**{name: state[name] for name in KEPT}, "active": active}.items():
            self._fields[block, EPISODE_FIELDS.index(name), lane] = values
        world = obstacle_set.world_of(state["obstacles"], dim=self.scenario.dim)
        self.give(self._all, **self.with_index(world, self._all))
        if self.place.moving:
            self.obstacles.skins[...] = self.still_skins
        self.lay_out_discs(self._all)
