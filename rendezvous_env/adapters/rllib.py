"""RLlib (new API stack): an environment runner that steps all environments at once.

RLlib's own runners handle every robot of every step in Python. This runner stores a rollout as
arrays and splits it into episodes at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray
from ray.rllib.algorithms.algorithm_config import AlgorithmConfig
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.env import INPUT_ENV_SINGLE_SPACES, INPUT_ENV_SPACES
from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner
from ray.rllib.env.single_agent_episode import SingleAgentEpisode
from ray.rllib.utils.metrics import WEIGHTS_SEQ_NO
from ray.rllib.utils.spaces.space_utils import clip_action, unsquash_action
from ray.tune.registry import ENV_CREATOR, _global_registry, register_env

from ..deprecation import renamed_arguments
from ..scenario.scenarios import ScenarioLike
from ..state_view import STANDING
from ..vector import training_env
from .rllib_module import SetModule, sets_of
from .rllib_rollout import Rollout
from .slots import RobotSlots

ENVIRONMENT = "rendezvous"
"""RLlib's name for ``rendezvous_env.vector.training_env``."""


def _create(settings: Mapping[str, Any]) -> Any:
    arguments = {"wrap": lambda vector_env: vector_env, **settings}
    wrap = arguments.pop("wrap")
    return wrap(training_env(**arguments))


register_env(ENVIRONMENT, _create)


@renamed_arguments(num_teams="num_envs")
def configure(
    config: AlgorithmConfig,
    scenario: ScenarioLike,
    *,
    num_envs: int = 64,
    units: int = 64,
    wrap: Callable[[Any], Any] | None = None,
    **arguments: Any,
) -> AlgorithmConfig:
    """Configure an algorithm to train one set network shared by all robots.

    Args:
        config: algorithm config such as ``PPOConfig()``; modified and returned.
        scenario: this, further arguments and errors as in ``vector.training_env``.
        num_envs: B, environments per environment runner.
        units: width of the network.
        wrap: applies a custom ``VectorWrapper``, for example one that changes rewards.
        **arguments: arguments of the vector environment.
    """
    settings = {"scenario": scenario, **arguments}
    model = {"sets": sets_of(training_env(**settings).layout), "units": units}
    if wrap is not None:
        settings["wrap"] = wrap
    return (
        config.environment(ENVIRONMENT, env_config=settings)
        .env_runners(env_runner_cls=RobotEnvRunner, num_envs_per_env_runner=num_envs)
        .rl_module(rl_module_spec=RLModuleSpec(module_class=SetModule, model_config=model))
    )


class RobotEnvRunner(SingleAgentEnvRunner):
    """Environment runner for single-robot episodes from B environments of n robots.

    ``config.env`` creates a vector environment with SAME_STEP autoreset and B =
    ``num_envs_per_env_runner``. One step of one robot counts as one environment step. A robot's
    episode terminates at rendezvous; truncation and bootstrapping follow ``RobotSlots``. Episode
    returns and lengths in the results are those of environments, with their summary.

    ``config.debugging(seed=…)`` sets the seed s, which RLlib varies between runners and for
    evaluation. Environment b has the seed s · B + b.

    RLlib's env-to-module and module-to-env connectors and its callbacks for steps and episodes are
    not called, because they would run per robot. Sample callbacks are called. A configuration with
    custom connectors raises ValueError.
    """

    env: RobotSlots | None

    def make_env(self) -> None:
        """Create the vector environment."""
        for name in ("env_to_module_connector", "module_to_env_connector"):
            if getattr(self.config, f"_{name}") is not None:
                raise ValueError(
                    f"{name} is given; robots have none, wrap the environments instead"
                )
        if self.env is not None:
            self.env.close()
        creator, settings = self.config.env, dict(self.config.env_config)
        if isinstance(creator, str):
            creator = _global_registry.get(ENV_CREATOR, creator)
        vector_env: VectorEnv[Any, Any, Any] = creator(
            settings | {"num_envs": self.config.num_envs_per_env_runner}
        )
        self.env = RobotSlots(vector_env)
        self.num_envs = self.env.batch_size
        self._needs_initial_reset = True

    def get_spaces(self) -> Mapping[str, Any]:
        """Observation and action space of a robot, under RLlib's names."""
        if self.env is None:
            return self.spaces
        spaces = self.env.single_observation_space, self.env.single_action_space
        names = INPUT_ENV_SPACES, INPUT_ENV_SINGLE_SPACES, DEFAULT_MODULE_ID
        return dict.fromkeys(names, spaces)

    def make_module(self) -> None:
        """Create the network."""
        spec = self.config.get_rl_module_spec(spaces=self.get_spaces(), inference_only=True)
        self.module = spec.build().to(self._device)

    def _sample(
        self,
        *,
        num_timesteps: int | None = None,
        num_episodes: int | None = None,
        explore: bool,
        random_actions: bool = False,
        force_reset: bool = False,
    ) -> list[SingleAgentEpisode]:
        """Collect a number of robot steps or of environment episodes."""
        assert self.env is not None
        if force_reset or num_episodes is not None or self._needs_initial_reset:
            seed = None  # of environment 0; runners have consecutive seeds, B environments each
            if self._seed is not None and self._needs_initial_reset:
                seed = self._seed * self.num_envs
            self._rollout = Rollout(self.env, self.env.reset(seed))
            self._needs_initial_reset = num_episodes is not None
        rollout, finished = self._rollout, 0
        window = self.config.metrics_num_episodes_for_smoothing
        while (
            rollout.count < num_timesteps
            if num_timesteps is not None
            else finished < (num_episodes or 0)
        ):
            slots = np.flatnonzero(self.env.active)
            chosen = self._choose(rollout.observations[slots], explore, random_actions)
            step = rollout.add(slots, chosen, self._for_env(chosen[Columns.ACTIONS]))
            finished += len(step.finished)
            for episode in step.finished.values():
                self._log_episode_metrics(episode["length"], episode["return"], episode["time"])
                for name in STANDING:
                    self.metrics.log_value(name, float(episode[name]), window=window)
        taken = rollout.count
        self._log_env_steps(metric=self._metrics_num_env_steps_sampled, num_steps=taken)
        self._increase_sampled_metrics(taken, finished)
        return list(rollout.cut(only_ended=num_timesteps is None))

    def _choose(
        self, seen: NDArray[np.float32], explore: bool, random_actions: bool
    ) -> dict[str, NDArray[Any]]:
        """Module output columns for observations, including actions."""
        if random_actions or self.module is None:
            space = self.env.single_action_space  # type: ignore[union-attr]
            return {Columns.ACTIONS: np.stack([space.sample() for _ in seen])}
        module: Any = self.module
        batch = {Columns.OBS: torch.as_tensor(seen, device=self._device)}
        if explore:
            inputs = module.forward_exploration(batch)[Columns.ACTION_DIST_INPUTS]
            choice = module.get_exploration_action_dist_cls().from_logits(inputs)
        else:
            inputs = module.forward_inference(batch)[Columns.ACTION_DIST_INPUTS]
            choice = module.get_inference_action_dist_cls().from_logits(inputs).to_deterministic()
        actions = choice.sample()
        found = {
            Columns.ACTIONS: actions,
            Columns.ACTION_DIST_INPUTS: inputs,
            Columns.ACTION_LOGP: choice.logp(actions),
        }
        columns = {name: values.cpu().numpy() for name, values in found.items()}
        return columns | {WEIGHTS_SEQ_NO: np.full(len(seen), self._weights_seq_no)}

    def _for_env(self, actions: NDArray[Any]) -> NDArray[Any]:
        """Environment actions after ``normalize_actions`` and ``clip_actions``."""
        space = self.env.single_action_space  # type: ignore[union-attr]
        if isinstance(space, Box) and self.config.normalize_actions:
            return unsquash_action(actions, space)
        if isinstance(space, Box) and self.config.clip_actions:
            return clip_action(actions, space)
        return actions
