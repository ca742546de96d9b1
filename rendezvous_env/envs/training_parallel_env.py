"""One training team as a PettingZoo environment: the vector environment with B = 1, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, Space
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pettingzoo.utils.env import ParallelEnv

from ..checks import check_action, whole
from ..render.renderer import RENDER_MODES
from ..scenario.scenarios import ScenarioLike
from .agents import Infos, Observations, SpacesByName, StepReturn, alive_in, check_robots, names_of
from .single_env import OneOfTeams
from .spaces import of_one_robot
from .training import TrainingTeams
from .training import training_env as teams_to_train


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
    """One team as a generic learner wants it: a PettingZoo environment.

    It is the team of ``rendezvous_env.vector.training_env`` with B = 1, by name: the other
    arguments (``max_cycles``, ``touch_penalty``, those of the guarantee's wrapper, fields of the
    scenario), what robots see, do and earn, and errors are told there.
    """
    teams = teams_to_train(
        scenario,
        1,
        guarantee=guarantee,
        learning_preset=learning_preset,
        flatten=flatten,
        discrete=discrete,
        render_mode=render_mode,
        autoreset_mode=AutoresetMode.DISABLED,
        **overrides,
    )
    return TrainingParallelEnv(teams)


class TrainingParallelEnv(
    OneOfTeams, SpacesByName[Box | Discrete], ParallelEnv[str, NDArray[np.float32], Any]
):
    """The robots of one training team, by name.

    All are there from the first step of an episode to its last: one that has merged away observes
    zeros, its action is ignored, and it earns with its team. ``training_env`` says what they see
    and do. Every info has the same keys, and numbers:

    | key | |
    |---|---|
    | active | whether it still exists on its own |
    | merged_into | index of the robot that it is now part of; its own while it is active |
    | contact | whether it touched an obstacle since its last decision |
    | clearance | m to the nearest obstacle, inf without any |
    | success, time, contacts, path_length, lyapunov | of the team, as in ``rendezvous_v0`` |
    | alignment, lyapunov_rate, … | what the wrapper of the guarantee tells |
    | cost, cost_NAME | with ``Scenario.costs``: what it cost since the last decision |

    Args:
        teams: one team that does not begin anew by itself.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo reads a plain class attribute
        "name": "rendezvous_training_v0",
        "render_modes": RENDER_MODES,
        "is_parallelizable": True,
    }

    def __init__(self, teams: TrainingTeams) -> None:
        self._take_up(teams)
        self.possible_agents = names_of(teams.scenario.n_robots)
        self.agents: list[str] = []
        self.observation_spaces = self._for_each(teams.single_observation_space)
        self.action_spaces = self._for_each(teams.single_action_space)
        self.state_space = teams.teams.single_state_space

    def _for_each(self, space: Space[Any]) -> dict[str, Box | Discrete]:
        """A space of its own for each robot, so that each can be seeded."""
        return {name: of_one_robot(space) for name in self.possible_agents}

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Begin an episode, as ``rendezvous_v0``.

        Raises:
            ValueError: for a bad option or seed; nothing has changed then.
        """
        observations, infos = self.teams.reset(seed=seed, options=options)
        self.agents = self.possible_agents.copy()
        return dict(zip(self.agents, observations[0], strict=True)), self._by_name(infos)

    def step(self, actions: Mapping[str, Any]) -> StepReturn:
        """Let all robots act, those that have merged away included.

        Raises:
            KeyError: for a missing or unknown robot; nothing has changed then.
            ValueError: for an action that is none, naming the robot; likewise.
            RuntimeError: before the first reset.
        """
        if not self.simulator.begun:
            raise RuntimeError("call reset() before step()")
        if not self.agents and isinstance(actions, Mapping) and not actions:
            return {}, {}, {}, {}, {}
        names = self.agents
        check_robots(actions, names, self.simulator.merged_into[0])
        for name in names:
            self._check(name, actions[name])
        table = np.stack([np.asarray(actions[name]) for name in names])[None]
        observations, _, ends, cuts, infos = self.teams.step(table)
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

    def _check(self, name: str, action: Any) -> None:
        space = self.action_spaces[name]
        if isinstance(space, Discrete):
            given = action.item() if np.ndim(action) == 0 and hasattr(action, "item") else action
            whole(f"action of {name}", given, 0, int(space.n) - 1)
        else:
            check_action(name, action, space.shape[0])

    def _by_name(self, infos: Mapping[str, Any]) -> Infos:
        """What each robot is told: its own numbers, and those of its team."""
        kept = {k: v[0] for k, v in infos.items() if k[0] != "_" and k != "robot_rewards"}
        return {
            name: {key: (value[i] if value.ndim else value).item() for key, value in kept.items()}
            for i, name in enumerate(self.possible_agents)
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """As ``Simulator.set_state``."""
        super().set_state(state)
        self.agents = alive_in(self.simulator.get_state(), "follow")
