"""What every PettingZoo wrapper with a guarantee does: choices are held, a filter makes actions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from pettingzoo.utils.env import ParallelEnv
from pettingzoo.utils.wrappers import BaseParallelWrapper

from ..experiment.checks import check_action
from ..guarantee.action_filter import ActionFilter
from .holding import check_period, restore
from .overrides import NamesUnknownArguments
from .parallel_env import RendezvousParallelEnv
from .roster import Infos, Observations, StepReturn
from .spaces import as_told, choice_box, filtered_observation_box


def base_of(env: Any, wrapper: str) -> RendezvousParallelEnv:
    """The environment of ours that is wrapped.

    Args:
        env: what was given.
        wrapper: the name of the class that wraps it.

    Raises:
        TypeError: for another kind of environment.
    """
    if isinstance(env, ParallelEnv) and isinstance(env.unwrapped, RendezvousParallelEnv):
        return env.unwrapped
    raise TypeError(
        f"env is a {type(env).__name__}; it must be a PettingZoo parallel environment "
        "that parallel_env has made (for a vector environment take "
        f"rendezvous_env.vector.{wrapper})"
    )


class FilterWrapper(NamesUnknownArguments, BaseParallelWrapper):
    """Robots choose; for ``decision_period`` base steps a filter makes actions of it.

    Args:
        env: a rendezvous parallel environment.
        action_filter: of one team.
        memory: what the filter's part of the state is called.
        decision_period: base steps for which a choice is held.

    Raises:
        ValueError: for a bad ``decision_period``.
    """

    def __init__(
        self,
        env: RendezvousParallelEnv,
        action_filter: ActionFilter,
        memory: str,
        decision_period: int,
    ) -> None:
        super().__init__(env)
        self.decision_period = check_period(decision_period)
        self._base: RendezvousParallelEnv = env.unwrapped
        self._filter, self._memory = action_filter, memory
        names, scenario = self._base.possible_agents, self._base.scenario
        flatten = self._base.flatten
        self.observation_spaces = {
            name: filtered_observation_box(action_filter, flatten) for name in names
        }
        self.action_spaces = {name: choice_box(action_filter) for name in names}
        shape = (1, scenario.n_robots, *scenario.observation_layout.shape)
        self._observed = np.zeros(shape, dtype=np.float32)

    @property
    def max_cycles(self) -> int:
        """Time limit in steps of the base environment; may be set at any time."""
        return self._base.max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int) -> None:
        self._base.max_cycles = value

    def observation_space(self, agent: str) -> Box:
        """The space of one robot's observations; the same object each time."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """The space of one robot's choices; the same object each time."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Begin an episode; what was remembered of the last one is forgotten."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._filter.forget()
        self._remember(observations)
        self._tell(infos)
        return self._view(observations), infos

    def step(self, actions: Mapping[str, Any]) -> StepReturn:
        """Hold the choices for ``decision_period`` base steps.

        Args:
            actions: one choice for each robot in ``agents``.

        Returns:
            As the base environment, for the robots that were alive at the start.

        Raises:
            KeyError: for a missing, unknown or merged-away robot; nothing has changed then.
            ValueError: for a choice of the wrong shape, or one that is not finite; likewise.
        """
        if not self.agents and isinstance(actions, Mapping) and not actions:
            return {}, {}, {}, {}, {}
        self._base.check_robots(actions)
        size = self._filter.action_size
        for name, action in actions.items():
            check_action(name, action, size)
        raw = np.zeros((1, self._base.scenario.n_robots, size))
        for name, action in actions.items():
            raw[0, self._base.index(name)] = action
        self._filter.hold(raw)
        return self._drive()

    def _drive(self) -> StepReturn:
        """Base steps under the held choices, gathered into one."""
        observations: Observations = {}
        rewards: dict[str, float] = dict.fromkeys(self.agents, 0.0)
        terminations: dict[str, bool] = {}
        truncations: dict[str, bool] = {}
        infos: Infos = {}
        for _ in range(self.decision_period):
            actions = self._filter.act(self._observed)[0]
            table = {name: actions[self._base.index(name)] for name in self.agents}
            seen, earned, ended, cut, told = self.env.step(table)
            if self._filter.keeps_ledger:
                self._book(told)
            self._tell(told)
            for name in told:
                rewards[name] += earned[name]
            infos |= told
            terminations |= ended
            truncations |= cut
            observations |= seen
            self._remember(seen)
            if not self.agents:
                break
        return self._view(observations), rewards, terminations, truncations, infos

    def _tell(self, infos: Infos) -> None:
        """Add what the filter has to tell of the last base step."""
        for name, info in infos.items():
            i = self._base.index(name)
            info.update({key: values[0, i].item() for key, values in self._filter.told.items()})

    def _book(self, infos: Infos) -> None:
        """Tell the filter how the base step went."""
        simulator = self._base.simulator
        contact = np.zeros((1, simulator.scenario.n_robots), dtype=np.bool_)
        for name, info in infos.items():
            contact[0, self._base.index(name)] = info["contact"]
        self._filter.book(contact, simulator.merged_into)

    def _remember(self, observations: Observations) -> None:
        """Note what the robots see now; those that are gone see nothing."""
        self._observed = np.zeros(self._observed.shape, dtype=np.float32)
        for name, rows in observations.items():
            self._observed[0, self._base.index(name)] = rows.reshape(self._observed.shape[2:])

    def _view(self, observations: Observations) -> Observations:
        """What the robots see, as the policy is shown it."""
        seen = as_told(self._filter.view(self._observed)[0], self._base.flatten)
        return {name: seen[self._base.index(name)].copy() for name in observations}

    def get_state(self) -> dict[str, Any]:
        """The running episode and the wrapper's memory, as copies."""
        return {
            "env": self._base.get_state(),
            self._memory: self._filter.get_state(),
            "observed": self._observed.copy(),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Put back what ``get_state`` took out.

        Raises:
            ValueError: naming what does not fit; nothing has changed then.
        """
        self._observed = restore(self._base, self._memory, self._filter, self._observed, state)
