"""What oracle baselines share: they watch a simulator and read positions."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import bools, refuse
from rendezvous_env.simulator import Simulator

from ..policy import TeamPolicy, within_limits
from ..steering import Steering

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_ASIDE = 1e-3
"""Tangent of the angle from its way within which a robot that turns drives: its way is kept."""


class PrivilegedPolicy(TeamPolicy):
    """A policy that reads where robots are; those that turn do so on the spot."""

    name: str
    """What the registry calls it."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self._steering = Steering(scenario)
        self._simulator: Simulator | None = None
        self._fresh: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._steps: NDArray[np.int64] = np.zeros(0, np.int64)

    def watch(self, simulator: Simulator) -> None:
        """Take the teams whose map and positions it may read; call it before an episode.

        Args:
            simulator: freshly reset.

        Raises:
            ValueError: if it is no simulator of such robots.
        """
        n, d = self.scenario.n_robots, self.scenario.dim
        model = self.scenario.robot_model
        wanted = f"a Simulator of {n} {model.replace('_', ' ')}s in {d}-D"
        if not isinstance(simulator, Simulator):
            refuse("simulator", simulator, wanted)
        scenario = simulator.scenario
        if (scenario.robot_model, scenario.n_robots, scenario.dim) != (model, n, d):
            refuse("simulator", scenario, wanted)
        self._simulator, self._steps = simulator, simulator.steps
        self.reset()

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Begin anew at the next call, for the teams where ``mask`` (B,) is true or for all."""
        if self._simulator is None:
            return
        batch = self._simulator.num_envs
        if mask is None:
            self._fresh = np.ones(batch, bool)
        else:
            self._fresh = self._fresh | bools("mask", mask, (batch,), "teams")

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (..., n, a), of the teams that it watches; see ``Policy``.

        Raises:
            RuntimeError: if it watches none.
            ValueError: if the observations are those of other teams.
        """
        seen = self.scenario.observation_layout.checked(observations)
        if (simulator := self._simulator) is None:
            raise RuntimeError(
                f"{self.name} reads positions: call its watch(simulator) before an episode, as "
                "rollout and compare do"
            )
        teams = (simulator.num_envs, self.scenario.n_robots)
        if seen.shape[:-2] not in (teams, teams[teams[0] == 1 :]):
            raise ValueError(
                f"observations have shape {seen.shape}; those of the teams that {self.name} "
                f"watches have {(*teams, *seen.shape[-2:])}"
            )
        steps, active = simulator.steps, simulator.active
        begun = self._fresh | (steps < self._steps)
        self._fresh, self._steps = np.zeros_like(begun), steps
        wanted = self._velocities(simulator, active, begun)
        wanted = np.where(active[..., np.newaxis], wanted, 0.0)
        # frames lead from local to global, their transpose leads back
        own = np.sum(simulator.frames * wanted[..., np.newaxis], axis=-2)
        actions = self._steering.actions(own, seen.reshape(*own.shape[:-1], *seen.shape[-2:]))
        if self._steering.turns:
            aside = np.linalg.norm(own[..., 1:], axis=-1) > _ASIDE * own[..., 0]
            actions[..., 0] = np.where(aside, 0.0, actions[..., 0])
        limited = within_limits(actions, self.scenario)
        return limited.reshape(*seen.shape[:-2], self.scenario.action_size)

    @abstractmethod
    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        """(B, n, d), m/s, in the global frame.

        Robots of ``active``, (B, n), still exist on their own; teams of ``begun``, (B,), are at the
        beginning of an episode, or have been told to be.
        """


def within_a_step(rest: Array, scenario: Scenario) -> Array:
    """Velocities (..., d), m/s, that lead straight on for what is left, (..., d), m, at the speed
    limit, and not beyond it in a step.
    """
    distance = np.linalg.norm(rest, axis=-1, keepdims=True)
    speed = scenario.speed_limit / np.where(distance > 0.0, distance, 1.0)
    return rest * np.minimum(speed, 1.0 / scenario.tau)
