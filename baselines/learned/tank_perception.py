"""What a policy with a tank is shown besides: its level, and what it remembers of a wall."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.experiment.scenario import Scenario

from .perception import Perception
from .perception_layout import BLOCKED, LEVEL_COLUMNS, WALL_COLUMNS

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


class TankPerception(Perception):
    """As ``Perception``, and the columns of the tank and of the wall's memory behind them.

    Args:
        scenario: whose robots see.
        num_envs: B.
        decision_time: as in ``Perception``.
        obstacle_slots: as in ``Perception``.
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
        """As ``Perception.see``.

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
