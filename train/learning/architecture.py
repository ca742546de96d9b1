"""Which network and which PPO a configuration asks for."""

from __future__ import annotations

from typing import Any

from stable_baselines3.common.policies import ActorCriticPolicy

from baselines.learned.perceiving import PerceivingTeams

from . import networks
from .global_critic import GlobalFeatures, SplitNetwork
from .recurrent_network import RecurrentNetwork
from .recurrent_ppo import RecurrentRobotPPO
from .rollout_buffer import RobotPPO
from .settings import Config


def learner_of(config: Config) -> type[RobotPPO]:
    """The algorithm."""
    return RecurrentRobotPPO if config.memory == "recurrent" else RobotPPO


def network_of(config: Config, teams: PerceivingTeams) -> type[ActorCriticPolicy]:
    """The network for these teams."""
    if config.memory == "recurrent":
        return RecurrentNetwork
    return networks.HeadingNetwork if teams.global_state is None else SplitNetwork


def network_settings(config: Config, teams: PerceivingTeams) -> dict[str, Any]:
    """Arguments of the network beside its spaces."""
    settings = networks.network_settings(
        teams.layout, set_width=config.set_width, hidden=config.hidden, prior=config.prior
    )
    if teams.global_state is not None:
        settings["features_extractor_class"] = GlobalFeatures
        settings["features_extractor_kwargs"]["state"] = teams.global_state
    if config.memory == "recurrent":
        settings["units"] = config.memory_units
    return settings
