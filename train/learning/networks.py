"""Networks that read sets of bearings: any number of neighbours and obstacles, in any order."""

from __future__ import annotations

from typing import Any

import torch
from gymnasium.spaces import Box, Discrete
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from baselines.learned.guide import CHOICES
from baselines.learned.perceiving import observation_box
from baselines.learned.perception_layout import (
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    Perceived,
    PerceptionLayout,
)

_SMALL = 0.1
"""Share of the usual weights with which the choice begins."""


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
        super().__init__(observation_space, features_dim=4 * width + layout.context_columns)
        self.local_dim = self.features_dim
        self.layout = layout
        self.neighbour_net = row_network(NEIGHBOUR_COLUMNS, width)
        self.obstacle_net = row_network(OBSTACLE_COLUMNS, width)

    def forward(self, observations: Tensor) -> Tensor:
        """Features (N, features_dim) of what N robots are shown."""
        seen: Perceived = self.layout.split(observations)
        neighbours = pooled(self.neighbour_net, seen.neighbours)
        obstacles = pooled(self.obstacle_net, seen.obstacles)
        return torch.cat((*neighbours, *obstacles, seen.context), dim=-1)


def row_network(columns: int, width: int) -> nn.Sequential:
    """Reads one row. Ends in a ReLU: no feature is below the zeros of an empty set."""
    return nn.Sequential(nn.Linear(columns, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())


def pooled(network: nn.Sequential, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and largest feature over the rows that are present, (N, width) each."""
    present = rows.any(dim=-1)
    owner = present.nonzero()[:, 0]
    features = network(rows[present])
    empty = features.new_zeros(len(rows), features.shape[-1])
    count = present.sum(dim=-1, keepdim=True).clamp(min=1)
    largest = empty.scatter_reduce(0, owner[:, None].expand_as(features), features, "amax")
    return empty.index_add(0, owner, features) / count, largest


class HeadingNetwork(ActorCriticPolicy):
    """Actor and critic over ``SetFeatures``; the action is one of the choices of ``guide``.

    At first choice 0, the analytic rule, is by far the likeliest whatever is seen, so that training
    begins near the rule.

    Args:
        prior: how much likelier than any other, as a logarithm.
    """

    def __init__(self, *arguments: Any, prior: float = 0.0, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        with torch.no_grad():
            self.action_net.weight *= _SMALL
            self.action_net.bias.zero_()
            self.action_net.bias[0] = prior


def network_settings(
    layout: PerceptionLayout, *, set_width: int, hidden: tuple[int, ...], prior: float = 0.0
) -> dict[str, Any]:
    """Arguments of a HeadingNetwork beside its spaces (``policy_kwargs``)."""
    return {
        "features_extractor_class": SetFeatures,
        "features_extractor_kwargs": {"layout": layout, "width": set_width},
        "net_arch": {"pi": list(hidden), "vf": list(hidden)},
        "activation_fn": nn.ReLU,
        "prior": prior,
    }


def make_network(
    layout: PerceptionLayout, choices: int = CHOICES, **settings: Any
) -> HeadingNetwork:
    """A network on its own, for inference; settings as ``network_settings``."""
    arguments = network_settings(layout, **settings)
    return HeadingNetwork(
        observation_box(layout.size), Discrete(choices), lambda _: 0.0, **arguments
    )
