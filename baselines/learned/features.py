"""Features that a learned policy is shown: tables made from the robot's own observations, and what
it remembers.

Nothing here knows a position or a distance. The tables are in the frame with x along f, so a policy
that reads them does not notice how the world is turned.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.engine.state_checks import (
    Remembering,
    check_mask,
    check_numbers,
    check_observations,
)
from rendezvous_env.safety.safety_filter import over_teams
from rendezvous_env.scenario.scenario import Scenario

from ..steering import can_steer
from .feature_kernels import (
    CONTEXT_COLUMNS,
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    Constants,
    Memory,
    show,
)
from .wall_memory import no_walls

VERSION = 2
"""Of what the columns mean; a network trained with another one cannot read the tables."""
_WEIGHT = 8
"""A robot that is shown something counts as so many that a filter steers."""
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


def check_readable(scenario: Scenario) -> None:
    """Refuse robots that a learned policy cannot steer.

    Raises:
        ValueError: unless they are single integrators, unicycles or nonholonomic robots of space.
    """
    if not can_steer(scenario):
        raise ValueError(
            f"scenario {scenario.name!r} has {scenario.robot_model} robots; learned policies steer "
            "single_integrator, unicycle and nonholonomic_3d"
        )


class Features(Remembering):
    """Shows B teams of n robots to a network, once for each decision.

    Args:
        scenario: whose robots see; those of space see planes (``SteadyPlanes``).
        num_envs: B.
        decision_time: s between two decisions of a team, where nothing else is said.
        obstacle_slots: M, at least the scenario's; further rows are absent. None is the scenario's.
        tank_columns: 0, LEVEL_COLUMNS, or LEVEL_COLUMNS + WALL_COLUMNS with a memory of walls.
        num_threads: most threads that may be used; None is one for each core.

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
        num_threads: int | None = None,
    ) -> None:
        check_readable(scenario)
        rows = replace(scenario.observation_layout, dim=2, senses_gravity=False)
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
        self._kept = Memory(
            edges=np.zeros((*robots, rows.obstacle_slots, 2, 2)),
            towards=np.zeros((*robots, 2)),
            averages=np.zeros((*robots, 4, 2)),
            time=np.zeros(robots),
        )
        self._walls = no_walls(*robots) if tank_columns > LEVEL_COLUMNS else None
        self._num_threads = num_threads

    @property
    def _memory(self) -> dict[str, NDArray[np.float64]]:
        walls = {} if self._walls is None else self._walls._asdict()
        return self._kept._asdict() | {f"wall_{name}": array for name, array in walls.items()}

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
        robots = self._kept.time.shape
        shown = np.zeros((*robots, self.layout.size), dtype=np.float32)
        self.see_into(shown, observations, headings, which, velocities, levels, elapsed)
        return shown

    def see_into(
        self,
        shown: NDArray[np.float32],
        observations: NDArray[np.float32],
        headings: NDArray[np.float64],
        which: NDArray[np.bool_] | None = None,
        velocities: NDArray[np.float64] | None = None,
        levels: NDArray[np.float64] | None = None,
        elapsed: NDArray[np.float64] | None = None,
    ) -> None:
        """As ``see``, into rows (B, n, layout.size) of teams whose memory moves on; others stay."""
        robots = self._kept.time.shape
        observations = check_observations(observations, (*robots, *self._rows.shape))
        headings = check_numbers("headings", headings, (*robots, 2), "(B, n, 2)")
        teams = np.arange(len(observations))
        if which is not None:
            teams = np.flatnonzero(check_mask(which, len(observations)))
        if velocities is not None:
            velocities = np.ascontiguousarray(velocities)
        times = np.full(robots[0], self._decision_time)
        if elapsed is not None:
            times[:] = check_numbers("elapsed", elapsed, robots[:1], "(B,)")
        slots = self._rows.obstacle_slots
        over_teams(
            lambda part: show(
                part,
                (teams, times),
                observations,
                (headings, velocities),
                self._constants,
                (self._kept, np.empty((slots, 2))),
                (levels, self._walls),
                shown,
            ),
            len(teams),
            _WEIGHT * robots[1],
            self._num_threads,
        )

    def note(self, angles: NDArray[np.float64]) -> None:
        """Remember the angles (B, n) that were chosen, rad."""
        if self._walls is not None:
            self._walls.angle[...] = angles
