"""Training environments for generic learners, with a fixed agent set."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from ..checks import choice, flag, number, raise_invalid, to_float
from ..deprecation import renamed_arguments, renamed_attribute, warn_renamed
from ..engine.state_checks import check_entries, check_keys
from ..rewards.terms import RewardWeights
from ..safety.safety_filter import FILTERS
from ..safety.settings import bounded_error
from ..safety.theorems.certificate import certificate
from ..scenario.scenario import Scenario
from ..scenario.scenarios import ScenarioLike, resolve
from ..scenario.start_options import as_options
from .guarantee import component_mask, settings_of
from .gymnasium_env import make_vec
from .overrides import sorted_overrides
from .vector_env import Info, RendezvousVectorEnv, Transition, drop_summary, final_value
from .vector_wrappers import (
    EnergyTankWrapper,
    GainWrapper,
    GuaranteeWrapper,
    HeadingVectorWrapper,
    LinkKeepingWrapper,
)

WRAPPERS: dict[str, Any] = {
    "heading": HeadingVectorWrapper,
    "tank": EnergyTankWrapper,
    "gains": GainWrapper,
    "links": LinkKeepingWrapper,
}
"""Wrapper class by guarantee: theorems C, D, G and R."""
_LOGGER = logging.getLogger("rendezvous_env")
_warned: set[tuple[Scenario, str, bool]] = set()
_logged: set[tuple[RewardWeights, float]] = set()
_presets: list[Callable[[], Any]] = []


def register_preset(load: Callable[[], Any]) -> None:
    """Register the loader of ``learning_preset``, an object like ``ShippedPreset``.

    The environment itself does not depend on any policy.
    """
    _presets[:] = [load]


@renamed_arguments(touch_penalty="contact_penalty")
def training_env(
    scenario: ScenarioLike = "clutter-8",
    num_envs: int = 1,
    *,
    guarantee: str | None = "heading",
    learning_preset: bool = True,
    flatten: bool = True,
    discrete: bool = False,
    render_mode: str | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    num_threads: int | None = None,
    max_cycles: int | None = None,
    contact_penalty: float | None = None,
    **overrides: Any,
) -> TrainingVectorEnv:
    """Create B environments for a generic learner, as a Gymnasium vector environment.

    Merged robots remain until the end with zero observations, ineffective actions and the team
    reward (``on_merge="follow"``). Otherwise a learner that treats termination as the end of all
    reward would be penalised for early merges. Infos have the same keys in every step.

    ``learning_preset`` sets the reward that the shipped policies were trained with
    (``baselines.learned.shipped``), with a cost of 1 for each robot's first contact. Under
    "heading" or "tank", it also sets their observations, actions and decision period of 0.6 s.
    Double integrators are excluded. In 3-D, actions lie in a plane that contains f:

    | | |
    |---|---|
    | observations | output of ``Features``, (B, n, size); split by ``env.layout.split`` |
    | actions | (B, n, 2) in [−1, 1]: new direction of f, in a frame with x along f |
    | actions, ``discrete`` | (B, n): index of an angle φ in ``learned.policy_settings``; 0: φ = 0 |

    An action is an assumed direction of f. The merged-intervals rule starts from it to avoid
    obstacles, and the safety filter maps the result to an admissible action. The length is ignored;
    the zero vector keeps f, which is the rule itself. Other robots and guarantees have no shipped
    policy. They use the observations and actions of the guarantee wrapper, also with action repeat
    of 0.6 s. "tank" then has the budget of the shipped policy and ``observe_level``.

    | argument | |
    |---|---|
    | guarantee | "heading" (theorem C), "tank" (D), "gains" (G), "links" (R), a registered filter |
    | | (``register_filter``), or None: base actions. The logger "rendezvous_env" warns once if |
    | | the certificate does not cover the scenario, or needs a ``bearing_error`` that is not set |
    | learning_preset | see above; False keeps the plain wrapper and the scenario's reward |
    | flatten | whether rows are (B, n, rows·d); the output of ``Features`` is flat |
    | discrete | whether robots choose among the angles of the shipped policy |
    | contact_penalty | cost of a robot's first contact; None is 1 with the preset, else 0 |
    | reward | replaces weights of the preset. A dict, or weights with only ``custom`` terms (here |
    | | or in the scenario), are merged with the preset. A ``RewardWeights`` with built-in |
    | | weights replaces the preset. The reward in use is logged at level INFO |
    | others | arguments of ``make_vec`` and the guarantee wrapper, fields of the scenario |

    Raises:
        TypeError: for an unknown argument or field; the message gives the closest known one.
        ValueError: for an invalid argument; the message gives its value and a remedy.
    """
    own: list[str] = []
    if guarantee is not None:
        own = ["decision_period", *settings_of(FILTERS[choice("guarantee", guarantee, FILTERS)])]
    arguments, changes = sorted_overrides(training_env, own, overrides)
    if changes.setdefault("on_merge", "follow") != "follow":
        raise_invalid("on_merge", changes["on_merge"], "'follow' in a training environment")
    chosen = resolve(scenario, **changes)
    preset, shown, penalty = None, False, 0.0
    if flag("learning_preset", learning_preset) and _presets:
        preset = _presets[0]()
        reward, penalty = preset.earnings(guarantee)
        reward = _merged(reward, changes.get("reward"), chosen.reward)
        chosen = chosen if reward == chosen.reward else chosen.replace(reward=reward)
        shown = preset.shows(chosen, guarantee)
        if guarantee is not None and not shown:
            arguments = preset.held_arguments(chosen, guarantee) | arguments
    if not flag("flatten", flatten) and shown:
        raise_invalid(
            "flatten", flatten, "True, or learning_preset False: the output of Features is flat"
        )
    if flag("discrete", discrete) and not shown:
        raise_invalid(
            "discrete",
            discrete,
            "False: discrete actions need learning_preset True, guarantee 'heading' or 'tank', "
            "and robots other than double integrators",
        )
    env: Any = make_vec(
        chosen, num_envs, autoreset_mode, num_threads, max_cycles, render_mode, flatten
    )
    if guarantee is not None:
        if preset is not None and shown:
            env = preset.wrap(env, guarantee, discrete, arguments)
        elif guarantee in WRAPPERS:
            env = WRAPPERS[guarantee](env, **arguments)
        else:
            env = GuaranteeWrapper(env, guarantee, **arguments)
    if contact_penalty is not None:
        penalty = number("contact_penalty", contact_penalty)
    _warn_if_uncertified(chosen, guarantee, arguments)  # after all errors
    if (chosen.reward, penalty) not in _logged:
        _logged.add((chosen.reward, penalty))
        reward = chosen.reward.to_plain()
        _LOGGER.info("training_env: reward in use: %s, contact_penalty %g", reward, penalty)
    return TrainingVectorEnv(env, penalty)


def _merged(preset: RewardWeights, given: Any, reward: RewardWeights) -> RewardWeights:
    """Reward in use, from the preset's, the argument as given, and the scenario's.

    The scenario's reward already includes the argument.
    """
    if isinstance(given, Mapping):
        return replace(preset, **{name: getattr(reward, name) for name in given})
    explicit = given is not None and not reward.custom  # even if these are the defaults
    if explicit or reward.built_in != RewardWeights().built_in:
        return reward
    return replace(preset, custom=reward.custom)


def _warn_if_uncertified(
    scenario: Scenario, guarantee: str | None, arguments: Mapping[str, Any]
) -> None:
    """Log a warning, once per scenario, if the guarantee does not apply, with the reason."""
    if guarantee is None or guarantee not in WRAPPERS:
        return
    settings = inspect.signature(FILTERS[guarantee]).parameters
    own, given = bounded_error(scenario.sensing, scenario.dim), arguments.get("bearing_error", 0.0)
    too_small = "bearing_error" in settings and to_float(given) < own
    plain = scenario.replace(reward=RewardWeights(), allow_long_step=True)
    if (plain, guarantee, too_small) in _warned:
        return
    _warned.add((plain, guarantee, too_small))
    known = inspect.signature(certificate).parameters
    asked = {key: value for key, value in arguments.items() if key in known}
    if "min_alignment" in settings:
        asked.setdefault("min_alignment", settings["min_alignment"].default)
    found = certificate(scenario, by=guarantee, **asked)
    lacks = [] if found.guaranteed else [found.theorem.removeprefix("none: ")]
    lacks += [f"pass bearing_error={own}, the maximum bearing error here, in rad"] * too_small
    if lacks:
        words = (
            "training_env(guarantee=%r): training works, but no rendezvous is certified in %r: %s"
        )
        _LOGGER.warning(words, guarantee, scenario.name, "; ".join(lacks))


class TrainingVectorEnv(gymnasium.vector.VectorWrapper):
    """B environments in which all robots act and receive rewards until the end of the episode.

    Created by ``training_env``.

    ``infos["robot_rewards"]``, (B, n), are robot rewards, minus ``contact_penalty`` in the step of
    a robot's first contact in an episode. ``rewards``, (B,), is the team reward minus the mean of
    these costs. It equals the mean robot reward, except for custom terms (docs/rewards.md). The
    other infos are those of ``RendezvousVectorEnv`` and of the guarantee wrapper, with the same
    keys in every step. ``final_obs`` and ``final_info`` occur only with SAME_STEP.

    Args:
        env: vector environment whose scenario has ``on_merge="follow"``.
        contact_penalty: subtracted from ``robot_rewards``, once per episode.
    """

    env: RendezvousVectorEnv | GuaranteeWrapper

    touch_penalty = renamed_attribute("touch_penalty", "contact_penalty")
    teams = renamed_attribute("teams", "unwrapped")

    @renamed_arguments(teams="env", touch_penalty="contact_penalty")
    def __init__(
        self, env: RendezvousVectorEnv | GuaranteeWrapper, contact_penalty: float = 0.0
    ) -> None:
        super().__init__(env)
        base = env.unwrapped
        assert isinstance(base, RendezvousVectorEnv)
        self._base, self.simulator, self.scenario = base, base.simulator, base.scenario
        self.autoreset_mode = base.autoreset_mode
        self.layout: Any = getattr(env, "layout", self.scenario.observation_layout)
        """Layout that splits observations (``split``): of the scenario, or of ``Features``.
        Remove the last row, which ``observe_level`` adds, first."""
        self.contact_penalty = contact_penalty
        self._touched = np.zeros((env.num_envs, self.scenario.n_robots), dtype=np.bool_)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Info]:
        """As ``RendezvousVectorEnv.reset``."""
        observations, infos = self.env.reset(seed=seed, options=options)
        mask = as_options(options).get("reset_mask")
        self._touched[slice(None) if mask is None else np.asarray(mask)] = False
        drop_summary(infos)
        return observations, infos

    def step(self, actions: ArrayLike) -> Transition:
        """Step with actions of all robots; errors as the guarantee wrapper."""
        seen, rewards, ends, cuts, infos = self.env.step(actions)  # type: ignore[arg-type]
        over = ends | cuts
        contact = final_value(infos, over, "contact")
        rewards = charge_first_contacts(
            self.contact_penalty, contact, self._touched, rewards, infos
        )
        self._touched[over] = False
        if "final_info" in infos:
            infos["final_info"]["robot_rewards"] = infos["robot_rewards"].copy()
            drop_summary(infos["final_info"])
        drop_summary(infos)
        return seen, rewards, ends, cuts, infos

    @property
    def action_mask(self) -> NDArray[np.bool_] | None:
        """True for action components that a robot has, (n, a); None if all have all."""
        return component_mask(self.env)

    def state(self) -> NDArray[np.float32]:
        """As ``RendezvousVectorEnv.state``."""
        return self._base.state()

    def get_state(self) -> dict[str, Any]:
        """Copies of the running episodes and all memory."""
        return {"env": self.env.get_state(), "touched": self._touched.copy()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """As ``Simulator.set_state``."""
        check_keys(state, ("env", "touched"), exactly=True)
        touched = check_entries({"touched": self._touched}, state)["touched"]
        self.env.set_state(state["env"])
        self._touched[...] = touched


def charge_first_contacts(
    penalty: float,
    contact: NDArray[np.bool_],
    touched: NDArray[np.bool_],
    rewards: NDArray[Any],
    infos: Info,
) -> NDArray[Any]:
    """Subtract the cost of each robot's first contact from ``robot_rewards``; update ``touched``.

    Returns the team rewards, (B,), minus the mean cost.
    """
    first = contact & ~touched
    if not first.any():
        return rewards
    touched |= first
    if penalty == 0.0:
        return rewards
    infos["robot_rewards"] -= penalty * first
    return rewards - penalty * first.mean(axis=1)


def __getattr__(name: str) -> Any:
    """Former names."""
    if name == "TrainingTeams":
        warn_renamed(name, "TrainingVectorEnv")
        return TrainingVectorEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
