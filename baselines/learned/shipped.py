"""Shipped learned policies, and the preset of their training, read from their files."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

from rendezvous_env.rewards.terms import RewardWeights
from rendezvous_env.scenario.scenario import Scenario

from ..policy import Policy, in_the_plane, of_model, register
from ..steering import can_steer
from .checkpoints import describe
from .learned_policy import load
from .policy_settings import PolicySettings

_SHIPPED = {
    "learned": (
        "pretrained",
        "Network that rotates f for the rule tangent-merged-tuned, under certified headings.",
    ),
    "learned-tank": (
        "pretrained_tank",
        "Network that chooses any direction, under an energy tank.",
    ),
    "learned-tank-noise": (
        "pretrained_tank_noise",
        "As learned-tank, trained further with imperfect sensors and a larger clearance.",
    ),
    "learned-search": (
        "pretrained_search",
        "Network that commands speed and turn rate from remembered bearings, without a filter.",
    ),
}
"""Folder of the weights and one-line description, by name."""
NAMES = tuple(_SHIPPED)
_FITS = {"learned-search": of_model("unicycle")}
"""Supported robots of policies that do not support all of ``can_steer``."""
_OF_OTHERS = {"learned-tank": "pretrained_tank_unicycle"}
"""Weights for all robot models but single integrators in the plane, trained with unicycles and
larger tanks, never in 3-D. The other weights were trained with such integrators only."""


def folder(name: str, scenario: Scenario | None = None) -> Path:
    """Folder with weights, settings and curves of a shipped policy.

    Arguments are one of NAMES and the scenario; None is single integrators in the plane.
    """
    own = {} if scenario is None or in_the_plane(scenario) else _OF_OTHERS
    return Path(__file__).with_name(own.get(name, _SHIPPED[name][0]))


def _register(name: str, about: str) -> None:
    def build(scenario: Scenario) -> Policy:
        return load(folder(name, scenario), scenario)

    build.__doc__ = about
    register(name, fits=_FITS.get(name, can_steer), kind="learned")(build)


for _name, (_, _about) in _SHIPPED.items():
    _register(_name, _about)


POLICIES = {"heading": "learned", "tank": "learned-tank"}
"""Shipped policy of each guarantee."""


class Preset(NamedTuple):
    """Training settings of a shipped policy."""

    settings: PolicySettings
    """Features, choices and decision period."""
    reward: RewardWeights
    """Reward of an environment."""
    contact_penalty: float
    """Penalty for a robot's first contact with an obstacle."""


def preset(guarantee: str | None, scenario: Scenario | None = None) -> Preset:
    """Preset of a guarantee's shipped policy, by default "heading"; scenario as in ``folder``."""
    return _read(folder(POLICIES.get(guarantee or "", POLICIES["heading"]), scenario))


@cache
def _read(path: Path) -> Preset:
    about = describe(path)
    config = about["config"]
    price = config["contact_penalty"] if "contact_penalty" in config else config["touch_penalty"]
    return Preset(
        PolicySettings.from_plain(about["policy"]),
        RewardWeights(**about["scenario"]["reward"]),
        float(price),
    )
