"""What every vector wrapper with a guarantee does: choices are held, a filter makes actions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Space
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from ..engine.memory import RENDEZVOUS, RUNNING, TIME_OUT
from ..experiment.start_options import as_options
from ..guarantee.action_filter import ActionFilter
from ..outcome import Outcome
from .holding import check_period, restore
from .infos import Info, Transition, masked, of_all, step_info, summary_of
from .overrides import NamesUnknownArguments
from .spaces import as_told, choice_box, filtered_observation_box, team_box
from .vector_env import RendezvousVectorEnv


def check_ours(env: Any, wrapper: str) -> RendezvousVectorEnv:
    """The environment that is wrapped, if it is one of ours.

    Args:
        env: what was given.
        wrapper: the name of the class that wraps it.

    Raises:
        TypeError: for another kind of environment.
    """
    if isinstance(env, RendezvousVectorEnv):
        return env
    raise TypeError(
        f"env is a {type(env).__name__}; it must be a RendezvousVectorEnv, as make_vec "
        f"makes one (for a PettingZoo environment take rendezvous_env.{wrapper})"
    )


class VectorFilterWrapper(NamesUnknownArguments, gymnasium.vector.VectorWrapper):
    """Teams choose; for ``decision_period`` base steps a filter makes actions of it.

    Args:
        env: a RendezvousVectorEnv, in any autoreset mode.
        action_filter: of its teams.
        memory: what the filter's part of the state is called.
        decision_period: base steps for which a choice is held.

    Raises:
        ValueError: for a bad ``decision_period``.
    """

    env: RendezvousVectorEnv

    def __init__(
        self,
        env: RendezvousVectorEnv,
        action_filter: ActionFilter,
        memory: str,
        decision_period: int,
    ) -> None:
        super().__init__(env)
        self.decision_period = check_period(decision_period)
        rate = env.metadata["render_fps"] / self.decision_period  # a picture for each decision
        self.metadata = env.metadata | {"render_fps": max(1, round(rate))}
        self._filter, self._memory = action_filter, memory
        n = env.scenario.n_robots
        observed = filtered_observation_box(action_filter, env.flatten)
        self.single_observation_space = team_box(observed, n)
        self.single_action_space = team_box(choice_box(action_filter), n)
        shape = (env.num_envs, n, *env.scenario.observation_layout.shape)
        self._observed = np.zeros(shape, dtype=np.float32)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """When a team that has ended begins anew."""
        return self.env.autoreset_mode

    def state(self) -> NDArray[np.float32]:
        """The privileged global state of every team, (B, …), as ``RendezvousVectorEnv.state``."""
        return self.env.state()

    @cached_property
    def observation_space(self) -> Space[Any]:  # type: ignore[override]
        """Of all teams."""
        return batch_space(self.single_observation_space, self.num_envs)

    @cached_property
    def action_space(self) -> Space[Any]:  # type: ignore[override]
        """Of all teams."""
        return batch_space(self.single_action_space, self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Info]:
        """Begin anew, as ``RendezvousVectorEnv.reset``; teams that do forget what was."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._observed = observations.reshape(self._observed.shape)
        which = as_options(options).get("reset_mask")
        if which is not None:
            which = np.asarray(which)
        self._forget(which)
        told = {key: values.copy() for key, values in self._filter.told.items()}
        reset = np.ones(self.num_envs, dtype=np.bool_) if which is None else which
        return self._see(which), infos | masked(told, reset)

    def step(self, actions: ArrayLike) -> Transition:
        """Hold the choices for ``decision_period`` base steps.

        Args:
            actions: choices (B, n, k).

        Returns:
            As ``RendezvousVectorEnv.step``, with the rewards of the base steps summed.

        Raises:
            ValueError: for a wrong shape, or naming the robot whose choice is not finite.
            RuntimeError: before the first reset.
        """
        env, simulator = self.env, self.env.simulator
        resting = simulator.ended
        self._take(actions)
        rewards, infos, outcome = self._drive()
        if env.autoreset_mode is AutoresetMode.NEXT_STEP and resting.any():
            self._begin_anew(resting, outcome, infos)
        terminations = simulator.status == RENDEZVOUS
        truncations = simulator.status == TIME_OUT
        ended = terminations | truncations
        summary = {"summary": summary_of(infos, ended)} if ended.any() else {}
        final: Info = {}
        seen = self._see(None)
        if env.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            final = _final(seen, ended, infos | summary)
            self._begin_anew(ended, outcome, infos)
            seen[ended] = self._see(ended)[ended]
            summary = {}
        infos = of_all(infos, self.num_envs) | masked(summary | final, ended)
        return seen, rewards, terminations, truncations, infos

    def _drive(self) -> tuple[NDArray[np.float64], Info, Outcome]:
        """Base steps under the held choices: summed rewards, bare infos, the last outcome."""
        simulator = self.env.simulator
        rewards = np.zeros(self.num_envs)
        robot_rewards = np.zeros(self._observed.shape[:2])
        contact = np.zeros(self._observed.shape[:2], dtype=np.bool_)
        for _ in range(self.decision_period):
            resting = None if simulator.all_running else simulator.status != RUNNING
            outcome = simulator.step(self._act())
            self.env.renderer.see(outcome.contact)
            self._observed = outcome.observations
            if self._filter.keeps_ledger:
                self._filter.book(outcome.contact, simulator.merged_into, resting)
            rewards += outcome.rewards
            robot_rewards += outcome.robot_rewards
            contact |= outcome.contact
        infos = step_info(simulator, outcome)
        infos |= {key: values.copy() for key, values in self._filter.told.items()}
        infos |= {"robot_rewards": robot_rewards, "contact": contact}
        return rewards, infos, outcome

    def _begin_anew(self, which: NDArray[np.bool_], outcome: Outcome, infos: Info) -> None:
        """Next episodes of these teams; what the robots see and what is told of them follows."""
        simulator = self.env.simulator
        simulator.restart(which, outcome)
        self._forget(which)
        infos |= {"merged_into": simulator.merged_into, **simulator.standing(outcome)}
        infos["contact"][which] = False
        for key, values in self._filter.told.items():
            infos[key][which] = values[which]

    def _take(self, actions: ArrayLike) -> None:
        """Take the decisions of this period."""
        self._filter.hold(actions)

    def _act(self) -> NDArray[np.float32]:
        """Actions of the next base step."""
        return self._filter.act(self._observed)

    def _see(self, which: NDArray[np.bool_] | None) -> NDArray[np.float32]:
        """What the policy sees, (B, n, ...); only teams of the mask, None is all, saw more."""
        return as_told(self._filter.view(self._observed), self.env.flatten)

    def _forget(self, which: NDArray[np.bool_] | None) -> None:
        """These teams, None is all, begin anew."""
        self._filter.forget(which)

    def get_state(self) -> dict[str, Any]:
        """The running episodes and the wrapper's memory, as copies."""
        return {
            "env": self.env.get_state(),
            self._memory: self._filter.get_state(),
            "observed": self._observed.copy(),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Put back what ``get_state`` took out.

        Raises:
            ValueError: naming what does not fit; nothing has changed then.
        """
        self._observed = restore(self.env, self._memory, self._filter, self._observed, state)


def _final(seen: NDArray[np.float32], ended: NDArray[np.bool_], infos: Info) -> Info:
    """How these teams ended and what they saw last, in Gymnasium's form."""
    final_obs = np.full(len(ended), None, dtype=object)
    for team in np.flatnonzero(ended).tolist():
        final_obs[team] = seen[team].copy()
    kept = {key: value.copy() for key, value in infos.items()}
    return {"final_obs": final_obs, "final_info": masked(kept, ended)}
