"""Permutation-invariant networks over any number of neighbour and obstacle bearings.

For centralised training with decentralised execution, a critic may also read the global state. It
contains positions and distances, which the policy never observes.
"""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from rendezvous_env.baselines.learned.features import (
    NEIGHBOUR_COLUMNS,
    OBSTACLE_COLUMNS,
    FeatureLayout,
)
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, MlpExtractor
from torch import Tensor, nn

from rendezvous_env.obstacles.shape import CENTRE, RADIUS
from rendezvous_env.simulator import Simulator

from .sets import pooled

Floats = NDArray[np.float64]
_SMALL = 0.1
"""Factor on the initial weights of the action layer."""


class SetFeatures(BaseFeaturesExtractor):
    """Deep Sets: one small network per row, then mean and maximum over the set.

        features = (mean φ(g), max φ(g), mean ψ(s), max ψ(s), context)

    Absent (zero) rows do not count. φ and ψ, of ``width``, are the same for any number of slots.
    """

    def __init__(self, observation_space: Box, layout: FeatureLayout, width: int) -> None:
        super().__init__(observation_space, features_dim=4 * width + layout.context_columns)
        self.local_dim = self.features_dim
        self.layout = layout
        self.neighbour_net = row_network(NEIGHBOUR_COLUMNS, width)
        self.obstacle_net = row_network(OBSTACLE_COLUMNS, width)

    def forward(self, observations: Tensor) -> Tensor:
        """Features, (N, features_dim), of the observations of N robots."""
        seen = self.layout.split(observations)
        neighbours = pooled(self.neighbour_net, seen.neighbours)
        obstacles = pooled(self.obstacle_net, seen.obstacles)
        return torch.cat((*neighbours, *obstacles, seen.context), dim=-1)


def row_network(columns: int, width: int) -> nn.Sequential:
    """Network for one row, with a final ReLU so that an empty set yields the minimum, zero."""
    relu = partial(nn.ReLU, inplace=True)
    return nn.Sequential(nn.Linear(columns, width), relu(), nn.Linear(width, width), relu())


class HeadingNetwork(ActorCriticPolicy):
    """Actor and critic over ``SetFeatures``; the action is one of the base controller's choices.

    Choice 0, the analytic rule, is initially e^prior times as probable as any other.
    """

    def __init__(self, *arguments: Any, prior: float = 0.0, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        choice: Any = self.action_net
        with torch.no_grad():
            choice.weight *= _SMALL
            choice.bias.zero_()
            choice.bias[0] = prior

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Choices (N,), values (N, 1) and log-probabilities (N,) of N robots."""
        return self._chosen(self.extract_features(obs), deterministic)

    def _chosen(self, features: Any, deterministic: bool) -> tuple[Tensor, Tensor, Tensor]:
        preferences, values = self._judged(features)
        log_probs = preferences.T.log_softmax(dim=0)  # sums over choices are sums of vectors
        if deterministic:
            choices = log_probs.argmax(dim=0)
        else:  # inverse transform sampling
            passed = log_probs.exp().cumsum(dim=0)
            drawn = torch.rand(len(values), device=values.device) * passed[-1]
            choices = (passed[:-1] <= drawn).sum(dim=0)
        return choices, values, log_probs.gather(0, choices[None])[0]

    def judged(self, obs: Any) -> tuple[Tensor, Tensor]:
        """Preferences (N, choices) and values (N, 1) of N robots."""
        return self._judged(self.extract_features(obs))

    def _judged(self, features: Any) -> tuple[Tensor, Tensor]:
        latent_pi, latent_vf = self.mlp_extractor(features)
        return self.action_net(latent_pi), self.value_net(latent_vf)


def network_settings(
    layout: FeatureLayout, *, set_width: int, hidden: tuple[int, ...], prior: float = 0.0
) -> dict[str, Any]:
    """Arguments of a HeadingNetwork apart from its spaces (``policy_kwargs``)."""
    return {
        "features_extractor_class": SetFeatures,
        "features_extractor_kwargs": {"layout": layout, "width": set_width},
        "net_arch": {"pi": list(hidden), "vf": list(hidden)},
        "activation_fn": partial(nn.ReLU, inplace=True),
        "optimizer_kwargs": {"eps": 1e-5, "fused": True},  # one pass over all weights
        "prior": prior,
    }


STATE_ROBOT_COLUMNS = 4
"""Position x, y of a robot, in units of FAR; log(1 + A/(r D̄)) of its tank, 0 without; 1."""
STATE_OBSTACLE_COLUMNS = 3
"""Centre x, y and radius of the bounding ball of an obstacle, in units of FAR."""
STATE_CONTEXT_COLUMNS = 2
"""V/V(0), 0 if V(0) = 0; elapsed fraction of the time limit."""
FAR = 5.0
"""Length unit of the global state, m."""


class Situation(NamedTuple):
    """Parts of a global state as views with columns last; absent rows are zero."""

    robots: Any
    obstacles: Any
    context: Any


class GlobalStateLayout(NamedTuple):
    """Layout of a global state as a flat vector, for n robots and M obstacles."""

    n_robots: int
    obstacle_slots: int

    @property
    def size(self) -> int:
        """Length of the vector of one robot."""
        rows = self.n_robots * STATE_ROBOT_COLUMNS + self.obstacle_slots * STATE_OBSTACLE_COLUMNS
        return rows + STATE_CONTEXT_COLUMNS

    def split(self, state: Any) -> Situation:
        """The parts of (..., size), an array or a tensor."""
        robots = self.n_robots * STATE_ROBOT_COLUMNS
        obstacles = state[..., robots:-STATE_CONTEXT_COLUMNS]
        return Situation(
            state[..., :robots].reshape(*state.shape[:-1], self.n_robots, STATE_ROBOT_COLUMNS),
            obstacles.reshape(*state.shape[:-1], self.obstacle_slots, STATE_OBSTACLE_COLUMNS),
            state[..., -STATE_CONTEXT_COLUMNS:],
        )

    def states(
        self, simulator: Simulator, towards: NDArray[Any], levels: Floats
    ) -> NDArray[np.float32]:
        """Global states (B, n, size) of planar environments, see ``GlobalState``.

        Each is relative to a robot's position, in its frame with x along f; zero for merged robots.
        """
        positions, active, table = simulator.positions, simulator.active, simulator.obstacles
        axes, (batch, n) = _axes(simulator.frames, towards), active.shape
        states = np.zeros((batch, n, self.size))
        robots, obstacles, context = self.split(states)
        robots[..., :2] = _seen_from(positions, axes, positions)
        robots[..., 2] = np.log1p(levels)[:, np.newaxis]
        robots[..., 3] = 1.0
        robots *= active[:, np.newaxis, :, np.newaxis]
        there = obstacles[:, :, : table.shape[1]]
        there[..., :2] = _seen_from(positions, axes, table[..., CENTRE : CENTRE + 2])
        there[..., 2] = table[:, np.newaxis, :, RADIUS] / FAR
        there *= (table[..., RADIUS] > 0.0)[:, np.newaxis, :, np.newaxis]
        start = simulator.initial_lyapunov  # 0 on a proximity graph without edges
        left = simulator.lyapunov() / np.where(start > 0.0, start, np.inf)
        context[:] = np.stack((left, simulator.steps / simulator.max_steps), axis=-1)[:, np.newaxis]
        return (states * active[..., np.newaxis]).astype(np.float32)


def _axes(frames: Floats, towards: NDArray[Any]) -> Floats:
    """Axes (B, n, 2, 2) of the frames with x along f, rows in the global frame."""
    x = towards.astype(np.float64)
    length = np.linalg.norm(x, axis=-1, keepdims=True)
    x = np.where(length > 0.0, x / np.where(length > 0.0, length, 1.0), [1.0, 0.0])
    x = np.einsum("bnij,bnj->bni", frames, x)
    return np.stack((x, np.stack((-x[..., 1], x[..., 0]), axis=-1)), axis=-2)


def _seen_from(positions: Floats, axes: Floats, points: Floats) -> Floats:
    """Points (B, k, 2), m, relative to robots at (B, n, 2): (B, n, k, 2), in units of FAR."""
    apart = points[:, np.newaxis] - positions[:, :, np.newaxis]
    return np.einsum("bnij,bnkj->bnki", axes, apart) / FAR


class GlobalFeatures(SetFeatures):
    """``SetFeatures`` of the observation, followed by features of the appended global state."""

    def __init__(
        self, observation_space: Box, layout: FeatureLayout, width: int, state: GlobalStateLayout
    ) -> None:
        super().__init__(observation_space, layout, width)
        self.state = state
        self.team_net = row_network(STATE_ROBOT_COLUMNS, width)
        self.field_net = row_network(STATE_OBSTACLE_COLUMNS, width)
        self._features_dim += 4 * width + STATE_CONTEXT_COLUMNS

    def forward(self, observations: Tensor) -> Tensor:
        """Features (N, features_dim); the first ``local_dim`` of them are the actor's."""
        local = super().forward(observations[..., : self.layout.size])
        state = self.state.split(observations[..., self.layout.size :])
        robots = pooled(self.team_net, state.robots)
        obstacles = pooled(self.field_net, state.obstacles)
        return torch.cat((local, *robots, *obstacles, state.context), dim=-1)


class _Split(MlpExtractor):
    """Layers of an actor that reads the local features only, and of a critic."""

    def __init__(self, actor_dim: int, critic_dim: int, **arguments: Any) -> None:
        super().__init__(critic_dim, **arguments)
        self._actor_dim = actor_dim
        self.policy_net = MlpExtractor(actor_dim, **arguments).policy_net

    def forward_actor(self, features: Tensor) -> Tensor:
        return super().forward_actor(features[..., : self._actor_dim])


class SplitNetwork(HeadingNetwork):
    """A HeadingNetwork whose critic may read more than its actor."""

    units = 0
    """Size of the recurrent state that precedes the features of actor and critic."""
    features_extractor: SetFeatures

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = _Split(
            self.units + self.features_extractor.local_dim,
            self.units + self.features_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )
