"""Centralised training, decentralised execution: a critic that also reads the global state."""

from __future__ import annotations

from typing import Any

import torch
from gymnasium.spaces import Box
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import Tensor

from baselines.learned.perception_layout import PerceptionLayout

from .global_state import CONTEXT_COLUMNS, OBSTACLE_COLUMNS, ROBOT_COLUMNS, GlobalStateLayout
from .networks import HeadingNetwork, SetFeatures, pooled, row_network


class GlobalFeatures(SetFeatures):
    """``SetFeatures`` and, behind them, those of the global state that follows what is shown.

    Args:
        observation_space: of (layout.size + state.size,) numbers.
        layout: of what is shown.
        width: of the networks that read one row.
        state: layout of the global state.
    """

    def __init__(
        self,
        observation_space: Box,
        layout: PerceptionLayout,
        width: int,
        state: GlobalStateLayout,
    ) -> None:
        super().__init__(observation_space, layout, width)
        self.state = state
        self.team_net = row_network(ROBOT_COLUMNS, width)
        self.field_net = row_network(OBSTACLE_COLUMNS, width)
        self._features_dim += 4 * width + CONTEXT_COLUMNS

    def forward(self, observations: Tensor) -> Tensor:
        """Features (N, features_dim); the first ``local_dim`` of them are the actor's."""
        local = super().forward(observations[..., : self.layout.size])
        state = self.state.split(observations[..., self.layout.size :])
        robots = pooled(self.team_net, state.robots)
        obstacles = pooled(self.field_net, state.obstacles)
        return torch.cat((local, *robots, *obstacles, state.context), dim=-1)


class _Split(MlpExtractor):
    """Actor and critic of which the actor reads the first features only."""

    def __init__(self, actor_dim: int, critic_dim: int, **arguments: Any) -> None:
        super().__init__(critic_dim, **arguments)
        self._actor_dim = actor_dim
        self.policy_net = MlpExtractor(actor_dim, **arguments).policy_net

    def forward_actor(self, features: Tensor) -> Tensor:
        """What the choice is made of."""
        return super().forward_actor(features[..., : self._actor_dim])


class SplitNetwork(HeadingNetwork):
    """A HeadingNetwork whose critic may read more than its actor."""

    units = 0
    """Numbers of a memory, ahead of the features of both."""
    features_extractor: SetFeatures

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = _Split(
            self.units + self.features_extractor.local_dim,
            self.units + self.features_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )
