"""Networks that read sets of bearings: any number of neighbours and obstacles, in any order."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, MlpExtractor
from torch import Tensor, nn

from .perception import (
    CONTEXT_COLUMNS,
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    Perceived,
    PerceptionLayout,
)

BASE_LENGTH = 0.8
"""Of the base heading as a raw vector: below 1, so that noise is rarely cut off at the bounds."""


class SetFeatures(BaseFeaturesExtractor):
    """Deep Sets: every row through one small network, then mean and largest over the set.

        features = (mean φ(g), max φ(g), mean ψ(s), max ψ(s), context)

    Absent (zero) rows do not count. The weights do not depend on the numbers of slots.

    Args:
        observation_space: of (layout.size,) numbers.
        layout: which of them is what.
        width: of φ and ψ.
    """

    def __init__(self, observation_space: Box, layout: PerceptionLayout, width: int) -> None:
        super().__init__(observation_space, features_dim=4 * width + CONTEXT_COLUMNS)
        self.layout = layout
        self.neighbour_net = _row_network(NEIGHBOUR_COLUMNS, width)
        self.obstacle_net = _row_network(OBSTACLE_COLUMNS, width)

    def forward(self, observations: Tensor) -> Tensor:
        """Features (N, features_dim) of what N robots are shown."""
        seen: Perceived = self.layout.split(observations)
        neighbours = _pooled(self.neighbour_net, seen.neighbours)
        obstacles = _pooled(self.obstacle_net, seen.obstacles)
        return torch.cat((*neighbours, *obstacles, seen.context), dim=-1)


def _row_network(columns: int, width: int) -> nn.Sequential:
    """Ends in a ReLU: no feature is below the zeros of an empty set."""
    return nn.Sequential(nn.Linear(columns, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())


def _pooled(network: nn.Sequential, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and largest feature over the rows that are present, (N, width) each."""
    present = rows.any(dim=-1)
    owner = present.nonzero()[:, 0]
    features = network(rows[present])
    empty = features.new_zeros(len(rows), features.shape[-1])
    count = present.sum(dim=-1, keepdim=True).clamp(min=1)
    largest = empty.scatter_reduce(0, owner[:, None].expand_as(features), features, "amax")
    return empty.index_add(0, owner, features) / count, largest


class HeadingNetwork(ActorCriticPolicy):
    """Actor and critic over ``SetFeatures``; the action is a raw heading vector.

    With ``residual`` the mean is BASE_LENGTH times the base heading plus what is learned, zero at
    first, so that the untrained policy is the base rule.
    """

    def __init__(self, *arguments: Any, residual: bool = True, **settings: Any) -> None:
        self._residual = residual
        super().__init__(*arguments, **settings)
        if residual:
            with torch.no_grad():
                self.action_net.weight.zero_()
                self.action_net.weight[:, -2:] = BASE_LENGTH * torch.eye(2)

    def _build_mlp_extractor(self) -> None:
        kind = _WithBaseHeading if self._residual else MlpExtractor
        self.mlp_extractor = kind(
            self.features_dim, self.net_arch, self.activation_fn, device=self.device
        )


class _WithBaseHeading(MlpExtractor):
    """Hands the base heading, with which features end, past the actor's layers to its last one."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.latent_dim_pi += 2

    def forward_actor(self, features: Tensor) -> Tensor:
        return torch.cat((super().forward_actor(features), features[..., -2:]), dim=-1)


def observation_box(layout: PerceptionLayout) -> Box:
    """Space of what one robot is shown."""
    return Box(-np.inf, np.inf, (layout.size,), dtype=np.float32)


def network_settings(
    layout: PerceptionLayout,
    *,
    set_width: int,
    hidden: tuple[int, ...],
    residual: bool,
    log_std: float = 0.0,
) -> dict[str, Any]:
    """Arguments of a HeadingNetwork beside its spaces (``policy_kwargs``)."""
    return {
        "features_extractor_class": SetFeatures,
        "features_extractor_kwargs": {"layout": layout, "width": set_width},
        "net_arch": {"pi": list(hidden), "vf": list(hidden)},
        "activation_fn": nn.ReLU,
        "log_std_init": log_std,
        "residual": residual,
    }


def make_network(layout: PerceptionLayout, **settings: Any) -> HeadingNetwork:
    """A network on its own, for inference; settings as ``network_settings``."""
    action = Box(-1.0, 1.0, (2,), dtype=np.float32)
    arguments = network_settings(layout, **settings)
    return HeadingNetwork(observation_box(layout), action, lambda _: 0.0, **arguments)
