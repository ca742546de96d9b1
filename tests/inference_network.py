"""Separate network for inference, with its initial weights."""

import torch
from gymnasium.spaces import Discrete
from torch import nn

from baselines.learned.policy_settings import CHOICES
from baselines.learned.training_environment import observation_box
from train.learn.networks import HeadingNetwork, network_settings


def make_network(layout, choices=CHOICES, kind=HeadingNetwork, own=None, **settings):
    """Settings as ``network_settings``, without those of a particular kind of network."""
    spaces = observation_box(layout.size), Discrete(choices)
    return kind(*spaces, lambda _: 0.0, **network_settings(layout, **settings), **(own or {}))


def stirred(made):
    """Network with random weights in every layer, including the last one."""
    torch.manual_seed(0)
    with torch.no_grad():
        for weights in made.parameters():
            nn.init.normal_(weights, std=0.3)
    return made
