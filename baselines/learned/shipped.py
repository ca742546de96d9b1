"""The learned policies that are shipped with their weights, and the preset: what they were trained
in, as their own files say.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

from rendezvous_env.rewards.terms import RewardWeights
from rendezvous_env.scenario.scenario import Scenario

from ..policy import Policy, in_the_plane, register
from ..steering import can_steer
from .checkpoints import describe
from .learned_policy import load
from .policy_settings import PolicySettings

_SHIPPED = {
    "learned": (
        "pretrained",
        "Chooses how far aside of f the joined rule aims; certified, shipped with its weights.",
    ),
    "learned-tank": (
        "pretrained_tank",
        "Chooses where to go, all round, under an energy tank; shipped with its weights.",
    ),
    "learned-tank-noise": (
        "pretrained_tank_noise",
        "The same, trained on with sensors that err, farther from edges; shipped.",
    ),
}
"""By name: the folder of the weights, and what the policy is."""
NAMES = tuple(_SHIPPED)
_OF_OTHERS = {"learned-tank": "pretrained_tank_unicycle"}
"""Weights trained on with unicycles and larger tanks, for all but points of the plane. Those of the
others were trained with such points alone, and none in space."""


def folder(name: str, scenario: Scenario | None = None) -> Path:
    """Where weights, settings and curves of a shipped policy lie, by one of NAMES and whose robots
    it is to steer; None is single integrators in the plane.
    """
    own = {} if scenario is None or in_the_plane(scenario) else _OF_OTHERS
    return Path(__file__).with_name(own.get(name, _SHIPPED[name][0]))


def _register(name: str, about: str) -> None:
    def build(scenario: Scenario) -> Policy:
        return load(folder(name, scenario), scenario)

    build.__doc__ = about
    register(name, fits=can_steer, kind="learned")(build)


for _name, (_, _about) in _SHIPPED.items():
    _register(_name, _about)


POLICIES = {"heading": "learned", "tank": "learned-tank"}
"""The shipped policy of each guarantee."""


class Preset(NamedTuple):
    """What a shipped policy was trained in."""

    settings: PolicySettings
    """What it is shown and chooses, and how often."""
    reward: RewardWeights
    """Of its teams."""
    touch_penalty: float
    """What a robot paid for its first contact with an obstacle."""


def preset(guarantee: str | None, scenario: Scenario | None = None) -> Preset:
    """That of a guarantee's shipped policy, "heading" without one; a scenario as in ``folder``."""
    return _read(folder(POLICIES.get(guarantee or "", POLICIES["heading"]), scenario))


@cache
def _read(path: Path) -> Preset:
    about = describe(path)
    return Preset(
        PolicySettings.from_plain(about["policy"]),
        RewardWeights(**about["scenario"]["reward"]),
        float(about["config"]["touch_penalty"]),
    )
