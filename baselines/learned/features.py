"""Features of learned policies, computed from observations and memory.

They are expressed in the frame with x along f, so a policy that reads them is invariant to
rotations.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from rendezvous_env.engine.state_checks import (
    StatefulMixin,
    check_mask,
    check_numbers,
    check_observations,
)
from rendezvous_env.engine.threads import Calls, Slice
from rendezvous_env.safety.safety_filter import over_teams
from rendezvous_env.safety.turning import robot_of
from rendezvous_env.scenario.scenario import Scenario

from ..policy import Float32, Mask
from ..records import Array, Records
from ..steering import check_steerable
from .feature_kernels import (
    CONTEXT_COLUMNS,
    LEVEL_COLUMNS,
    MEMORY,
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    WALLS,
    show,
)

VERSION = 2  # of the columns' meaning; a network uses the version of its training
_WEIGHT = 8  # cost of a robot's features, relative to its filter


class FeatureParts(NamedTuple):
    """Features of one robot by set; each part is a view, and absent rows are zero."""

    neighbours: Any  # (..., K, NEIGHBOUR_COLUMNS)
    obstacles: Any  # (..., M, OBSTACLE_COLUMNS)
    context: Any  # (..., CONTEXT_COLUMNS and those of a tank)


class FeatureLayout(NamedTuple):
    """Layout of a flat feature row."""

    neighbour_slots: int  # K
    obstacle_slots: int  # M
    tank_columns: int = 0  # context columns with a tank

    @property
    def context_columns(self) -> int:
        """Number of columns that belong to no set."""
        return CONTEXT_COLUMNS + self.tank_columns

    @property
    def size(self) -> int:
        """Number of features of each robot."""
        sets = self.neighbour_slots * NEIGHBOUR_COLUMNS + self.obstacle_slots * OBSTACLE_COLUMNS
        return sets + self.context_columns

    def split(self, shown: Any) -> FeatureParts:
        """Split an array or tensor (..., size) into its parts."""
        leading, K, M = shown.shape[:-1], self.neighbour_slots, self.obstacle_slots
        stop, context = K * NEIGHBOUR_COLUMNS, shown.shape[-1] - self.context_columns
        return FeatureParts(
            shown[..., :stop].reshape(*leading, K, NEIGHBOUR_COLUMNS),
            shown[..., stop:context].reshape(*leading, M, OBSTACLE_COLUMNS),
            shown[..., context:],
        )


class Features(StatefulMixin):
    """Features of B environments of n robots, computed once per decision.

    Args:
        scenario: defines the sensors; 3-D robots observe planes (``OdometryPlane``).
        num_envs: B.
        decision_time: default time between two decisions of an environment, s.
        obstacle_slots: M; rows beyond those of the scenario are absent. None uses the scenario's.
        tank_columns: 0, LEVEL_COLUMNS, or LEVEL_COLUMNS + WALL_COLUMNS with a memory of walls.
        num_threads: maximum number of threads; None is one per core.

    Raises:
        ValueError: for an unsupported robot model, or too few obstacle slots.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        decision_time: float,
        obstacle_slots: int | None = None,
        tank_columns: int = 0,
        num_threads: int | None = None,
    ) -> None:
        check_steerable(scenario)
        rows = replace(scenario.observation_layout, dim=2, senses_gravity=False)
        slots = rows.obstacle_slots if obstacle_slots is None else obstacle_slots
        if slots < rows.obstacle_slots:
            raise ValueError(
                f"obstacle_slots is {slots}; scenario {scenario.name!r} needs "
                f"{rows.obstacle_slots} or more"
            )
        self.layout = FeatureLayout(rows.neighbour_slots, slots, tank_columns)
        self._rows, self._decision_time = rows, float(decision_time)
        self._known = robot_of(scenario), self.layout.size - self.layout.context_columns
        robots = num_envs, scenario.n_robots
        self._edges = np.zeros((*robots, rows.obstacle_slots, 2, 2))
        self._records = Records(robots, MEMORY)
        self._walls = Records(robots, WALLS if tank_columns > LEVEL_COLUMNS else {})
        self._num_threads = num_threads

    @property
    def _memory(self) -> dict[str, Array]:
        walls = {f"wall_{name}": array for name, array in self._walls.views.items()}
        return {"edges": self._edges, **self._records.views, **walls}

    def _begin(self, which: Any) -> None:
        for array in (self._edges, self._records.array, self._walls.array):
            array[which] = 0.0

    def see(
        self,
        observations: Float32,
        headings: Array,
        which: Mask | None = None,
        *,
        velocities: Array | None = None,
        levels: Array | None = None,
        elapsed: Array | None = None,
        shown: Float32 | None = None,
    ) -> Float32:
        """Compute features (B, n, layout.size) and update the memory.

        Args:
            observations: (B, n, rows, 2), in the robots' own frames.
            headings: carried headings, (B, n, 2), in the same frames; zero where undefined.
            which: (B,), the environments whose memory is updated; None is all.
            velocities: velocities of the robots, (B, n, 2), m/s; None is those of law (4).
            levels: stored energies A/(r D̄), (B, n); None without tanks.
            elapsed: time since the previous decision, (B,), s; None is ``decision_time``.
            shown: output array, returned, with rows of other environments unchanged; None is zeros.

        Raises:
            ValueError: for arrays of another shape or type; the state is then unchanged.
        """
        robots, slots = self._records.array.shape[:2], self._rows.obstacle_slots
        observations = check_observations(observations, (*robots, *self._rows.shape))
        headings = check_numbers("headings", headings, (*robots, 2), "(B, n, 2)")
        teams = np.arange(len(observations))
        if which is not None:
            teams = np.flatnonzero(check_mask(which, len(observations)))
        nothing = np.empty((*robots, 0))
        moving = headings, nothing if velocities is None else np.ascontiguousarray(velocities)
        times = np.full(robots[0], self._decision_time)
        if elapsed is not None:
            times[:] = check_numbers("elapsed", elapsed, robots[:1], "(B,)")
        if shown is None:
            shown = np.zeros((*robots, self.layout.size), dtype=np.float32)
        seen = observations, np.ascontiguousarray(observations).view(np.int64)
        given = (teams, times), seen, moving, self._known
        tanks = nothing if levels is None else levels[..., np.newaxis], self._walls.array
        weight = _WEIGHT * robots[1]

        def calls_of(part: Slice) -> Calls:
            room = np.empty((slots, 2)), np.empty(slots + 1, np.int64)
            memory = self._edges, self._records.array, room
            return [partial(show, part, *given, memory, tanks, shown)]

        over_teams(calls_of, len(teams), weight, self._num_threads)
        return shown

    @property
    def remembers_angles(self) -> bool:
        """True if chosen angles are part of the memory."""
        return self._walls.array.size > 0

    def note(self, angles: Array) -> None:
        """Store the chosen angles (B, n), rad, if they are part of the memory."""
        if self.remembers_angles:
            self._walls.views["angle"][...] = angles
