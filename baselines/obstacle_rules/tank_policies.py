"""The joined rule under an energy tank (theorem D): round walls, on one side, turning back when it
costs too much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import between, number, positive
from rendezvous_env.safety.tank import EnergyTank
from rendezvous_env.safety.turning import gate_of

from ..policy import Policy, RememberingPolicy, register
from ..steering import ALIGNED, ALIGNED_IN_SPACE, Steering
from .obstacle_avoidance import Array, check_clearance
from .turning_robots import can_pass_obstacles
from .wall_following import (
    HEADING,
    HEADING_X,
    HEADING_Y,
    MEMORY,
    MEMORY_IN_SPACE,
    PATIENCE,
    WORK,
    Settings,
    wall_following_velocities,
    wall_following_velocities_3d,
)

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario

_TOIL = 0.15
"""Share of ‖f‖ times its way that a robot that turns counts as lost: two that go round one thing on
one side, ever opposite, would else never turn back."""


@dataclass
class TankJoinedPolicy(RememberingPolicy):
    """The joined rule under an energy tank: round walls, away from f too while the tank lasts.

    What blocks f is passed on one side, along the wall, until f is free; in space at one azimuth,
    the one with least to turn (``planes_in_space``). The robot turns back when it has lost more
    than ``patience``‖f‖ of its own work ∫ f·v dt since it met the wall, twice as much after each
    turn, or when its tank is low; so it tries both sides ever farther, in space then those across
    them. Where the tank would not last it rests instead of pressing against a wall.

    A nonholonomic robot turns into that direction, drives where its axis points past all
    silhouettes, and does not change its mind while it turns on the spot. Some of its way counts as
    lost, so that two do not go round one thing for ever. Its tank owes nothing: it may always rest.

    It books what it commanded, knows neither contacts nor steps that a merge cut short, and what an
    absorbed robot had left is lost.
    """

    scenario: Scenario
    """Whose robots it steers."""
    budget: float = 50.0
    """B of each robot, m²/s."""
    margin: float = 0.05
    """ε of the tank, in (0, 1)."""
    clearance: float = 0.2
    """Angle by which to stay clear of an edge, rad."""
    patience: float = 1.0
    """How far from f a first try may lead, m."""

    def __post_init__(self) -> None:
        number("budget", self.budget, 0.0, unit="m²/s")
        between("min_alignment", self.margin, 0, 1)
        check_clearance(self.clearance)
        positive("patience", self.patience, "m")
        scenario = self.scenario
        steering = self._steering = Steering(scenario)
        self._unit = np.array(scenario.action_bounds if steering.turns else scenario.speed_limit)
        self._settings = Settings(
            clearance=float(self.clearance) / (scenario.dim - 1),
            patience=float(self.patience),
            min_alignment=0.0 if steering.turns else float(self.margin),  # guarantees 8
            merge_radius=float(scenario.merge_radius),
            duration=float(scenario.tau),
            speed_limit=float(scenario.speed_limit),
            turns=steering.turns,
            gate=gate_of(scenario, 0.0, 0.0),
            aligned=ALIGNED if scenario.dim == 2 else ALIGNED_IN_SPACE,
        )

    def _start(self, teams: int) -> None:
        scenario, margin = self.scenario, self.margin
        self._tank = EnergyTank(
            scenario, teams, budget=self.budget, min_alignment=margin, frame="local"
        )
        planar = scenario.dim == 2
        size = MEMORY if planar else MEMORY_IN_SPACE
        self._vectors = slice(HEADING_X, HEADING_Y + 1) if planar else slice(HEADING, size)
        self._memory = np.zeros((teams, scenario.n_robots, size))
        self._memory[..., PATIENCE] = self.patience

    def _forget(self, which: NDArray[np.bool_]) -> None:
        self._tank.forget(which)
        self._memory[which] = 0.0
        self._memory[which, :, PATIENCE] = self.patience

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (..., n, a); see ``Policy``."""
        seen, layout = self._teams_of(observations), self.scenario.observation_layout
        f, robots = layout.net_bearing(seen), seen.shape[0] * seen.shape[1]
        planar = layout.dim == 2
        follow = wall_following_velocities if planar else wall_following_velocities_3d
        silhouettes = np.ascontiguousarray(layout.split(seen).obstacles)
        desired = np.zeros((robots, self.scenario.action_size))
        follow(
            f.reshape(robots, layout.dim),
            layout.degree(seen).reshape(robots),
            silhouettes.reshape(robots, *silhouettes.shape[2:]),
            self._tank.levels.reshape(robots),
            self._settings,
            self._steering.pitches(seen).reshape(robots),
            self._memory.reshape(robots, self._memory.shape[-1]),
            desired,
        )
        self._tank.hold(desired.reshape(*f.shape[:-1], -1) / self._unit)
        actions = self._tank.act(seen)
        self._tank.book()
        velocities = self._steering.velocities(actions, seen)
        self._memory[..., WORK] += self.scenario.tau * np.sum(f * velocities, axis=-1)
        if self._steering.turns:
            toil = np.linalg.norm(f, axis=-1) * np.linalg.norm(velocities, axis=-1)
            self._memory[..., WORK] -= _TOIL * self.scenario.tau * toil
            for vector in np.split(self._memory[..., self._vectors], 1 if planar else 2, axis=-1):
                vector[:] = self._steering.turned(vector, actions, seen)
        return self._as_given(actions)

    @property
    def levels(self) -> Array:
        """A, (..., n), m²/s; without an episode there are none."""
        return np.zeros(0) if self._leading is None else self._as_given(self._tank.levels)


@register("tank-joined", fits=can_pass_obstacles, kind="tank")
def _tank_joined(
    scenario: Scenario,
    budget: float = TankJoinedPolicy.budget,
    min_alignment: float = TankJoinedPolicy.margin,
    clearance: float = TankJoinedPolicy.clearance,
    patience: float = TankJoinedPolicy.patience,
) -> Policy:
    """Follows walls under an energy tank, the one side or the other, ever farther."""
    return TankJoinedPolicy(scenario, budget, min_alignment, clearance, patience)
