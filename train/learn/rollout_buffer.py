"""PPO over robots that may be gone: an explicit mask, and one value estimate for all time-outs."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from rendezvous_env.adapters.sb3 import RobotVecEnv

_SAMPLES = ("observations", "actions", "values", "log_probs", "advantages", "returns")


class RobotRolloutBuffer(RolloutBuffer):
    """A rollout buffer that gives out no samples of robots that were gone.

    At a time-out and at a merge it adds γ V(o) to the reward, with o the slot's
    ``bootstrap_observations``; all slots of a step are valued in one call of the network.
    """

    mask: NDArray[np.bool_]
    """(steps, slots), whose robot took part in the step."""
    _robots: RobotVecEnv | None = None
    _policy: ActorCriticPolicy

    def follow(self, robots: RobotVecEnv, policy: ActorCriticPolicy) -> None:
        """Take masks and cut-off slots from these robots, and their values from this policy."""
        self._robots, self._policy = robots, policy

    def reset(self) -> None:
        """Empty the buffer."""
        super().reset()
        self.mask = np.ones((self.buffer_size, self.n_envs), dtype=np.bool_)

    def add(self, obs: Any, action: Any, reward: NDArray[np.float32], *more: Any) -> None:
        """Add the step that the robots have just done; arguments as in stable-baselines3."""
        if self._robots is not None:
            self.mask[self.pos] = self._robots.acted
            reward = reward + self.gamma * self._values_of_cut_off(self._robots)
        super().add(obs, action, reward, *more)

    def _values_of_cut_off(self, robots: RobotVecEnv) -> NDArray[np.float32]:
        """V(o) of the slots that the last step cut off, 0 of the others, (slots,)."""
        values = np.zeros(self.n_envs, dtype=np.float32)
        if robots.bootstrapped.size:
            with torch.no_grad():
                seen = torch.as_tensor(robots.bootstrap_observations, device=self.device)
                estimates = self._value_of(seen, robots)
            values[robots.bootstrapped] = estimates.flatten().cpu().numpy()
        return values

    def _value_of(self, seen: torch.Tensor, robots: RobotVecEnv) -> torch.Tensor:
        """Values (k, 1) of what the slots in ``robots.bootstrapped`` saw last, (k, size)."""
        return self._policy.predict_values(seen)

    def get(self, batch_size: int | None = None) -> Generator[RolloutBufferSamples, None, None]:
        """The samples in random order, in batches of nearly equal size near ``batch_size``."""
        if not self.generator_ready:
            kept = self.swap_and_flatten(self.mask).reshape(-1)
            for name in _SAMPLES:
                setattr(self, name, self.swap_and_flatten(getattr(self, name))[kept])
            self.generator_ready = True
        order = np.random.permutation(len(self.returns))
        batches = 1 if batch_size is None else max(1, round(len(order) / batch_size))
        for indices in np.array_split(order, batches):
            yield self._get_samples(indices)


class RobotPPO(PPO):
    """PPO on a RobotVecEnv: samples of gone robots are left out, time-outs valued in one call.

    Arguments as ``stable_baselines3.PPO``. The environment may be wrapped; rewards may be
    normalised, observations not.
    """

    buffer_class: ClassVar[type[RobotRolloutBuffer]] = RobotRolloutBuffer
    rollout_buffer: RobotRolloutBuffer

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        with warnings.catch_warnings():  # our buffer gives batches of nearly equal size
            warnings.filterwarnings("ignore", message="You have specified a mini-batch size")
            super().__init__(*arguments, **settings)

    def _setup_model(self) -> None:
        self.rollout_buffer_class = self.buffer_class
        super()._setup_model()

    def get_memory(self) -> dict[str, NDArray[Any]]:
        """What the network remembers of running episodes, by name."""
        return {}

    def set_memory(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Put back what ``get_memory`` took out."""

    def collect_rollouts(self, env: VecEnv, *how: Any, **more: Any) -> bool:
        """Collect as PPO does, with the buffer following the robots.

        Raises:
            TypeError: if the environment is no RobotVecEnv, or its observations are normalised.
        """
        robots: Any = env.unwrapped
        if not isinstance(robots, RobotVecEnv):
            raise TypeError(f"RobotPPO needs a RobotVecEnv; it has a {type(robots).__name__}")
        if isinstance(env, VecNormalize) and env.norm_obs:
            raise TypeError("observations are unit vectors; use VecNormalize(norm_obs=False)")
        self.rollout_buffer.follow(robots, self.policy)
        robots.tell_bootstraps = False
        try:
            return super().collect_rollouts(env, *how, **more)
        finally:
            robots.tell_bootstraps = True
