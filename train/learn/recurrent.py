"""Recurrent PPO: a gated recurrent unit and whole sequences as samples."""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from rendezvous_env.baselines.learned.training_environment import FeatureVectorEnv
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from rendezvous_env.adapters.sb3 import RobotVecEnv

from .networks import GlobalFeatures, HeadingNetwork, SplitNetwork, network_settings
from .rollout_buffer import HeadingPPO, RobotRolloutBuffer
from .settings import Config


class Sequences(NamedTuple):
    """Rollouts of S robots over T decisions, evaluated by a recurrent network in one pass."""

    observations: Tensor  # (T, S, size)
    starts: Tensor  # (T, S), 1 where an episode began with this decision, else 0
    hidden: Tensor  # (S, units), memory before the first decision
    kept: Tensor  # (T, S), bool: decisions that are samples; the robot was merged in others


class RecurrentNetwork(SplitNetwork):
    """HeadingNetwork over (h, features), with h the recurrent state of a robot (Cho et al. 2014).

        h ← GRU(features, h),   h = 0 at the start of an episode and for an empty observation

    In forward passes the network stores h, of size ``units``, for all slots.
    """

    hidden: Tensor  # h of every slot, (slots, units); empty before ``begin``

    def __init__(self, *arguments: Any, units: int, **settings: Any) -> None:
        self.units = units  # needed by the layers that super() builds
        super().__init__(*arguments, **settings)
        self.begin(0)

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        self.memory = nn.GRUCell(self.features_extractor.local_dim, self.units)

    def begin(self, slots: int) -> None:
        """Reset the recurrent state for the given number of slots."""
        self.hidden = torch.zeros(slots, self.units, device=self.device)

    def forget(self, ended: Tensor) -> None:
        """Reset the recurrent state of slots whose episodes have ended, (slots,)."""
        self.hidden = self.hidden.masked_fill(ended[:, None], 0.0)

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Choices, values and log-probabilities of all slots; updates the recurrent state."""
        features: Any = self.extract_features(obs)
        self.hidden = self._next(features, obs, self.hidden)
        return self._chosen(torch.cat((self.hidden, features), dim=-1), deterministic)

    def predict_values(  # type: ignore[override]  # with a memory
        self, obs: Tensor, hidden: Tensor | None = None
    ) -> Tensor:
        """Values (N, 1) from recurrent states (N, units), by default the stored ones; no update."""
        features: Any = self.extract_features(obs)
        after = self._next(features, obs, self.hidden if hidden is None else hidden)
        latent = self.mlp_extractor.forward_critic(torch.cat((after, features), dim=-1))
        values: Tensor = self.value_net(latent)
        return values

    def judged(self, obs: Sequences) -> tuple[Tensor, Tensor]:
        """Logits and values of the stored samples."""
        each: Any = self.extract_features(obs.observations.flatten(0, 1))
        features = each.unflatten(0, obs.kept.shape)
        hidden, remembered = obs.hidden, []
        for t in range(len(features)):
            hidden = hidden.masked_fill(obs.starts[t, :, None] > 0, 0.0)
            hidden = self._next(features[t], obs.observations[t], hidden)
            remembered.append(hidden)
        return self._judged(torch.cat((torch.stack(remembered), features), dim=-1)[obs.kept])

    def _next(self, features: Tensor, obs: Tensor, hidden: Tensor) -> Tensor:
        """Recurrent state after these features; only local features are read."""
        is_shown = obs[..., : self.features_extractor.layout.size].any(dim=-1, keepdim=True)
        local = features[..., : self.features_extractor.local_dim]
        remembered: Tensor = self.memory(local, hidden)
        return remembered * is_shown


class SequenceBuffer(RobotRolloutBuffer):
    """Rollout buffer whose samples are whole rollouts of slots.

    Backpropagation stops at the start of a rollout, where the recurrent state is a constant. A
    merged slot is valued by the observation and recurrent state of its surviving agent.
    """

    tables = ("mask", "episode_starts", *RobotRolloutBuffer.tables)
    part_size = 4096
    _policy: RecurrentNetwork
    _hidden: Tensor  # memory of every slot before the rollout, (slots, units)

    def follow(self, robots: RobotVecEnv, policy: ActorCriticPolicy) -> None:
        """As ``RobotRolloutBuffer.follow``, at the start of a rollout."""
        super().follow(robots, policy)
        self._hidden = self._policy.hidden

    def add(self, *step: Any) -> None:
        """As ``RobotRolloutBuffer.add``; resets the recurrent state of slots that ended."""
        super().add(*step)
        self._policy.forget(torch.as_tensor(self._robots.ended, device=self.device))

    def _value_of(self, seen: Tensor) -> Tensor:
        return self._policy.predict_values(seen, self._policy.hidden[self._robots.survivors])

    def _laid_out(self, table: Tensor) -> Tensor:
        return table

    def _samples_of(self) -> tuple[NDArray[np.int64], int]:
        return np.flatnonzero(self.mask.any(axis=0)), self.buffer_size

    def samples(self, which: Tensor) -> RolloutBufferSamples:
        """Whole rollouts of the given slots."""
        chosen = (table.index_select(1, which) for table in self._found.values())
        kept, starts, observations, *numbers = chosen
        sequences = Sequences(observations, starts, self._hidden[which], kept)
        return RolloutBufferSamples(sequences, *(table[kept] for table in numbers))  # type: ignore[arg-type]


class RecurrentRobotPPO(HeadingPPO):
    """``HeadingPPO`` with a ``RecurrentNetwork``; the recurrent state is part of a checkpoint."""

    buffer_class: ClassVar[type[RobotRolloutBuffer]] = SequenceBuffer
    policy: RecurrentNetwork

    def _setup_model(self) -> None:
        super()._setup_model()
        self.policy.begin(self.n_envs)

    def collect_rollouts(self, env: VecEnv, *how: Any, **more: Any) -> bool:
        """As ``HeadingPPO``; resets the recurrent state of slots that start an episode."""
        self.policy.forget(torch.as_tensor(self._last_episode_starts, device=self.device))
        return super().collect_rollouts(env, *how, **more)

    def get_memory(self) -> dict[str, NDArray[Any]]:
        """Recurrent state of the robots, "hidden", (slots, units)."""
        return {"hidden": self.policy.hidden.cpu().numpy()}

    def set_memory(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state of ``get_memory``; a ValueError if the shape differs."""
        hidden, shape = state["hidden"], tuple(self.policy.hidden.shape)
        if hidden.shape != shape or not np.isfinite(hidden).all():
            raise ValueError(f"hidden has shape {hidden.shape}; it must be {shape}, and finite")
        self.policy.hidden = torch.tensor(hidden, device=self.device)


def learner_of(
    config: Config, env: FeatureVectorEnv
) -> tuple[type[HeadingPPO], type[HeadingNetwork], dict[str, Any]]:
    """Algorithm class, network class, and arguments of the network apart from its spaces."""
    usual = {"heading": 3.0, "tank": 0.0, "none": 0.0}[config.guarantee]
    prior = usual if config.prior is None else config.prior
    settings = network_settings(
        env.layout, set_width=config.set_width, hidden=config.hidden, prior=prior
    )
    network: type[HeadingNetwork] = HeadingNetwork
    if env.global_state is not None:
        network, settings["features_extractor_class"] = SplitNetwork, GlobalFeatures
        settings["features_extractor_kwargs"]["state"] = env.global_state
    if config.memory == "recurrent":
        return RecurrentRobotPPO, RecurrentNetwork, settings | {"units": config.memory_units}
    return HeadingPPO, network, settings
