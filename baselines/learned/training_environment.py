"""Training environment of learned policies: base controller, features, and contact penalty."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.spaces import Box, MultiDiscrete
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import check_int, number, raise_invalid
from rendezvous_env.engine.batch_runner import BatchController
from rendezvous_env.engine.state_checks import check_keys
from rendezvous_env.envs.spaces import team_box
from rendezvous_env.envs.training import charge_first_contacts
from rendezvous_env.envs.vector_env import Info, RendezvousVectorEnv
from rendezvous_env.envs.vector_wrappers import GuaranteeWrapper
from rendezvous_env.limits import MAX_HELD_STEPS
from rendezvous_env.rewards.terms import RewardWeights
from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.simulator import Simulator

from ..steering import can_steer
from .base_controller import make_controller
from .features import FeatureLayout
from .policy_settings import PolicySettings
from .shipped import POLICIES, preset


def observation_box(size: int) -> Box:
    """Observation space of one robot, with the given number of features."""
    return Box(-np.inf, np.inf, (size,), dtype=np.float32)


class FeatureVectorEnv(GuaranteeWrapper):
    """Vector environment with features as observations and choices as actions.

    Actions are choices (B, n), each repeated for ``decision_period`` steps. Observations, also the
    last of an episode, are (B, n, layout.size).

    Args:
        env: environments of any robot model but double integrators, in any autoreset mode.
        settings: settings of the trained policy.
        contact_penalty: penalty for a robot's first contact in an episode, as in
            ``TrainingVectorEnv``.
        own_progress: reward of a robot for its own share of the decrease of V, see ``shares_of``.
        obstacle_slots: as ``Features``, with its errors.
        global_state: features for critics, appended to the observations; None appends none. It has
            a ``size``, the number per robot, and ``states(simulator, f, levels)``, (B, n, size).
            f_i is (B, n, 2), of any length, in the robots' own frames; levels are A/(r D̄), (B, n).
        discrete: False takes directions (B, n, 2) in place of choices, see ``BaseController.head``.
    """

    def __init__(
        self,
        env: RendezvousVectorEnv,
        settings: PolicySettings,
        *,
        contact_penalty: float = 0.0,
        own_progress: float = 0.0,
        obstacle_slots: int | None = None,
        global_state: Any = None,
        discrete: bool = True,
    ) -> None:
        scenario, n = env.scenario, env.scenario.n_robots
        threads = env.simulator.num_threads
        self.settings, self.global_state, self.discrete = settings, global_state, discrete
        self.controller = controller = make_controller(
            settings, scenario, env.num_envs, obstacle_slots=obstacle_slots, num_threads=threads
        )
        super().__init__(env, controller.steering, settings.decision_period(scenario))
        more = 0 if global_state is None else global_state.size
        self.single_observation_space = team_box(observation_box(self.layout.size + more), n)
        self.single_action_space = (
            MultiDiscrete([settings.choices] * n)
            if discrete
            else Box(-1.0, 1.0, (n, 2), dtype=np.float32)
        )
        self.contact_penalty, self.own_progress = float(contact_penalty), float(own_progress)
        self._touched = np.zeros((env.num_envs, n), dtype=np.bool_)
        self._shown = np.zeros((env.num_envs, *self.single_observation_space.shape), np.float32)

    @property
    def layout(self) -> FeatureLayout:
        """Layout of a robot's features."""
        return self.controller.perception.layout

    @property
    def alignment(self) -> NDArray[np.float64]:
        """Alignment of the headings with f in the last step, (B, n); NaN where undefined."""
        return self.controller.steering.alignment

    def _step_decision(self) -> tuple[NDArray[np.float32] | None, Any, Any, Any, Info]:
        """Steps of one decision, with own progress and the penalty for first contacts."""
        base: Any = self.env
        before = base.simulator.positions.copy() if self.own_progress else None
        view, rewards, ends, cuts, infos = super()._step_decision()
        if before is not None:
            shares = self.own_progress * shares_of(base.simulator, before)
            infos["robot_rewards"] += shares
            rewards = rewards + shares.mean(axis=1)
        contact, penalty = infos["contact"], self.contact_penalty
        rewards = charge_first_contacts(penalty, contact, self._touched, rewards, infos)
        return view, rewards, ends, cuts, infos

    def _take(self, actions: ArrayLike) -> None:
        (self.controller.choose if self.discrete else self.controller.head)(actions)

    @property
    def _controller(self) -> BatchController | None:
        return self.controller

    def _act(self) -> NDArray[np.float32]:
        return self.controller.apply(self._observed)

    def _view(self, which: NDArray[np.bool_] | None) -> NDArray[np.float32]:
        size = self.layout.size
        self.controller.show(self._shown[..., :size], self._observed, which)
        if self.global_state is not None:
            base: Any = self.env
            towards = base.scenario.observation_layout.net_bearing(self._observed)
            if self.settings.guarantee == "none":
                towards = np.zeros_like(towards)  # features have x along the body
            tank, nothing = self.controller.tank, np.zeros(self._touched.shape)
            levels = nothing if tank is None else tank.normalised_levels
            state = self.global_state.states(base.simulator, towards, levels)
            mine = slice(None) if which is None else which
            self._shown[mine, :, size:] = state[mine]
        return self._shown.copy() if which is None else self._shown

    def _forget(self, which: NDArray[np.bool_] | None) -> None:
        self.controller.forget(which)
        self._touched[slice(None) if which is None else which] = False

    def set_state(self, state: Mapping[str, Any]) -> None:
        """As ``GuaranteeWrapper.set_state``."""
        check_keys(state, tuple(self._parts))
        super().set_state({"shown": self._shown, **state})  # older versions did not store it

    @property
    def _arrays(self) -> dict[str, NDArray[Any]]:
        # a partial reset observes the other environments again
        return super()._arrays | {"touched": self._touched, "shown": self._shown}

    @property
    def _parts(self) -> dict[str, Any]:
        bodies = self.controller.bodies
        parts = super()._parts | {"perception": self.controller.perception}
        return parts if bodies is None else parts | {"bodies": bodies}


def shares_of(simulator: Simulator, before: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of each robot in the decrease of V since its position, (B, n), of mean 1 per episode.

        s_i = n/V(0) (p_i − p_i⁻) · (f_i + f_i⁻),   f_i = Σ_j a_ij (p_j − p_i)/‖p_j − p_i‖

    f_i⁻ is that at the positions ``before``, (B, n, d). Merged robots have none.
    """
    now, weights, start = simulator.positions, simulator.weights, simulator.initial_lyapunov
    pull = sum(_pull(points, weights) for points in (before, now))
    gained = np.einsum("bid,bid->bi", now - before, pull) * simulator.active
    scale = now.shape[1] / np.where(start > 0.0, start, np.inf)
    shares: NDArray[np.float64] = gained * scale[:, np.newaxis]
    return shares


def _pull(points: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """f_i at points (B, n, d), with weights (B, n, n)."""
    apart = points[:, np.newaxis] - points[:, :, np.newaxis]
    length = np.linalg.norm(apart, axis=-1)
    along = weights / np.where(length > 0.0, length, np.inf)
    pull: NDArray[np.float64] = np.einsum("bij,bijd->bid", along, apart)
    return pull


class ShippedPreset:
    """Preset of ``training_env``: observations, actions and rewards of the shipped policies."""

    def earnings(self, guarantee: str | None) -> tuple[RewardWeights, float]:
        """Reward, and penalty for a robot's first contact."""
        return preset(guarantee).reward, preset(guarantee).contact_penalty

    def shows(self, scenario: Scenario, guarantee: str | None) -> bool:
        """True if observations and actions are those of this guarantee's shipped policy."""
        return guarantee in POLICIES and can_steer(scenario)

    def held_arguments(self, scenario: Scenario, guarantee: str) -> dict[str, Any]:
        """Arguments of the guarantee's wrapper if observations and actions are not the preset's.

        The decision period is that of the shipped policy. A tank has its budget in units of r D̄
        and an observed stored energy.
        """
        settings = preset(guarantee, scenario).settings
        held: dict[str, Any] = {"decision_period": settings.decision_period(scenario)}
        if guarantee == "tank":
            held |= {"budget": settings.budget_of(scenario), "observe_level": True}
        return held

    def wrap(
        self,
        env: RendezvousVectorEnv,
        guarantee: str,
        discrete: bool,
        arguments: Mapping[str, Any],
    ) -> FeatureVectorEnv:
        """Wrap environments with the observations and actions of the policy "heading" or "tank".

        ``arguments`` are those of the guarantee's wrapper: min_alignment, decision_period (steps),
        and max_turn_rate or budget (m²/s).

        Raises:
            ValueError: for another argument, or an invalid value.
        """
        scenario, own = env.scenario, {"heading": "max_turn_rate", "tank": "budget"}[guarantee]
        changes: dict[str, Any] = {}
        for key, value in arguments.items():
            if key == "decision_period":
                changes["decision_time"] = check_int(key, value, 1, MAX_HELD_STEPS) * scenario.tau
            elif key == "budget" and key == own:
                changes[key] = number(key, value, 0.0) / unit_of_tanks(scenario)
            elif key in ("min_alignment", own):
                changes[key] = number(key, value)
            else:
                raise_invalid(
                    key, value, "omitted: the learning preset sets it, unless learning_preset=False"
                )
        settings = replace(preset(guarantee, scenario).settings, **changes)
        return FeatureVectorEnv(env, settings, discrete=discrete)
