"""PPO with masked samples of merged robots and one batched value estimate at truncation.

An update of a ``HeadingNetwork`` computes its loss in one pass and sums the gradient over parts of
a batch that fit the processor's cache. Threads compute whole parts: none waits for another within
an operation, and the sum does not depend on their number.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.utils import explained_variance
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch import Tensor

from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.compilation import kernel

from .networks import HeadingNetwork

_SAMPLES = ("observations", "actions", "values", "log_probs", "advantages", "returns")
_MEASURED = ("policy_gradient_loss", "value_loss", "entropy_loss", "approx_kl", "clip_fraction")


class RobotRolloutBuffer(RolloutBuffer):
    """Rollout buffer that excludes samples of merged robots.

    At a time-out and at a merge it adds γ V(o) to the reward, with o the slot's
    ``bootstrap_observations``; one call of the network values all slots of a step.
    """

    mask: NDArray[np.bool_]  # (steps, slots), whose robot took part in the step
    tables: ClassVar[tuple[str, ...]] = _SAMPLES  # in the order of ``RolloutBufferSamples``
    part_size = 1024  # steps whose gradient is computed at once
    _robots: RobotVecEnv
    _policy: ActorCriticPolicy

    def follow(self, robots: RobotVecEnv, policy: ActorCriticPolicy) -> None:
        """Set the robots that provide masks and truncation, and the policy that values them."""
        self._robots, self._policy = robots, policy

    def reset(self) -> None:
        """Empty the buffer in place."""
        if not hasattr(self, "mask"):
            super().reset()
            self.mask = np.ones((self.buffer_size, self.n_envs), dtype=np.bool_)
        self.mask[...], self.pos, self.full = True, 0, False

    def add(self, obs: Any, action: Any, reward: Any, *others: Any) -> None:
        """Add the last step of the robots; arguments as in stable-baselines3."""
        robots, future = self._robots, np.zeros(self.n_envs, dtype=np.float32)
        self.mask[self.pos] = robots.acted
        if robots.bootstrapped.size:
            with torch.no_grad():
                seen = torch.as_tensor(robots.bootstrap_observations, device=self.device)
                future[robots.bootstrapped] = self._value_of(seen).flatten().cpu().numpy()
        super().add(obs, action, reward + self.gamma * future, *others)

    def _value_of(self, seen: Tensor) -> Tensor:
        """Values (k, 1) of the last observations (k, size) of truncated slots."""
        return self._policy.predict_values(seen)

    def begin(self, normalise: bool = False) -> None:
        """Convert the rollout to tensors; ``normalise`` its advantages over all samples."""
        found = {name: torch.as_tensor(getattr(self, name)) for name in self.tables}
        if normalise:
            every = found["advantages"][torch.as_tensor(self.mask)]
            found["advantages"] = (found["advantages"] - every.mean()) / (every.std() + 1e-8)
        self._found = {name: self._laid_out(t).to(self.device) for name, t in found.items()}

    def _laid_out(self, table: Tensor) -> Tensor:
        return table.flatten(0, 1)

    def _samples_of(self) -> tuple[NDArray[np.int64], int]:
        """Indices of all samples, and the number of steps in each."""
        return np.flatnonzero(self.mask), 1

    def batches(self, batch_size: int | None = None) -> Iterator[tuple[Tensor, ...]]:
        """Sample indices in random order, in batches of about ``batch_size`` steps, in parts."""
        samples, length = self._samples_of()
        order = torch.as_tensor(np.random.permutation(samples))
        batches = 1 if batch_size is None else round(length * len(order) / batch_size)
        for batch in order.tensor_split(min(max(1, batches), len(order))):
            on_cpu = self.device.type == "cpu"
            parts = round(length * len(batch) / self.part_size) if on_cpu else 1
            yield batch.to(self.device).tensor_split(min(max(1, parts), len(batch)))

    def samples(self, which: Tensor) -> RolloutBufferSamples:
        """Samples with the given indices, after ``begin``."""
        return RolloutBufferSamples(*(t.index_select(0, which) for t in self._found.values()))

    def get(self, batch_size: int | None = None) -> Iterator[RolloutBufferSamples]:  # type: ignore[override]
        """Samples in random order, in batches of about ``batch_size``."""
        self.begin()
        for parts in self.batches(batch_size):
            yield self.samples(torch.cat(parts))


class RobotPPO(PPO):
    """PPO on a RobotVecEnv, which may be wrapped.

    Samples of merged robots are excluded and truncated slots are valued in one call. Rewards may be
    normalised, observations may not.
    """

    buffer_class: ClassVar[type[RobotRolloutBuffer]] = RobotRolloutBuffer
    rollout_buffer: RobotRolloutBuffer

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        with warnings.catch_warnings():  # this buffer makes batches of nearly equal size
            warnings.filterwarnings("ignore", message="You have specified a mini-batch size")
            super().__init__(*arguments, **settings)

    def _setup_model(self) -> None:
        self.rollout_buffer_class = self.buffer_class
        super()._setup_model()

    def collect_rollouts(self, env: VecEnv, *how: Any, **more: Any) -> bool:
        """As PPO, with masks from the robots; a TypeError for any other environment."""
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

    def _update_info_buffer(self, infos: Any, dones: Any = None) -> None:
        told = [slot for slot, info in enumerate(infos) if info]  # few infos have them
        super()._update_info_buffer([infos[slot] for slot in told], dones[told])


class HeadingPPO(RobotPPO):
    """``RobotPPO`` for a ``HeadingNetwork``.

    Advantages are normalised over an update, not over each batch; target_kl and clip_range_vf have
    no effect.
    """

    policy: HeadingNetwork

    def get_memory(self) -> dict[str, NDArray[Any]]:
        """Recurrent state of the network, by name."""
        return {}

    def set_memory(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state of ``get_memory``."""

    def train(self) -> None:
        """Update the network from the rollout, as PPO does."""
        policy, buffer = self.policy, self.rollout_buffer
        self._update_learning_rate(policy.optimizer)
        clip: float = self.clip_range(self._current_progress_remaining)  # type: ignore[operator]
        rule, told = LossCoefficients(clip, self.vf_coef, self.ent_coef), []
        buffer.begin(self.normalize_advantage)
        with side_by_side(self.device) as each:
            for _ in range(self.n_epochs):
                batches = buffer.batches(self.batch_size)
                told += [self._descend(parts, rule, each) for parts in batches]
                self._n_updates += 1
        for name, number in zip(_MEASURED, np.mean(told, axis=0).tolist(), strict=True):
            self.logger.record(f"train/{name}", number)
        fitted = explained_variance(buffer.values[buffer.mask], buffer.returns[buffer.mask])
        self.logger.record("train/explained_variance", fitted)

    def _descend(
        self, parts: Sequence[Tensor], rule: LossCoefficients, each: Callable[..., Any]
    ) -> NDArray[np.float64]:
        """One optimizer step; returns batch means, in the order of ``_MEASURED``."""
        weights = list(self.policy.parameters())

        def slopes_by_weight(which: Tensor) -> tuple[list[Tensor], NDArray[np.float64]]:
            samples = self.rollout_buffer.samples(which)
            judged = self.policy.judged(samples.observations)
            slopes, sums = slopes_of(judged, samples, rule)
            return list(torch.autograd.grad(judged, weights, slopes)), sums

        (total, sums), *others = each(slopes_by_weight, parts)
        for gradient, more in others:
            torch._foreach_add_(total, gradient)
            sums += more
        count, *measured = sums
        torch._foreach_div_(total, float(count))
        for weight, gradient in zip(weights, total, strict=True):
            weight.grad = gradient
        torch.nn.utils.clip_grad_norm_(weights, self.max_grad_norm)
        self.policy.optimizer.step()
        return np.array(measured) / count


@contextmanager
def side_by_side(device: torch.device) -> Iterator[Callable[..., Iterator[Any]]]:
    """Parallel ``map`` on as many threads as torch uses for one operation."""
    threads = torch.get_num_threads()
    if device.type != "cpu" or threads == 1:
        yield map
        return
    torch.set_num_threads(1)
    try:
        with ThreadPoolExecutor(threads) as pool:
            yield pool.map
    finally:
        torch.set_num_threads(threads)


class LossCoefficients(NamedTuple):
    """Coefficients of the PPO loss."""

    clip_range: float
    value_weight: float
    entropy_weight: float


def slopes_of(
    judged: Sequence[Tensor], samples: RolloutBufferSamples, rule: LossCoefficients
) -> tuple[list[Tensor], NDArray[np.float64]]:
    """Gradients of the summed loss w.r.t. logits (N, choices) and values (N, 1); N and sums."""
    slopes = [torch.empty(tensor.shape) for tensor in judged]
    sums = np.zeros(1 + len(_MEASURED))
    given = [tensor.detach().cpu().contiguous().numpy() for tensor in (*judged, *samples[1:])]
    _slopes(*given[:2], tuple(given[2:]), rule, *(slope.numpy() for slope in slopes), sums)
    return [slope.to(judged[0].device) for slope in slopes], sums


@kernel
def _slopes(preferences, values, samples, rule, by_preference, by_value, sums):
    """Gradients of the loss of N samples, with r the probability ratio and A the advantage.

    loss = c_v (v − R)² − min(r A, clip(r) A) − c_e H,   H = −Σ p log p
    """
    actions, _, old_log_probs, advantages, returns = samples
    one = np.float32(1.0)
    for i in range(len(values)):
        likeliest = preferences[i, 0]
        for j in range(1, preferences.shape[1]):
            likeliest = max(likeliest, preferences[i, j])
        total = np.float32(0.0)
        for j in range(preferences.shape[1]):
            by_preference[i, j] = math.exp(preferences[i, j] - likeliest)
            total += by_preference[i, j]
        log_total, entropy = likeliest + math.log(total), np.float32(0.0)
        for j in range(preferences.shape[1]):
            by_preference[i, j] /= total
            entropy -= by_preference[i, j] * (preferences[i, j] - log_total)
        chosen, advantage = int(actions[i, 0]), advantages[i]
        log_ratio = preferences[i, chosen] - log_total - old_log_probs[i]
        ratio = math.exp(log_ratio)
        clipped = min(max(ratio, one - rule.clip_range), one + rule.clip_range)
        gain = min(ratio * advantage, clipped * advantage)
        slope = 0.0 if (ratio - clipped) * advantage > 0.0 else -ratio * advantage
        for j in range(preferences.shape[1]):
            p, log_p = by_preference[i, j], preferences[i, j] - log_total
            by_preference[i, j] = p * (rule.entropy_weight * (log_p + entropy) - slope)
        by_preference[i, chosen] += slope
        error = values[i, 0] - returns[i]
        by_value[i, 0] = 2.0 * rule.value_weight * error
        sums[0] += 1.0
        sums[1] -= gain
        sums[2] += error * error
        sums[3] -= entropy
        sums[4] += ratio - one - log_ratio
        sums[5] += abs(ratio - one) > rule.clip_range
