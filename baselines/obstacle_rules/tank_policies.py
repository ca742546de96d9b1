"""Scripted policies under an energy tank (theorem D)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import between, bools, number, positive
from rendezvous_env.safety.tank import EnergyTank

from ..policy import Policy, TeamPolicy, is_single_integrator, register
from .heading_rules import Array, check_clearance
from .wall_following import MEMORY, PATIENCE, WORK, Settings, wall_following_wishes

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario


@dataclass
class TankJoinedPolicy(TeamPolicy):
    """The joined rule under an energy tank: round walls, away from f too while the tank lasts.

    What blocks f is passed on one side, along the wall, until f is free. The robot turns back when
    it has lost more than ``patience``‖f‖ of its own work ∫ f·v dt since it met the wall, twice as
    much after each turn, or when its tank is low; so it tries both sides ever farther. Where the
    tank would not last it rests instead of pressing against a wall.

    A policy like any other: it books what it commanded, knows neither contacts nor steps that a
    merge cut short, and what an absorbed robot had left is lost. Other leading axes of the
    observations are other teams, and start anew.
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
    _tank: EnergyTank | None = field(init=False, repr=False, default=None)
    _memory: Array = field(init=False, repr=False, default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        number("budget", self.budget, 0.0, unit="m²/s")
        between("min_alignment", self.margin, 0, 1)
        check_clearance(self.clearance)
        positive("patience", self.patience, "m")
        scenario = self.scenario
        self._settings = Settings(
            clearance=float(self.clearance),
            patience=float(self.patience),
            min_alignment=float(self.margin),
            merge_radius=float(scenario.merge_radius),
            duration=float(scenario.tau),
            speed_limit=float(scenario.speed_limit),
        )

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Velocities (..., n, d); see ``Policy``."""
        layout = self.scenario.observation_layout
        f, degrees = layout.net_bearing(observations), layout.degree(observations)
        tank, memory = self._remembered(f.shape[:-1])
        seen = np.ascontiguousarray(observations, np.float32).reshape(
            -1, f.shape[-2], *layout.shape
        )
        silhouettes = np.ascontiguousarray(layout.split(seen).obstacles)
        wished = np.zeros((f.size // 2, 2))
        wall_following_wishes(
            f.reshape(wished.shape),
            degrees.reshape(-1),
            silhouettes.reshape(len(wished), *silhouettes.shape[2:]),
            tank.levels.reshape(-1),
            self._settings,
            memory,
            wished,
        )
        tank.hold(wished.reshape(len(seen), -1, 2) / self.scenario.speed_limit)
        actions = tank.act(seen).reshape(f.shape)
        tank.book()
        memory[:, WORK] += self.scenario.tau * np.sum(f * actions, axis=-1).reshape(-1)
        return actions

    def _remembered(self, team: tuple[int, ...]) -> tuple[EnergyTank, Array]:
        """The tanks and memories of teams (..., n), new ones if the last teams were others."""
        if self._tank is None or self._memory.shape != (*team, MEMORY):
            self._tank = EnergyTank(
                self.scenario,
                int(np.prod(team[:-1])),
                budget=self.budget,
                min_alignment=self.margin,
                frame="local",
            )
            self._memory = np.zeros((*team, MEMORY))
            self._memory[..., PATIENCE] = self.patience
        return self._tank, self._memory.reshape(-1, MEMORY)

    @property
    def levels(self) -> Array:
        """A, (..., n), m²/s; without an episode there are none."""
        if self._tank is None:
            return np.zeros(0)
        return self._tank.levels.reshape(self._memory.shape[:-1])

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Fill the tanks and forget the walls of the teams where ``mask`` is true; None: of all."""
        if mask is None:
            self._tank = None
        elif self._tank is not None:
            chosen = bools("mask", mask, self._memory.shape[:-2], "teams")
            self._tank.forget(np.atleast_1d(chosen.reshape(-1)))
            self._memory[chosen] = 0.0
            self._memory[chosen, :, PATIENCE] = self.patience


def _fits(scenario: Scenario) -> bool:
    slots = scenario.observation_layout.obstacle_slots
    return is_single_integrator(scenario) and scenario.dim == 2 and slots > 0


@register("tank-joined", fits=_fits, kind="tank")
def _tank_joined(
    scenario: Scenario,
    budget: float = TankJoinedPolicy.budget,
    min_alignment: float = TankJoinedPolicy.margin,
    clearance: float = TankJoinedPolicy.clearance,
    patience: float = TankJoinedPolicy.patience,
) -> Policy:
    """Follows walls under an energy tank, the one side or the other, ever farther."""
    return TankJoinedPolicy(scenario, budget, min_alignment, clearance, patience)
