"""Guarantees for vector environments: the wrappers of ``wrappers.py`` for B teams at once."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Space
from gymnasium.vector import AutoresetMode, VectorActionWrapper, VectorObservationWrapper
from numpy.typing import ArrayLike, NDArray

from ..engine.batch_runner import BatchController, DiagnosticsSnapshot, ObservationCallback
from ..engine.memory import RUNNING
from ..rewards.costs import no_costs
from ..scenario.start_options import as_options
from .guarantee import GainSettings, HeadingSettings, HoldsFilter, LinkSettings, TankSettings
from .spaces import as_told, of_all_teams, team_box
from .vector_env import (
    Info,
    RendezvousVectorEnv,
    Transition,
    leave_out_summary,
    masked,
    tell_ends,
)


class GuaranteeWrapper(HoldsFilter, gymnasium.vector.VectorWrapper):
    """``rendezvous_env.GuaranteeWrapper`` in arrays: choices (B, n, k), infos (B, n), and
    observations (B, n, rows, d) as the filter shows them.

    A team that ends within a decision period stands still for the rest of it; a reset clears its
    memory. ``env`` is a RendezvousVectorEnv in any autoreset mode, as ``make_vec`` makes one, or
    one in wrappers of Gymnasium's that change neither observations nor actions nor the form of
    infos, step once a step and do not reset.
    """

    _base: RendezvousVectorEnv
    _wraps = gymnasium.vector.VectorEnv, RendezvousVectorEnv
    _wanted = (
        "a RendezvousVectorEnv, as make_vec makes one (for a PettingZoo environment take "
        "rendezvous_env.{})"
    )
    _changing = VectorObservationWrapper, VectorActionWrapper
    observation_space: Space[Any] = of_all_teams("single_observation_space")
    action_space: Space[Any] = of_all_teams("single_action_space")

    def _make_spaces(self, observations: Box, choices: Box) -> None:
        metadata, n = self._base.metadata, self._base.scenario.n_robots
        rate = metadata["render_fps"] / self.decision_period  # a picture for each decision
        self.metadata = metadata | {"render_fps": max(1, round(rate))}
        self.single_observation_space = team_box(observations, n)
        self.single_action_space = team_box(choices, n)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """When a team that has ended is reset."""
        return self._base.autoreset_mode

    def state(self) -> NDArray[np.float32]:
        """As ``RendezvousVectorEnv.state``."""
        return self._base.state()

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Info]:
        """As ``RendezvousVectorEnv.reset``; it clears the memory of the teams that are reset."""
        simulator = self._base.simulator
        knows_others = self._seen == simulator.changes or not simulator.begun
        given = as_options(options)
        mask = given.get("reset_mask")  # before Gymnasium's recorder of statistics takes it out
        observations, infos = self.env.reset(seed=seed, options=given)
        self._observed = observations.reshape(self._observed.shape)
        which = None if mask is None else np.asarray(mask)
        if which is None or which.all() or knows_others:
            self._note_seen()
        self._forget(which)
        reset = np.ones(self.num_envs, dtype=np.bool_) if which is None else which
        return self._see(which).copy(), infos | masked(self._told(), reset)

    def step(self, actions: ArrayLike) -> Transition:
        """Hold the choices (B, n, k) for ``decision_period`` base steps; rewards are summed. A
        ValueError for a wrong shape, or naming the robot whose choice is not finite.
        """
        self._check_seen()
        base, mode = self._base, self._base.autoreset_mode
        resting = None
        if mode is AutoresetMode.NEXT_STEP and not base.simulator.all_running:
            resting = base.simulator.ended
        self._take(actions)
        base.begins_anew = False
        try:
            shown, rewards, terminations, truncations, infos = self._drive()
        finally:
            base.begins_anew = True
        self._note_seen()
        if resting is not None:
            self._begin_anew(resting, infos)
            terminations, truncations = terminations & ~resting, truncations & ~resting
            shown = None
        ended = terminations | truncations
        seen = self._see(None) if shown is None else as_told(shown, base.flatten)
        if ended.any() and tell_ends(seen, ended, infos, mode):
            self._begin_anew(ended, infos)
            seen[ended] = self._see(ended)[ended]
        return seen, rewards, terminations, truncations, infos

    @property
    def _pilot(self) -> BatchController | None:
        """What computes actions within threads; None where each step is Python's."""
        return self.filter if self.filter.supports_multi_step else None

    def _drive(self) -> tuple[NDArray[np.float32] | None, Any, Any, Any, Info]:
        """Base steps under the held choices, in which no team is reset: the policy's observations
        after them, None if they are still to be computed, summed rewards, ends, and infos.
        """
        base, pilot, shown = self._base, self._pilot, None
        alone = type(self.env) is RendezvousVectorEnv  # nobody between hears of base steps
        if alone and pilot is not None and base.can_drive:
            shown, show = self._viewing()
            driven = base.drive(pilot, self._observed, self.decision_period, show)
            self._observed = driven.output.observations
            rewards, robot_rewards, contact = driven[1:]
            costs: Info = {}
        else:
            rewards, robot_rewards, contact, costs, between, ends = self._drive_by_steps()
        own = {"robot_rewards": robot_rewards, "contact": contact, **costs, **self._told()}
        _, _, terminations, truncations, infos = base.tell(**own)
        if not alone:
            terminations, truncations = ends | (terminations, truncations)
            infos |= {key: told for key, told in between.items() if key.lstrip("_") not in own}
            leave_out_summary(infos)
        return shown, rewards, terminations, truncations, infos

    def _viewing(self) -> tuple[NDArray[np.float32] | None, ObservationCallback | None]:
        """Memory for the policy's observations, and a function that fills it for some teams; None
        where it sees base observations, or something else.
        """
        made = self.filter
        shown = made.new_view() if self._pilot is made else None
        if shown is None:
            return None, None
        return shown, lambda part, observations: made.observe_calls(part, observations, shown)

    def _drive_by_steps(self) -> tuple[Any, Any, Any, Info, Info, NDArray[np.bool_]]:
        """The same step by step: rewards, robot rewards, contacts, costs, and the infos and ends of
        which wrappers between told in any step.
        """
        base, simulator, shape = self._base, self._base.simulator, self._observed.shape
        rewards, robot_rewards = np.zeros(self.num_envs), np.zeros(shape[:2])
        contact, between = np.zeros(shape[:2], dtype=np.bool_), Info()
        ends = np.zeros((2, self.num_envs), np.bool_)
        costs = no_costs(base.scenario.costs, shape[:2])
        follows = base.scenario.on_merge == "follow"
        for number in range(self.decision_period):
            resting = None if simulator.all_running else simulator.status != RUNNING
            if number:
                running = (simulator.status == RUNNING)[:, None]
                kept = DiagnosticsSnapshot(
                    self.filter.action_diagnostics, running & (follows | simulator.active)
                )
            if type(self.env) is RendezvousVectorEnv:
                outcome = base.advance(self._act())
                seen, earned = outcome.observations, outcome.rewards
                robots_earned, touched = outcome.robot_rewards, outcome.contact
                cost: Info = simulator.costs
            else:
                seen, earned, *ended, cost = self._step_beneath(self._act())
                between |= cost
                ends |= ended
                robots_earned, touched = cost["robot_rewards"], cost["contact"]
            self._observed = seen.reshape(shape)
            if number:
                kept.restore()
            if self.filter.uses_feedback:
                self.filter.update(touched, simulator.merged_into, resting)
            rewards += earned
            robot_rewards += robots_earned
            contact |= touched
            for key, total in costs.items():
                total += cost[key]
        return rewards, robot_rewards, contact, costs, between, ends

    def _begin_anew(self, which: NDArray[np.bool_], infos: Info) -> None:
        """Reset these teams, and bring observations and infos up to date."""
        fresh = self._base.begin_anew(which, infos).reshape(self._observed.shape)
        self._observed[which] = fresh[which]
        self._forget(which)
        for key, values in self.filter.diagnostics.items():
            infos[key][which] = values[which]
        self._note_seen()

    def _told(self) -> Info:
        return {key: values.copy() for key, values in self.filter.diagnostics.items()}

    def _take(self, actions: ArrayLike) -> None:
        """Take the choices of this period."""
        self.filter.hold(actions)

    def _act(self) -> NDArray[np.float32]:
        """Actions of the next base step."""
        return self.filter.apply(self._observed)

    def _see(self, which: NDArray[np.bool_] | None) -> NDArray[np.float32]:
        """The policy's observations, (B, n, ...), which it may write to, not what the filter acts
        on; only teams of the mask, None is all, are new.
        """
        seen = self.filter.observe(self._observed)
        own = seen.copy() if np.may_share_memory(seen, self._observed) else seen
        return as_told(own, self._base.flatten)

    def _forget(self, which: NDArray[np.bool_] | None) -> None:
        """Clear the memory of these teams, None is all."""
        self.filter.forget(which)


class HeadingVectorWrapper(HeadingSettings, GuaranteeWrapper):
    """``rendezvous_env.HeadingVectorWrapper`` in arrays: raw vectors (B, n, k) in [−1, 1]."""


class EnergyTankWrapper(TankSettings, GuaranteeWrapper):
    """``rendezvous_env.EnergyTankWrapper`` in arrays: desired velocities (B, n, a) in [−1, 1].

    The tank of a robot that is gone is 0; a team that is reset has its budget.
    """


class GainWrapper(GainSettings, GuaranteeWrapper):
    """``rendezvous_env.GainWrapper`` in arrays: weights (B, n, K) in [0, 1]."""


class LinkKeepingWrapper(LinkSettings, GuaranteeWrapper):
    """``rendezvous_env.LinkKeepingWrapper`` in arrays: desired velocities (B, n, d) in [−1, 1]."""
