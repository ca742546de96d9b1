"""A network on its own, for inference, with the weights that it begins with."""

from gymnasium.spaces import Discrete

from baselines.learned.policy_settings import CHOICES
from baselines.learned.training_environment import observation_box
from train.learn.networks import HeadingNetwork, network_settings


def make_network(layout, choices=CHOICES, **settings):
    """Settings as ``network_settings``."""
    spaces = observation_box(layout.size), Discrete(choices)
    return HeadingNetwork(*spaces, lambda _: 0.0, **network_settings(layout, **settings))
