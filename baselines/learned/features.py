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

from ..policy import is_single_integrator
from .feature_kernels import (
    CONTEXT_COLUMNS,
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    Constants,
    Memory,
    law_velocities,
    show,
)

VERSION = 2
"""Of what the columns mean; a network trained with another one cannot read the tables."""
BLOCKED = slice(16, 18)
"""Of the context: whether the joined silhouettes leave nothing free, whether any is seen."""
LEVEL_COLUMNS = 1
"""After the context, with a tank: log(1 + A/(r D̄))."""
WALL_COLUMNS = 12
"""After that, with a memory of walls: see ``TankFeatures``."""


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


def can_steer(scenario: Scenario) -> bool:
    """Whether its robots are single integrators in the plane."""
    return is_single_integrator(scenario) and scenario.dim == 2


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
        self.layout = FeatureLayout(rows.neighbour_slots, slots)
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


# ---- with a tank --------------------------------------------------------------------------------

_LEFT = 2.0
"""Time without a wall before f after which it is left behind, s."""
_LONG = 20.0
"""Over which velocity and direction of f are averaged, s."""
_FRESH = 8.0
_SLOW = 30.0
"""Units of the time at a wall, s."""


class _Walls(NamedTuple):
    """What robots remember of the wall that they are at, (B, n) each but for the vectors."""

    since: NDArray[np.float64]
    """s for which they have been at it; 0 at none."""
    clear: NDArray[np.float64]
    """s for which nothing was before f."""
    level: NDArray[np.float64]
    """log(1 + A/(r D̄)) when it was met."""
    turned: NDArray[np.float64]
    """By how much f has turned since, rad."""
    wound: NDArray[np.float64]
    """By how much the heading has turned since, rad."""
    angle: NDArray[np.float64]
    """Last chosen, rad."""
    towards: NDArray[np.float64]
    """(B, n, 2), direction of f at the last decision, zero before the first."""
    heading: NDArray[np.float64]
    """(B, n, 2), at the last decision."""
    averages: NDArray[np.float64]
    """(B, n, 2, 2), of the velocity and of the direction of f."""


class TankFeatures(Features):
    """As ``Features``, and the columns of the tank and of the wall's memory behind them.

    Args:
        scenario: whose robots see.
        num_envs: B.
        decision_time: as in ``Features``.
        obstacle_slots: as in ``Features``.
        walls: whether to remember walls.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        decision_time: float,
        obstacle_slots: int | None = None,
        walls: bool = False,
    ) -> None:
        super().__init__(
            scenario, num_envs, decision_time=decision_time, obstacle_slots=obstacle_slots
        )
        columns = LEVEL_COLUMNS + (WALL_COLUMNS if walls else 0)
        self.layout = self.layout._replace(tank_columns=columns)
        self._scenario = scenario
        self._walls: _Walls | None = None
        if walls:
            robots = num_envs, scenario.n_robots
            shapes = [robots] * 6 + [(*robots, 2)] * 2 + [(*robots, 2, 2)]
            self._walls = _Walls(*map(np.zeros, shapes))

    def see_tank(
        self,
        observations: NDArray[np.float32],
        headings: NDArray[np.float64],
        which: NDArray[np.bool_] | None = None,
        *,
        velocities: NDArray[np.float64],
        levels: NDArray[np.float64],
        elapsed: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float32]:
        """As ``Features.see``.

        Args:
            observations: as there.
            headings: as there.
            which: as there.
            velocities: of the robots, (B, n, 2), m/s.
            levels: A/(r D̄) of their tanks, (B, n).
            elapsed: as there.
        """
        base = self.see(observations, headings, which, velocities, elapsed)
        alive = np.asarray(base.any(axis=-1))
        level = np.log1p(levels)
        more = [level]
        if self._walls is not None:
            f = self._scenario.observation_layout.net_bearing(observations)
            strength = np.linalg.norm(f, axis=-1, keepdims=True)
            towards = np.where(strength > 0.0, f / np.where(strength > 0.0, strength, 1.0), 0.0)
            first = base.shape[-1] - self.layout._replace(tank_columns=0).context_columns
            blocked = np.asarray(base[..., first:][..., BLOCKED].any(axis=-1))
            moving = headings, velocities
            self._move_on(self._times(elapsed), alive, blocked, level, towards, *moving)
            more += self._tell(towards)
        columns = np.stack(more, axis=-1) * alive[..., np.newaxis]
        return np.concatenate([base, columns.astype(np.float32)], axis=-1)

    def note(self, angles: NDArray[np.float64]) -> None:
        """Remember the angles (B, n) that were chosen, rad."""
        if self._walls is not None:
            self._walls.angle[...] = angles

    def _move_on(
        self,
        elapsed: NDArray[np.float64],
        alive: NDArray[np.bool_],
        blocked: NDArray[np.bool_],
        level: NDArray[np.float64],
        towards: NDArray[np.float64],
        headings: NDArray[np.float64],
        velocities: NDArray[np.float64],
    ) -> None:
        """Bring the memory of the robots that are shown something up to date."""
        assert self._walls is not None
        walls, time = self._walls, elapsed[:, np.newaxis]
        clear = np.where(blocked, 0.0, walls.clear + time)
        stays = (walls.since > 0.0) & (clear <= _LEFT)
        meets = blocked & ~stays
        turned = walls.turned + _turn(walls.towards, towards)
        wound = walls.wound + _turn(walls.heading, headings)
        now = np.stack([velocities, towards], axis=-2)
        known = np.asarray(walls.towards.any(axis=-1))[..., np.newaxis, np.newaxis]
        begun = np.where(known, walls.averages, np.stack([0.0 * towards, towards], axis=-2))
        kept = np.exp(-elapsed / _LONG)[:, np.newaxis, np.newaxis, np.newaxis]
        values = _Walls(
            since=np.where(stays, walls.since + time, np.where(meets, time, 0.0)),
            clear=clear,
            level=np.where(stays, walls.level, np.where(meets, level, 0.0)),
            turned=np.where(stays, turned, 0.0),
            wound=np.where(stays, wound, 0.0),
            angle=walls.angle,
            towards=towards,
            heading=headings,
            averages=kept * begun + (1.0 - kept) * now,
        )
        for mine, value in zip(walls, values, strict=True):
            mine[alive] = value[alive]

    def _tell(self, towards: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """The columns (B, n) of the wall's memory, vectors with x along f."""
        assert self._walls is not None
        walls = self._walls
        at = walls.since > 0.0
        across = np.stack([-towards[..., 1], towards[..., 0]], axis=-1)
        return [
            at.astype(np.float64),
            walls.level,
            walls.since / _SLOW,
            np.where(at, np.exp(-walls.since / _FRESH), 0.0),
            walls.turned / np.pi,
            walls.wound / np.pi,
            np.cos(walls.angle),
            np.sin(walls.angle),
            *(np.sum(walls.averages[..., k, :] * u, -1) for k in (0, 1) for u in (towards, across)),
        ]

    @property
    def _remembered(self) -> dict[str, NDArray[np.float64]]:
        walls = {} if self._walls is None else self._walls._asdict()
        return super()._remembered | {f"wall_{name}": array for name, array in walls.items()}


def _turn(before: NDArray[np.float64], now: NDArray[np.float64]) -> NDArray[np.float64]:
    """From one vector to another, rad counter-clockwise in (−π, π]; 0 where one is zero."""
    across = before[..., 0] * now[..., 1] - before[..., 1] * now[..., 0]
    turn: NDArray[np.float64] = np.arctan2(across, np.sum(before * now, axis=-1))
    return turn
