"""stable-baselines3 wrappers and buffer for slots whose robots may merge.

| stable-baselines3 | over a ``RobotVecEnv`` | replacement |
|---|---|---|
| ``VecMonitor`` | counts slots of merged robots as episodes | ``RobotMonitor`` |
| ``VecFrameStack`` | mixes frames of a merged robot and its survivor | ``RobotFrameStack`` |
| ``VecNormalize(norm_obs=True)`` | counts zero rows of merged robots | ``RobotNormalize`` |
| ``ReplayBuffer`` (SAC, TD3, DQN) | keeps samples of merged robots | ``RobotReplayBuffer`` |

``VecNormalize(norm_obs=False)`` also counts the zero rewards of merged robots. ``VecCheckNan``,
``VecExtractDictObs`` and ``VecVideoRecorder`` need no replacement. The ``RolloutBuffer`` of a stock
algorithm keeps samples of merged robots; ``RobotPPO`` of ``train.learn`` does not.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecFrameStack, VecMonitor, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from ..checks import raise_invalid
from .sb3 import RobotVecEnv

__all__ = ["RobotFrameStack", "RobotMonitor", "RobotNormalize", "RobotReplayBuffer"]


def _robots_of(venv: VecEnv, wrapper: Any) -> RobotVecEnv:
    """Slots beneath a wrapper; TypeError if there are none."""
    robots = venv.unwrapped
    if not isinstance(robots, RobotVecEnv):
        found, name = type(robots).__name__, type(wrapper).__name__
        raise TypeError(f"{name} is for a RobotVecEnv, wrapped or not; it has a {found}")
    return robots


class RobotMonitor(VecMonitor):
    """``VecMonitor`` that counts and records the episodes of environments.

    These are the ``info["episode"]`` dicts of ``RobotVecEnv``, which are passed on unchanged. They
    provide these ``info_keywords``: "success", "time", "contacts", "path_length" and "lyapunov".
    """

    def __init__(
        self, venv: VecEnv, filename: str | None = None, info_keywords: tuple[str, ...] = ()
    ) -> None:
        _robots_of(venv, self)
        with warnings.catch_warnings():  # no attribute of the environment is overwritten
            warnings.filterwarnings("ignore", message="The environment is already wrapped")
            super().__init__(venv, filename, info_keywords)

    def step_wait(self) -> VecEnvStepReturn:
        """As ``RobotVecEnv.step_wait``."""
        observations, rewards, dones, infos = self.venv.step_wait()
        for info in infos:
            if "episode" in info:
                self.episode_count += 1
                episode = info["episode"]
                row = {key: episode[key] for key in ("r", "l", "t")}
                known = episode | info
                row |= {key: known[key] for key in self.info_keywords}
                if self.results_writer:
                    self.results_writer.write_row(row)
        return observations, rewards, dones, infos


class RobotFrameStack(VecFrameStack):
    """``VecFrameStack`` with the survivor's stack as ``terminal_observation`` at a merge."""

    def __init__(self, venv: VecEnv, n_stack: int, channels_order: Any = None) -> None:
        self._robots = _robots_of(venv, self)
        super().__init__(venv, n_stack, channels_order)

    def step_wait(self) -> Any:
        """As ``RobotVecEnv.step_wait``, with stacked observations."""
        observations, rewards, dones, infos = super().step_wait()
        robots = self._robots
        pairs = zip(robots.bootstrapped.tolist(), robots.survivors.tolist(), strict=True)
        for slot, survivor in pairs if robots.tell_bootstraps else ():
            if slot != survivor:
                own: Any = observations[survivor]
                last = infos[survivor]["terminal_observation"] if dones[survivor] else own
                infos[slot]["terminal_observation"] = last.copy()
        return observations, rewards, dones, infos


class RobotNormalize(VecNormalize):
    """``VecNormalize`` with statistics of active robots only.

    They cover observations of active robots and returns of robots that acted. Slots of merged
    robots still observe zeros.
    """

    def __init__(self, venv: VecEnv, *arguments: Any, **settings: Any) -> None:
        _robots_of(venv, self)
        super().__init__(venv, *arguments, **settings)

    @property
    def _active(self) -> NDArray[np.bool_]:
        return _robots_of(self.venv, self).slots.active.reshape(-1)

    def reset(self) -> Any:
        """Start a new episode in all environments."""
        observations: Any = self.venv.reset()
        self.old_obs = observations
        self.returns = np.zeros(self.num_envs)
        return self._normalised(observations)

    def step_wait(self) -> Any:
        """As ``RobotVecEnv.step_wait``, with normalised observations and rewards."""
        stepped: Any = self.venv.step_wait()
        observations, rewards, dones, infos = stepped
        self.old_obs, self.old_reward = observations, rewards
        seen = self._normalised(observations)
        if self.training:
            self._update_reward(rewards)
        for info in infos:
            if "terminal_observation" in info:
                info["terminal_observation"] = self.normalize_obs(info["terminal_observation"])
        self.returns[dones] = 0
        return seen, self.normalize_reward(rewards), dones, infos

    def _normalised(self, observations: Any) -> Any:
        """Normalise observations (slots, ...) and update the statistics."""
        active = self._active
        rms: Any = getattr(self, "obs_rms", None)
        if self.training and self.norm_obs and active.any():
            rms.update(observations[active])
        seen: Any = self.normalize_obs(observations)
        seen[~active] = 0.0
        return seen

    def _update_reward(self, reward: NDArray[Any]) -> None:
        acted = _robots_of(self.venv, self).acted
        self.returns = self.returns * self.gamma + reward
        if acted.any():
            self.ret_rms.update(self.returns[acted])


class RobotReplayBuffer(ReplayBuffer):
    """``ReplayBuffer`` that excludes steps of merged robots, by ``info["acted"]``.

    Use ``SAC("MlpPolicy", robots, replay_buffer_class=RobotReplayBuffer)``. ``n_steps`` must be 1.
    ValueError for ``optimize_memory_usage``.
    """

    mask: NDArray[np.bool_]
    """Robots that acted in the step, (steps, slots)."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        if self.optimize_memory_usage:
            raise_invalid(
                "optimize_memory_usage", True, "False: a merge is valued by the survivor's rows"
            )
        self.mask = np.zeros((self.buffer_size, self.n_envs), dtype=np.bool_)

    def add(self, obs: Any, next_obs: Any, action: Any, reward: Any, done: Any, infos: Any) -> None:
        """Add a step of all slots; arguments as in stable-baselines3."""
        self.mask[self.pos] = [info.get("acted", True) for info in infos]
        super().add(obs, next_obs, action, reward, done, infos)

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> ReplayBufferSamples:
        """Sample steps of robots that acted, uniformly with replacement."""
        kept = self.mask[: self.size()]
        if not kept.any():
            raise ValueError("the buffer has no step of a robot that acted; add steps first")
        steps, slots = np.empty((2, batch_size), dtype=np.int64)
        missing = np.ones(batch_size, dtype=np.bool_)
        # NumPy's global generator, as the base class: stable-baselines3 seeds it with the model
        while missing.any():
            steps[missing] = np.random.randint(0, len(kept), size=missing.sum())
            slots[missing] = np.random.randint(0, self.n_envs, size=missing.sum())
            missing = ~kept[steps, slots]
        ends = self.dones[steps, slots] * (1 - self.timeouts[steps, slots])
        data = (
            self._normalize_obs(self.observations[steps, slots], env),
            self.actions[steps, slots],
            self._normalize_obs(self.next_observations[steps, slots], env),
            ends.reshape(-1, 1),
            self._normalize_reward(self.rewards[steps, slots].reshape(-1, 1), env),
        )
        return ReplayBufferSamples(*map(self.to_torch, data))
