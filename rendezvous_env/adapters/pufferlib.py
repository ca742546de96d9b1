"""PufferLib: robots as agents in one process with shared buffers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pufferlib
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from ..deprecation import renamed_arguments
from ..scenario.scenarios import ScenarioLike
from ..vector import training_env
from .slots import RobotSlots

_COUNTED = ("return", "length", "cost")
Buffers = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], list[dict[str, Any]]]
"""Arrays of observations, rewards, terminals, truncations and infos."""


@renamed_arguments(num_teams="num_envs")
def make(
    scenario: ScenarioLike,
    num_envs: int = 64,
    *,
    buf: Any = None,
    seed: int | None = None,
    wrap: Callable[[Any], Any] = lambda vector_env: vector_env,
    **arguments: Any,
) -> RobotPufferEnv:
    """Create robots of ``vector.training_env`` as agents, for ``pufferlib.vector.make``.

    ``wrap`` applies a custom ``VectorWrapper``, for example one that changes rewards. ``buf`` and
    ``seed`` are arguments of ``RobotPufferEnv``. All other arguments, and errors, are those of the
    vector environment.
    """
    return RobotPufferEnv(wrap(training_env(scenario, num_envs, **arguments)), buf, seed)


class RobotPufferEnv(pufferlib.PufferEnv):
    """B environments of n robots as B·n agents that write into PufferLib's buffers.

    An environment is reset in the step in which it ends. All its agents last until then. A merged
    agent has zero observations, and its action is ignored. It receives the team reward to the end,
    so an early merge is not penalised. ``masks`` are False for merged agents. ``terminals`` are
    rendezvous and ``truncations`` are time limits. The trainer of PufferLib 3 reads only the
    former, and bootstraps a time limit from the first observation of the next episode.

    When environments end, infos hold one dict for each of them: ``episode_return`` (sum of team
    rewards), ``episode_length`` (steps) and the episode summary. ``Scenario.costs`` adds
    ``episode_cost``; ``costs`` then holds those of the last step, (agents,). ``conditions`` are
    those of ``Simulator``, (agents,) bool each.

    Args:
        vector_env: a vector environment with SAME_STEP autoreset and ``on_merge="follow"``, such as
            ``rendezvous_env.vector.training_env`` returns; a ValueError otherwise.
        buf: buffers of a vectorisation to write into; None allocates them.
        seed: s, overridden by the seed of ``reset``; None continues with the next episodes.
            Environment b has the seed s · B + b. A vectorisation seeds its members consecutively,
            so all environments have distinct seeds.
    """

    @renamed_arguments(teams="vector_env")
    def __init__(
        self, vector_env: VectorEnv[Any, Any, Any], buf: Any = None, seed: int | None = None
    ) -> None:
        self.slots = RobotSlots(vector_env, values_ends=False)
        follows = self.slots.simulator.scenario.on_merge
        if follows != "follow":
            raise ValueError(
                f"on_merge is {follows!r}; agents that last until the end need 'follow'"
            )
        self._seed, self.simulator = seed, self.slots.simulator
        self.num_agents = self.slots.active.size
        self.single_observation_space = self.slots.single_observation_space
        self.single_action_space = self.slots.single_action_space
        self.costs: dict[str, NDArray[np.float64]] = {}
        self.conditions: dict[str, NDArray[np.bool_]] = {}
        super().__init__(buf)

    def reset(self, seed: int | None = None) -> tuple[NDArray[np.float32], list[dict[str, Any]]]:
        """Start a new episode in all environments; returns observations and empty infos."""
        given, self._seed = self._seed if seed is None else seed, None
        first = None if given is None else given * self.slots.batch_size
        self.observations[:] = self.slots.reset(first)
        self.rewards[:], self.terminals[:], self.truncations[:] = 0.0, False, False
        self.masks[:] = True
        return self.observations, []

    def step(self, actions: NDArray[Any]) -> Buffers:
        """Advance every environment with actions (agents, a), or (agents,) if discrete.

        The error for an invalid action names the robot.
        """
        step = self.slots.step(np.asarray(actions))
        n, self.costs, self.conditions = self.slots.n_robots, step.costs, step.conditions
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
        """Close the vector environment."""
        self.slots.close()
