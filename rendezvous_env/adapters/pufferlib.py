"""Robots as the agents of a PufferLib environment: one process, shared buffers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pufferlib
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from ..scenario.scenarios import ScenarioLike
from ..vector import training_env
from .slots import RobotSlots

_COUNTED = ("return", "length", "cost")
Buffers = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], list[dict[str, Any]]]
"""Observations, rewards, terminals, truncations and infos."""


def make(
    scenario: ScenarioLike,
    num_teams: int = 64,
    *,
    buf: Any = None,
    seed: int | None = None,
    wrap: Callable[[Any], Any] = lambda teams: teams,
    **arguments: Any,
) -> RobotPufferEnv:
    """The robots of ``vector.training_env`` as agents; what ``pufferlib.vector.make`` calls.

    ``wrap`` puts the teams into a ``VectorWrapper`` of your own that changes rewards, say; ``buf``
    and ``seed`` are of ``RobotPufferEnv``, all other arguments, and errors, of the teams.
    """
    return RobotPufferEnv(wrap(training_env(scenario, num_teams, **arguments)), buf, seed)


class RobotPufferEnv(pufferlib.PufferEnv):
    """B teams of n robots as B·n agents, written into PufferLib's buffers.

    A team is reset in the step in which it ends. All agents of a team live as long as it does:
    one that has merged away observes zeros, its action is ignored and it earns the team reward to
    the end, so that meeting early is not punished. ``masks`` say who is not merged away.
    ``terminals`` are rendezvous and ``truncations`` time limits; the trainer of PufferLib 3 reads
    only the former, and values a time limit by the first observation of the next episode.

    Infos hold, in the step in which teams end, one dict for each of them: ``episode_return`` (sum
    of team rewards), ``episode_length`` (steps) and the summary of its episode. With
    ``Scenario.costs`` also ``episode_cost``, and ``costs`` holds those of the last step, (agents,).

    Args:
        teams: a vector environment of teams with SAME_STEP autoreset whose scenario has
            ``on_merge="follow"``, as ``rendezvous_env.vector.training_env`` makes one; a
            ValueError for others.
        buf: buffers to write into, of a vectorisation; None makes own ones.
        seed: s, unless ``reset`` is given another; None goes on to the next episodes. Team b has
            the seed s · B + b: a vectorisation seeds its environments with consecutive numbers, and
            no two of their teams begin alike.
    """

    def __init__(
        self, teams: VectorEnv[Any, Any, Any], buf: Any = None, seed: int | None = None
    ) -> None:
        self.slots = RobotSlots(teams, values_ends=False)
        follows = self.slots.simulator.scenario.on_merge
        if follows != "follow":
            raise ValueError(
                f"on_merge is {follows!r}; agents that live as long as their team need 'follow'"
            )
        self._seed, self.simulator = seed, self.slots.simulator
        self.num_agents = self.slots.active.size
        self.single_observation_space = self.slots.single_observation_space
        self.single_action_space = self.slots.single_action_space
        self.costs: dict[str, NDArray[np.float64]] = {}
        super().__init__(buf)

    def reset(self, seed: int | None = None) -> tuple[NDArray[np.float32], list[dict[str, Any]]]:
        """Begin a new episode in all teams; observations and no infos."""
        given, self._seed = self._seed if seed is None else seed, None
        first = None if given is None else given * self.slots.num_teams
        self.observations[:] = self.slots.reset(first)
        self.rewards[:], self.terminals[:], self.truncations[:] = 0.0, False, False
        self.masks[:] = True
        return self.observations, []

    def step(self, actions: NDArray[Any]) -> Buffers:
        """Advance every team by one step with actions (agents, a), or (agents,) of choices; bad
        ones are refused by the name of their robot.
        """
        step = self.slots.step(np.asarray(actions))
        n, self.costs = self.slots.n_robots, step.costs
        self.observations[:], self.rewards[:] = step.observations, step.rewards
        self.terminals[:] = np.repeat(step.met, n) if step.finished else False
        self.truncations[:] = np.repeat(step.late, n) if step.finished else False
        self.masks[:] = self.slots.active.reshape(-1)
        infos = [
            {f"episode_{key}" if key in _COUNTED else key: value for key, value in team.items()}
            for team in step.finished.values()
        ]
        return self.observations, self.rewards, self.terminals, self.truncations, infos

    def close(self) -> None:
        """Close the teams."""
        self.slots.close()
