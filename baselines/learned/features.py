"""Features that a learned policy is shown: tables made from the robot's own observations, and what
it remembers.

Nothing here knows a position or a distance. The tables are in the frame with x along f, so a policy
that reads them does not notice how the world is turned.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.engine.state_checks import (
    check_entries,
    check_finite,
    check_mask,
    check_numbers,
    check_observations,
)
from rendezvous_env.scenario.scenario import Scenario

from ..policy import in_the_plane
from .feature_kernels import (
    CONTEXT_COLUMNS,
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    Constants,
    Memory,
    law_velocities,
    show,
)
from .wall_memory import WallMemory

VERSION = 2
"""Of what the columns mean; a network trained with another one cannot read the tables."""
BLOCKED = slice(16, 18)
"""Of the context: whether the joined silhouettes leave nothing free, whether any is seen."""
LEVEL_COLUMNS = 1
"""After the context, with a tank: log(1 + A/(r D̄)). With a memory of walls WALL_COLUMNS follow."""


class FeatureParts(NamedTuple):
    """What one robot is shown, taken apart; every part is a view."""

    neighbours: Any
    """(..., K, NEIGHBOUR_COLUMNS); zero rows are absent."""
    obstacles: Any
    """(..., M, OBSTACLE_COLUMNS); zero rows are absent."""
    context: Any
    """(..., CONTEXT_COLUMNS and what a tank adds)."""


class FeatureLayout(NamedTuple):
    """Which part of a flat row of numbers is what. Nobody else counts columns."""

    neighbour_slots: int
    """K."""
    obstacle_slots: int
    """M."""
    tank_columns: int = 0
    """What a tank adds to the context."""

    @property
    def context_columns(self) -> int:
        """Numbers that belong to no set."""
        return CONTEXT_COLUMNS + self.tank_columns

    @property
    def size(self) -> int:
        """Numbers for each robot."""
        sets = self.neighbour_slots * NEIGHBOUR_COLUMNS + self.obstacle_slots * OBSTACLE_COLUMNS
        return sets + self.context_columns

    def split(self, shown: Any) -> FeatureParts:
        """Take (..., size) apart, an array or a tensor."""
        leading, K, M = shown.shape[:-1], self.neighbour_slots, self.obstacle_slots
        stop, context = K * NEIGHBOUR_COLUMNS, shown.shape[-1] - self.context_columns
        return FeatureParts(
            shown[..., :stop].reshape(*leading, K, NEIGHBOUR_COLUMNS),
            shown[..., stop:context].reshape(*leading, M, OBSTACLE_COLUMNS),
            shown[..., context:],
        )


can_steer = in_the_plane
"""Of a scenario: whether a learned policy can steer its robots, single integrators in the plane."""


def check_readable(scenario: Scenario) -> None:
    """Refuse robots that a learned policy cannot steer.

    Raises:
        ValueError: unless they are single integrators in the plane.
    """
    if not can_steer(scenario):
        raise ValueError(
            f"scenario {scenario.name!r} has {scenario.robot_model} robots in {scenario.dim}-D; "
            "learned policies steer single_integrator robots in 2-D"
        )


class Features:
    """Shows B teams of n robots to a network, once for each decision.

    Args:
        scenario: whose robots see.
        num_envs: B.
        decision_time: s between two decisions of a team, where nothing else is said.
        obstacle_slots: M, at least the scenario's; further rows are absent. None is the scenario's.
        tank_columns: 0, LEVEL_COLUMNS, or LEVEL_COLUMNS + WALL_COLUMNS with a memory of walls.

    Raises:
        ValueError: for robots that it cannot show, or too few obstacle slots.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        decision_time: float,
        obstacle_slots: int | None = None,
        tank_columns: int = 0,
    ) -> None:
        check_readable(scenario)
        rows = scenario.observation_layout
        slots = rows.obstacle_slots if obstacle_slots is None else obstacle_slots
        if slots < rows.obstacle_slots:
            raise ValueError(
                f"obstacle_slots is {slots}; scenario {scenario.name!r} needs "
                f"{rows.obstacle_slots} or more"
            )
        self.layout = FeatureLayout(rows.neighbour_slots, slots, tank_columns)
        self._rows, self._decision_time = rows, float(decision_time)
        self._constants = Constants(
            neighbour_slots=rows.neighbour_slots,
            context=self.layout.size - self.layout.context_columns,
            merge_radius=float(scenario.merge_radius),
            duration=float(scenario.tau),
            speed_limit=float(scenario.speed_limit),
        )
        robots = num_envs, scenario.n_robots
        self._memory = Memory(
            edges=np.zeros((*robots, rows.obstacle_slots, 2, 2)),
            towards=np.zeros((*robots, 2)),
            averages=np.zeros((*robots, 4, 2)),
            time=np.zeros(robots),
        )
        self._walls = WallMemory(*robots) if tank_columns > LEVEL_COLUMNS else None
        self._remembered: dict[str, NDArray[np.float64]] = self._memory._asdict()
        if self._walls is not None:
            walls = self._walls.arrays.items()
            self._remembered |= {f"wall_{name}": array for name, array in walls}

    def see(
        self,
        observations: NDArray[np.float32],
        headings: NDArray[np.float64],
        which: NDArray[np.bool_] | None = None,
        *,
        velocities: NDArray[np.float64] | None = None,
        levels: NDArray[np.float64] | None = None,
        elapsed: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float32]:
        """What the robots are shown; brings the memory up to date.

        Args:
            observations: (B, n, rows, 2), in the robots' own frames.
            headings: those carried, (B, n, 2), in the same frames; zero where there is none.
            which: (B,), whose memory moves on; the others are shown as zeros. None is all teams.
            velocities: of the robots, (B, n, 2), m/s; None is those of law (4).
            levels: A/(r D̄) of their tanks, (B, n); None without.
            elapsed: since the decision before, (B,), s; None is ``decision_time``.

        Returns:
            (B, n, layout.size); zeros for a robot without neighbours.

        Raises:
            ValueError: for arrays of another shape or type; nothing has changed then.
        """
        robots = self._memory.time.shape
        observations = check_observations(observations, (*robots, *self._rows.shape))
        headings = check_numbers("headings", headings, (*robots, 2), "(B, n, 2)")
        teams = np.arange(len(observations))
        if which is not None:
            teams = np.flatnonzero(check_mask(which, len(observations)))
        if velocities is None:
            velocities = np.empty_like(headings)
            law_velocities(observations, headings, self._constants, velocities)
        times = np.full(robots[0], self._decision_time)
        if elapsed is not None:
            times[:] = check_numbers("elapsed", elapsed, robots[:1], "(B,)")
        shown = np.zeros((*robots, self.layout.size), dtype=np.float32)
        moving = headings, np.ascontiguousarray(velocities)
        show(teams, times, observations, *moving, self._constants, self._memory, shown)
        if levels is None:
            return shown
        context = self.layout.split(shown).context
        alive, more = np.asarray(shown.any(axis=-1)), [np.log1p(levels)]
        if self._walls is not None:
            blocked = np.asarray(context[..., BLOCKED].any(axis=-1))
            f = self._rows.net_bearing(observations)
            more += self._walls.see(alive, times, blocked, more[0], f, headings, velocities)
        context[..., CONTEXT_COLUMNS:] = np.stack(more, axis=-1) * alive[..., np.newaxis]
        return shown

    def note(self, angles: NDArray[np.float64]) -> None:
        """Remember the angles (B, n) that were chosen, rad."""
        if self._walls is not None:
            self._walls.arrays["angle"][...] = angles

    def forget(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget what all teams saw, or those of a mask (B,).

        Raises:
            ValueError: for a bad mask; nothing has changed then.
        """
        which = slice(None) if mask is None else check_mask(mask, len(self._memory.time))
        for array in self._remembered.values():
            array[which] = 0.0

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """The memory, as copies."""
        return {name: array.copy() for name, array in self._remembered.items()}

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """Put back what ``get_state`` took out.

        Raises:
            ValueError: naming what does not fit, see ``check_state``; nothing has changed then.
        """
        checked = self.check_state(state)
        for name, array in self._remembered.items():
            array[...] = checked[name]

    def check_state(self, state: Any) -> dict[str, NDArray[Any]]:
        """The arrays of a state that ``set_state`` would put back.

        Raises:
            ValueError: naming an entry that is missing, of another shape or not finite.
        """
        checked = check_entries(self._remembered, state)
        check_finite(checked, tuple(checked))
        return checked
