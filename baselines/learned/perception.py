"""What a learned policy is shown: tables made from the robot's own observations, and its memory.

Nothing here knows a position or a distance. The tables are in the frame with x along f, so a policy
that reads them does not notice how the world is turned.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.engine.state_checks import (
    check_entries,
    check_finite,
    check_mask,
    check_numbers,
    check_observations,
)
from rendezvous_env.experiment.scenario import Scenario

from .perception_layout import PerceptionLayout
from .robots import check_readable
from .showing import Constants, Memory, law_velocities, show


class Perception:
    """Shows B teams of n robots to a network, once for each decision.

    Args:
        scenario: whose robots see.
        num_envs: B.
        decision_time: s between two decisions of a team, where nothing else is said.
        obstacle_slots: M, at least the scenario's; further rows are absent. None is the scenario's.

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
    ) -> None:
        check_readable(scenario)
        rows = scenario.observation_layout
        slots = rows.obstacle_slots if obstacle_slots is None else obstacle_slots
        if slots < rows.obstacle_slots:
            raise ValueError(
                f"obstacle_slots is {slots}; scenario {scenario.name!r} needs "
                f"{rows.obstacle_slots} or more"
            )
        self.layout = PerceptionLayout(rows.neighbour_slots, slots)
        self._decision_time = float(decision_time)
        self._constants = Constants(
            neighbour_slots=rows.neighbour_slots,
            merge_radius=float(scenario.merge_radius),
            duration=float(scenario.tau),
            speed_limit=float(scenario.speed_limit),
        )
        robots = num_envs, scenario.n_robots
        self._seen = (*robots, *rows.shape)
        self._memory = Memory(
            edges=np.zeros((*robots, rows.obstacle_slots, 2, 2)),
            towards=np.zeros((*robots, 2)),
            averages=np.zeros((*robots, 4, 2)),
            time=np.zeros(robots),
        )

    def see(
        self,
        observations: NDArray[np.float32],
        headings: NDArray[np.float64],
        which: NDArray[np.bool_] | None = None,
        velocities: NDArray[np.float64] | None = None,
        elapsed: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float32]:
        """What the robots are shown; brings the memory up to date.

        Args:
            observations: (B, n, rows, 2), in the robots' own frames.
            headings: those carried, (B, n, 2), in the same frames; zero where there is none.
            which: (B,), whose memory moves on; the others are shown as zeros. None is all teams.
            velocities: of the robots, (B, n, 2), m/s; None is those of law (4).
            elapsed: since the decision before, (B,), s; None is ``decision_time``.

        Returns:
            (B, n, layout.size); zeros for a robot without neighbours.

        Raises:
            ValueError: for arrays of another shape or type; nothing has changed then.
        """
        observations = check_observations(observations, self._seen)
        headings = check_numbers("headings", headings, self._memory.towards.shape, "(B, n, 2)")
        teams = np.arange(len(observations))
        if which is not None:
            teams = np.flatnonzero(check_mask(which, len(observations)))
        if velocities is None:
            velocities = np.empty_like(headings)
            law_velocities(observations, headings, self._constants, velocities)
        size = self.layout._replace(tank_columns=0).size
        shown = np.zeros((*observations.shape[:2], size), dtype=np.float32)
        moving = headings, np.ascontiguousarray(velocities)
        times = self._times(elapsed)
        show(teams, times, observations, *moving, self._constants, self._memory, shown)
        return shown

    def _times(self, elapsed: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Since the decision before, (B,), s."""
        if elapsed is None:
            return np.full(len(self._memory.time), self._decision_time)
        times = check_numbers("elapsed", elapsed, self._memory.time.shape[:1], "(B,)")
        return np.ascontiguousarray(times, dtype=np.float64)

    @property
    def _remembered(self) -> dict[str, NDArray[np.float64]]:
        """All memory by name; not copied."""
        return self._memory._asdict()

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
