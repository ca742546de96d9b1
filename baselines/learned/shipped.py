"""The learned policies that are shipped with their weights, as the registry has them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..policy import Policy, register
from .robots import can_steer

if TYPE_CHECKING:
    from rendezvous_env.experiment.scenario import Scenario

_FOLDERS = {
    "learned": "pretrained",
    "learned-tank": "pretrained_tank",
    "learned-tank-noise": "pretrained_tank_noise",
}
NAMES = tuple(_FOLDERS)


def folder(name: str) -> Path:
    """Where weights, settings and curves of a shipped policy lie.

    Args:
        name: one of NAMES.

    Raises:
        KeyError: for another name.
    """
    return Path(__file__).with_name(_FOLDERS[name])


def _load(name: str, scenario: Scenario) -> Policy:
    from .learned_policy import load  # NumPy's weights are read where one is made

    return load(folder(name), scenario)


@register("learned", fits=can_steer, kind="learned")
def _learned(scenario: Scenario) -> Policy:
    """Chooses how far aside of f the joined rule aims; certified, shipped with its weights."""
    return _load("learned", scenario)


@register("learned-tank", fits=can_steer, kind="learned")
def _learned_tank(scenario: Scenario) -> Policy:
    """Chooses where to go, all round, under an energy tank; shipped with its weights."""
    return _load("learned-tank", scenario)


@register("learned-tank-noise", fits=can_steer, kind="learned")
def _learned_tank_noise(scenario: Scenario) -> Policy:
    """The same, trained on with sensors that err, farther from edges; shipped."""
    return _load("learned-tank-noise", scenario)
