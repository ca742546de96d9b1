"""Guarantee wrappers for vector environments, the batched form of ``wrappers.py``."""

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
from .guarantee import (
    FilterWrapperMixin,
    GainSettings,
    HeadingSettings,
    LinkSettings,
    TankSettings,
    layers_of,
)
from .spaces import batched_space, maybe_flatten, team_box
from .vector_env import (
    Info,
    RendezvousVectorEnv,
    Transition,
    add_final_info,
    add_summary,
    masked,
)


class GuaranteeWrapper(FilterWrapperMixin, gymnasium.vector.VectorWrapper):
    """Vectorised ``rendezvous_env.GuaranteeWrapper``: actions (B, n, k), infos (B, n).

    Observations (B, n, rows, d) are the filter's view of the rows. The robots of an environment
    that ends within a decision period do not move for the rest of it; a reset clears its memory.
    ``env`` is a RendezvousVectorEnv from ``make_vec``, in any autoreset mode, wrapped or not.
    Wrappers beneath must not change observations, actions or the form of infos. They must step once
    per step and not reset; this is checked, as in ``rendezvous_env.GuaranteeWrapper``.

    Wrappers beneath, such as episode recorders, receive each base step. Their infos of a decision
    period are merged by the masks ``_key``: for each environment, the last reported ones. Steps of
    an ended environment have no effect: its rewards are not summed, and arrays (B, …) that are
    attributes of a wrapper are restored.
    """

    _base: RendezvousVectorEnv
    _wraps = gymnasium.vector.VectorEnv, RendezvousVectorEnv
    _wanted = (
        "a RendezvousVectorEnv, as from make_vec (for a PettingZoo environment use "
        "rendezvous_env.{})"
    )
    _changing = VectorObservationWrapper, VectorActionWrapper
    observation_space: Space[Any] = batched_space("single_observation_space")
    action_space: Space[Any] = batched_space("single_action_space")

    @staticmethod
    def _spaces_of(layer: Any, base: RendezvousVectorEnv) -> Any:
        return layer.single_observation_space, layer.single_action_space

    @staticmethod
    def _vector_env_of(base: RendezvousVectorEnv) -> RendezvousVectorEnv:
        return base

    def _make_spaces(self, observations: Box, choices: Box) -> None:
        metadata, n = self._base.metadata, self._base.scenario.n_robots
        rate = metadata["render_fps"] / self.decision_period  # an image for each decision
        self.metadata = metadata | {"render_fps": rate}
        self.single_observation_space = team_box(observations, n)
        self.single_action_space = team_box(choices, n)

    @property
    def action_mask(self) -> NDArray[np.bool_]:
        """True for action components that a robot has, (n, k), see ``SafetyFilter.choice_mask``."""
        return self.filter.choice_mask

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """Autoreset mode of the wrapped environment."""
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
        """As ``RendezvousVectorEnv.reset``; clears the memory of environments that are reset."""
        simulator = self._base.simulator
        up_to_date = self._seen == simulator.changes or not simulator.begun
        given = as_options(options)
        mask = given.get("reset_mask")  # before Gymnasium's RecordEpisodeStatistics removes it
        observations, infos = self.env.reset(seed=seed, options=given)
        self._check_infos(infos)
        self._observed = observations.reshape(self._observed.shape)
        if self._checks_passage:
            self._check_passage(None, self._observed, ...)
        which = None if mask is None else np.asarray(mask)
        if which is None or which.all() or up_to_date:
            self._note_seen()
        self._forget(which)
        reset = np.ones(self.num_envs, dtype=np.bool_) if which is None else which
        return self._view(which).copy(), infos | masked(self._diagnostics(), reset)

    def step(self, actions: ArrayLike) -> Transition:
        """Apply the actions (B, n, k) for ``decision_period`` steps; rewards are summed.

        Raises:
            ValueError: for a wrong shape, or naming the robot whose action is not finite.
        """
        self._check_seen()
        base, mode = self._base, self._base.autoreset_mode
        resting = None if base.simulator.all_running else base.simulator.ended
        self._take(actions)
        base.autoresets = False
        try:
            view, rewards, terminations, truncations, infos = self._step_decision()
        finally:
            base.autoresets = True
        self._note_seen()
        if resting is not None:
            terminations, truncations = terminations & ~resting, truncations & ~resting
        if resting is not None and mode is AutoresetMode.NEXT_STEP:
            self._autoreset(resting, infos)
            view = None
        ended = terminations | truncations
        observations = self._view(None) if view is None else maybe_flatten(view, base.flatten)
        if add_final_info(observations, ended, infos, mode):
            summed = self.filter.recalls(self._observed)
            self._autoreset(ended, infos)
            self._view_again(ended, observations)
            if summed:
                self.filter.recall_sums(self._observed)
        add_summary(infos)
        return observations, rewards, terminations, truncations, infos

    @property
    def _controller(self) -> BatchController | None:
        """Batch controller that runs within threads; None if every step runs in Python."""
        return self.filter if self.filter.supports_multi_step else None

    @property
    def _is_direct(self) -> bool:
        """True if there is no wrapper between this one and the base environment."""
        return type(self.env) is RendezvousVectorEnv

    def _step_decision(self) -> tuple[NDArray[np.float32] | None, Any, Any, Any, Info]:
        """Steps of one decision without autoreset.

        Returns the policy's observations (None if not computed), summed rewards, ends and infos.
        """
        base, controller, view, direct = self._base, self._controller, None, self._is_direct
        if direct and controller is not None and base.can_drive:
            view, callback = self._view_buffer()
            result = base.drive(controller, self._observed, self.decision_period, callback)
            self._observed = result.output.observations
            self.filter.recall_sums(self._observed)
            rewards, robot_rewards, contact = result[1:]
            costs: Info = {}
        else:
            rewards, robot_rewards, contact, costs, between, ends = self._step_singly()
        own = {"robot_rewards": robot_rewards, "contact": contact, **costs, **self._diagnostics()}
        _, _, terminations, truncations, infos = base.tell(**own)
        if not direct:
            terminations, truncations = ends | (terminations, truncations)
            infos |= {key: info for key, info in between.items() if key.lstrip("_") not in own}
        return view, rewards, terminations, truncations, infos

    def _view_buffer(self) -> tuple[NDArray[np.float32] | None, ObservationCallback | None]:
        """Buffer of the policy's observations and the function that fills it; None if unused."""
        made = self.filter
        view = made.new_view() if self._controller is made else None
        if view is None:
            return None, None
        return view, lambda part, observations: made.observe_calls(part, observations, view)

    def _step_singly(self) -> tuple[Any, Any, Any, Info, Info, NDArray[np.bool_]]:
        """Stepwise version: rewards, robot rewards, contacts, costs, infos and ends."""
        base, simulator, shape = self._base, self._base.simulator, self._observed.shape
        rewards, robot_rewards = np.zeros(self.num_envs), np.zeros(shape[:2])
        contact, between = np.zeros(shape[:2], dtype=np.bool_), Info()
        ends = np.zeros((2, self.num_envs), np.bool_)
        costs = no_costs(base.scenario.costs, shape[:2])
        follows = base.scenario.on_merge == "follow"
        direct, next_step = self._is_direct, base.autoreset_mode is AutoresetMode.NEXT_STEP
        for number in range(self.decision_period):
            resting = None if simulator.all_running else simulator.status != RUNNING
            if number:
                running = (simulator.status == RUNNING)[:, None]
                kept = DiagnosticsSnapshot(
                    self.filter.action_diagnostics, running & (follows | simulator.active)
                )
            if direct:
                outcome = base.advance(self._act())
                observations, reward = outcome.observations, outcome.rewards
                robot_reward, in_contact = outcome.robot_rewards, outcome.contact
                cost: Info = simulator.costs
            else:
                # NEXT_STEP resets in the first step of a decision
                ended_before = None if resting is None or (next_step and not number) else resting
                step = self._step_between(self._act(), ended_before)
                observations, reward, *ended, cost = step
                between = joined(between, cost)
                ends |= ended
                robot_reward = cost["robot_rewards"]
                assert base.outcome is not None  # there has been a step
                in_contact = base.outcome.contact
                if resting is not None:  # rewards that wrappers add after the end
                    reward = np.where(resting, 0.0, reward)
                    robot_reward = np.where(resting[:, None], 0.0, robot_reward)
            self._observed = observations.reshape(shape)
            if number:
                kept.restore()
            if self.filter.uses_feedback:
                self.filter.update(in_contact, simulator.copy_of_merged(), resting)
            rewards += reward
            robot_rewards += robot_reward
            contact |= in_contact
            for key, total in costs.items():
                total += cost[key]
        return rewards, robot_rewards, contact, costs, between, ends

    def _step_between(self, actions: NDArray[np.float32], ended: NDArray[np.bool_] | None) -> Any:
        """Make a base step through the wrappers beneath.

        It does not change their attributes in environments that have ``ended``, (B,).
        """
        simulator, given = self._base.simulator, actions.copy()
        acting = simulator.active & (simulator.status == RUNNING)[:, None]
        kept = None if ended is None else RowsOfWrappers(self.env, ended)
        returned = self._step_beneath(actions)
        if self._checks_passage:
            self._check_passage(given, returned[0].reshape(self._observed.shape), acting)
        if kept is not None:
            kept.put_back()
        return returned

    def _autoreset(self, which: NDArray[np.bool_], infos: Info) -> None:
        """Reset the given environments and update observations and infos."""
        fresh = self._base.autoreset(which, infos).reshape(self._observed.shape)
        self._observed[which] = fresh[which]
        self._forget(which)
        for key, values in self.filter.diagnostics.items():
            infos[key][which] = values[which]
        self._note_seen()

    def _diagnostics(self) -> Info:
        return {key: values.copy() for key, values in self.filter.diagnostics.items()}

    def _take(self, actions: ArrayLike) -> None:
        """Set the actions of this decision."""
        self.filter.hold(actions)

    def _act(self) -> NDArray[np.float32]:
        """Actions of the next step."""
        return self.filter.apply(self._observed)

    def _view(self, which: NDArray[np.bool_] | None) -> NDArray[np.float32]:
        """Writable observations of the policy, (B, n, ...), updated for a mask (None: all)."""
        view = self.filter.observe(self._observed)
        self.filter.recall_sums(self._observed)
        own = view.copy() if np.may_share_memory(view, self._observed) else view
        return maybe_flatten(own, self._base.flatten)

    def _view_again(self, which: NDArray[np.bool_], observations: NDArray[np.float32]) -> None:
        """Update the policy's observations of the given environments, which were reset."""
        made = self.filter
        if self._controller is made and made.changes_rows:
            shown = observations.reshape(*self._observed.shape[:2], -1, self._observed.shape[3])
            made.observe_again(which, self._observed, shown)
        else:
            observations[which] = self._view(which)[which]

    def _forget(self, which: NDArray[np.bool_] | None) -> None:
        """Clear the memory of the given environments (None: all)."""
        self.filter.forget(which)


class RowsOfWrappers:
    """Copies of the masked rows of all arrays (B, …) that are attributes of wrappers."""

    def __init__(self, env: Any, which: NDArray[np.bool_]) -> None:
        self._which = which
        self._kept = [
            (layer, name, values.copy())
            for layer in layers_of(env)
            if not isinstance(layer, RendezvousVectorEnv)
            for name, values in vars(layer).items()
            if isinstance(values, np.ndarray) and values.shape[:1] == which.shape
        ]

    def put_back(self) -> None:
        """Restore the rows, in new arrays."""
        for layer, name, before in self._kept:
            now = getattr(layer, name)
            if isinstance(now, np.ndarray) and now.shape == before.shape:
                now = now.copy()  # infos may share it
                now[self._which] = before[self._which]
                setattr(layer, name, now)


def joined(before: Info, after: Info) -> Info:
    """Merge the infos of two steps.

    Each environment has the latest with a True mask ``_key``, (B,). Infos without a mask are those
    of the later step.
    """
    found = before | after
    for key in before.keys() & after.keys():
        mask, earlier = after.get(f"_{key}"), before.get(f"_{key}")
        if mask is not None and earlier is not None and not mask.all():
            found[key] = _where(mask, after[key], before[key])
            found[f"_{key}"] = mask | earlier
    return found


def _where(mask: NDArray[np.bool_], values: Any, others: Any) -> Any:
    """Rows of arrays (B, …) where the mask is True, else those of ``others``.

    Dicts are merged recursively; other values are returned unchanged.
    """
    if isinstance(values, dict) and isinstance(others, dict):
        both = values.keys() & others.keys()
        return others | values | {key: _where(mask, values[key], others[key]) for key in both}
    if not (isinstance(values, np.ndarray) and values.shape[:1] == mask.shape):
        return values
    if np.shape(others) != values.shape:
        return values
    return np.where(mask.reshape(-1, *[1] * (values.ndim - 1)), values, others)


class HeadingVectorWrapper(HeadingSettings, GuaranteeWrapper):
    """Batched ``rendezvous_env.HeadingVectorWrapper``: raw vectors (B, n, k) in [−1, 1]."""


class EnergyTankWrapper(TankSettings, GuaranteeWrapper):
    """Batched ``rendezvous_env.EnergyTankWrapper``: desired velocities (B, n, a) in [−1, 1].

    The stored energy of a merged robot is 0; a reset restores the budget.
    """


class GainWrapper(GainSettings, GuaranteeWrapper):
    """Batched ``rendezvous_env.GainWrapper``: weights (B, n, K) in [0, 1]."""


class LinkKeepingWrapper(LinkSettings, GuaranteeWrapper):
    """Batched ``rendezvous_env.LinkKeepingWrapper``: desired velocities (B, n, d) in [−1, 1]."""
