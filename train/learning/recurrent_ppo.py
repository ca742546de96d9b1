"""PPO for robots that remember: whole sequences are its samples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.vec_env import VecEnv

from rendezvous_env.adapters.sb3 import RobotVecEnv

from .recurrent_network import RecurrentNetwork, Sequences
from .rollout_buffer import RobotPPO, RobotRolloutBuffer

_SAMPLES = ("actions", "values", "log_probs", "advantages", "returns")


class SequenceBuffer(RobotRolloutBuffer):
    """A rollout buffer that gives out the whole rollouts of some slots at a time.

    Gradients go back to the beginning of a rollout, and no further: what the robots remembered then
    is kept as a number. A slot that was merged away is valued by its survivor's observation and
    memory.
    """

    _policy: RecurrentNetwork
    _hidden: torch.Tensor
    """What every slot remembered before the rollout, (slots, units)."""

    def follow(self, robots: RobotVecEnv, policy: ActorCriticPolicy) -> None:
        """As ``RobotRolloutBuffer.follow``, at the beginning of a rollout."""
        super().follow(robots, policy)
        self._hidden = self._policy.hidden

    def add(self, *step: Any) -> None:
        """As ``RobotRolloutBuffer.add``; slots whose episode ended forget it."""
        super().add(*step)
        assert self._robots is not None
        self._policy.forget(torch.as_tensor(self._robots.ended, device=self.device))

    def _value_of(self, seen: torch.Tensor, robots: RobotVecEnv) -> torch.Tensor:
        return self._policy.predict_values(seen, self._policy.hidden[robots.survivors])

    def get(self, batch_size: int | None = None) -> Iterator[RolloutBufferSamples]:
        """The slots in random order, in batches of nearly equal size near ``batch_size`` steps."""
        if not self.generator_ready:
            self._tables = {name: getattr(self, name).copy() for name in _SAMPLES}
            for name in ("values", "returns"):  # what is told of the fit is told of samples
                setattr(self, name, getattr(self, name)[self.mask])
            self.generator_ready = True
        order = np.random.permutation(np.flatnonzero(self.mask.any(axis=0)))
        steps = self.buffer_size * len(order)
        batches = 1 if batch_size is None else max(1, round(steps / batch_size))
        for slots in np.array_split(order, min(batches, len(order))):
            yield self._of_slots(slots)

    def _of_slots(self, slots: NDArray[np.int64]) -> RolloutBufferSamples:
        kept = self.mask[:, slots]
        sequences = Sequences(
            observations=self.to_torch(self.observations[:, slots]),
            starts=self.to_torch(self.episode_starts[:, slots]),
            hidden=self._hidden[slots],
            kept=self.to_torch(kept),
        )
        actions, *numbers = (
            self.to_torch(table[:, slots][kept]) for table in self._tables.values()
        )
        return RolloutBufferSamples(sequences, actions, *numbers)  # type: ignore[arg-type]


class RecurrentRobotPPO(RobotPPO):
    """``RobotPPO`` with a ``RecurrentNetwork``, whose memory of running episodes is its state."""

    buffer_class: ClassVar[type[RobotRolloutBuffer]] = SequenceBuffer
    policy: RecurrentNetwork

    def _setup_model(self) -> None:
        super()._setup_model()
        self.policy.begin(self.n_envs)

    def collect_rollouts(
        self,
        env: VecEnv,
        callback: BaseCallback,
        rollout_buffer: RolloutBuffer,
        n_rollout_steps: int,
    ) -> bool:
        """As ``RobotPPO``; slots whose episodes begin with the rollout remember nothing."""
        self.policy.forget(torch.as_tensor(self._last_episode_starts, device=self.device))
        return super().collect_rollouts(env, callback, rollout_buffer, n_rollout_steps)

    def get_memory(self) -> dict[str, NDArray[Any]]:
        """What the robots remember, (slots, units)."""
        return {"hidden": self.policy.hidden.cpu().numpy()}

    def set_memory(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Put back what ``get_memory`` took out.

        Raises:
            ValueError: for another shape, or a number that is not finite.
        """
        hidden, shape = state["hidden"], tuple(self.policy.hidden.shape)
        if hidden.shape != shape or not np.isfinite(hidden).all():
            raise ValueError(f"hidden has shape {hidden.shape}; it must be {shape}, and finite")
        self.policy.hidden = torch.tensor(hidden, device=self.device)
