"""A network that remembers: a gated recurrent unit between features and actor and critic."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from stable_baselines3.common.distributions import Distribution
from torch import Tensor, nn

from .global_critic import SplitNetwork


class Sequences(NamedTuple):
    """What S robots were shown in T decisions; what a recurrent network evaluates at once."""

    observations: Tensor
    """(T, S, size)."""
    starts: Tensor
    """(T, S), 1 where an episode began with this decision, else 0."""
    hidden: Tensor
    """(S, units), what the robots remembered before the first decision."""
    kept: Tensor
    """(T, S), bool: decisions that are samples; the others are of robots that were gone."""


class RecurrentNetwork(SplitNetwork):
    """A HeadingNetwork over (h, features), h what a robot remembers (GRU; Cho et al. 2014).

        h ← GRU(features shown to the robot, h),   h = 0 where an episode begins, and for a robot
                                                   that is shown nothing

    In forward passes the network itself keeps h of all slots.

    Args:
        units: numbers in h.
    """

    hidden: Tensor
    """h of every slot, (slots, units); empty before ``begin``."""

    def __init__(self, *arguments: Any, units: int, **settings: Any) -> None:
        self.units = units  # the layers, which super() builds, need it
        super().__init__(*arguments, **settings)
        self.begin(0)

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        self.memory = nn.GRUCell(self.features_extractor.local_dim, self.units)

    def begin(self, slots: int) -> None:
        """From now on there are so many slots, which remember nothing."""
        self.hidden = torch.zeros(slots, self.units, device=self.device)

    def forget(self, ended: Tensor) -> None:
        """Forget what the slots (slots,) remember whose episodes have ended."""
        self.hidden = self.hidden.masked_fill(ended[:, None], 0.0)

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Choices, values and log-probabilities of all slots; their memory moves on."""
        features = self._features(obs)
        self.hidden = self._next(features, self._alive(obs), self.hidden)
        latent_pi, latent_vf = self.mlp_extractor(torch.cat((self.hidden, features), dim=-1))
        distribution = self._get_action_dist_from_latent(latent_pi)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, self.value_net(latent_vf), distribution.log_prob(actions)

    def predict_values(self, obs: Tensor, hidden: Tensor | None = None) -> Tensor:
        """Values (N, 1) of what comes next; nothing is remembered of it.

        Args:
            obs: (N, size).
            hidden: what these robots remember, (N, units); None is that of all slots.
        """
        latent = self.mlp_extractor.forward_critic(self._with_memory(obs, hidden))
        values: Tensor = self.value_net(latent)
        return values

    def get_distribution(self, obs: Tensor, hidden: Tensor | None = None) -> Distribution:
        """Of the choices; arguments as ``predict_values``."""
        latent = self.mlp_extractor.forward_actor(self._with_memory(obs, hidden))
        return self._get_action_dist_from_latent(latent)

    def evaluate_actions(
        self, obs: Sequences, actions: Tensor
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Values, log-probabilities and entropies of the samples that are kept."""
        features = self._features(obs.observations.flatten(0, 1)).unflatten(0, obs.kept.shape)
        alive, hidden, remembered = self._alive(obs.observations), obs.hidden, []
        for t in range(len(features)):
            hidden = hidden.masked_fill(obs.starts[t, :, None] > 0, 0.0)
            hidden = self._next(features[t], alive[t], hidden)
            remembered.append(hidden)
        both = torch.cat((torch.stack(remembered), features), dim=-1)[obs.kept]
        latent_pi, latent_vf = self.mlp_extractor(both)
        distribution = self._get_action_dist_from_latent(latent_pi)
        return self.value_net(latent_vf), distribution.log_prob(actions), distribution.entropy()

    def _features(self, obs: Tensor) -> Tensor:
        features = self.extract_features(obs)
        assert isinstance(features, Tensor)  # actor and critic share their extractor
        return features

    def _alive(self, obs: Tensor) -> Tensor:
        """Whether a robot is shown anything, (..., 1)."""
        return obs[..., : self.features_extractor.layout.size].any(dim=-1, keepdim=True)

    def _next(self, features: Tensor, alive: Tensor, hidden: Tensor) -> Tensor:
        """What is remembered after these features: only of the local ones."""
        local = features[..., : self.features_extractor.local_dim]
        remembered: Tensor = self.memory(local, hidden)
        return remembered * alive

    def _with_memory(self, obs: Tensor, hidden: Tensor | None) -> Tensor:
        features, before = self._features(obs), self.hidden if hidden is None else hidden
        return torch.cat((self._next(features, self._alive(obs), before), features), dim=-1)
