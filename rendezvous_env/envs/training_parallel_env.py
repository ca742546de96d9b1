"""PettingZoo form of the training environment: the vector form with B = 1, agents by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray
from pettingzoo.utils.env import ParallelEnv

from ..checks import check_action, check_int
from ..scenario.scenarios import ScenarioLike
from .agents import BaseParallelEnv, StepReturn, check_robots
from .training import training_env as vector_training_env
from .vector_env import SINGLE_ENV, check_single_env


def training_env(
    scenario: ScenarioLike = "clutter-8",
    *,
    guarantee: str | None = "heading",
    learning_preset: bool = True,
    flatten: bool = True,
    discrete: bool = False,
    render_mode: str | None = None,
    **overrides: Any,
) -> TrainingParallelEnv:
    """Create a PettingZoo environment for a generic learner.

    It is that of ``rendezvous_env.vector.training_env`` with B = 1 and agents by name. See there
    for all arguments, errors, observations, actions and rewards. A ValueError if ``num_envs`` is
    not 1.
    """
    check_single_env(overrides, "rendezvous_env.vector.training_env")
    vector_env = vector_training_env(
        scenario,
        guarantee=guarantee,
        learning_preset=learning_preset,
        flatten=flatten,
        discrete=discrete,
        render_mode=render_mode,
        **SINGLE_ENV | overrides,
    )
    return TrainingParallelEnv(vector_env)


class TrainingParallelEnv(
    BaseParallelEnv[Box | Discrete], ParallelEnv[str, NDArray[np.float32], Any]
):  # listed, since some libraries inspect direct bases only
    """Training environment with agents by name; see ``training_env``.

    The agent set is fixed for an episode: a merged robot observes zeros, its action is ignored, and
    it receives the team reward. Infos have the same keys in every step: those of
    ``RendezvousParallelEnv`` without ``summary``, ``active``, and those of the guarantee wrapper.
    ``contact`` and costs cover the whole decision.

    Args:
        vector_env: ``TrainingVectorEnv`` with B = 1 and ``AutoresetMode.DISABLED``.
    """

    metadata = BaseParallelEnv.metadata | {"name": "rendezvous_training_v0"}

    def step(self, actions: Mapping[str, Any]) -> StepReturn:
        """Step with actions of all agents; errors as ``RendezvousParallelEnv.step``."""
        if self._is_over(actions):
            return {}, {}, {}, {}, {}
        names = self.agents
        check_robots(actions, names, self.simulator.merged_into[0])
        for name in names:
            action, space = actions[name], self.action_spaces[name]
            if isinstance(space, Box):
                check_action(name, action, space.shape[0])
            else:
                scalar = np.ndim(action) == 0 and hasattr(action, "item")
                index = action.item() if scalar else action
                check_int(f"action of {name}", index, 0, int(space.n) - 1)
        listed = [np.asarray(actions[name]) for name in names]
        if self._parts is not None:  # a robot has the first components
            size = self._parts.shape[1]
            listed = [np.pad(action, (0, size - len(action))) for action in listed]
        table = np.stack(listed)[None]
        observations, _, ends, cuts, infos = self.vector_env.step(table)
        over, cut = bool(ends[0]), bool(cuts[0])
        if over or cut:
            self.agents = []
        return (
            dict(zip(names, observations[0], strict=True)),
            dict(zip(names, infos["robot_rewards"][0].tolist(), strict=True)),
            dict.fromkeys(names, over),
            dict.fromkeys(names, cut),
            self._by_name(infos),
        )
