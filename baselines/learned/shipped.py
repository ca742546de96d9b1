"""The learned policies that are shipped with their weights, and the preset: what they were trained
in, as their own files say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from rendezvous_env.checks import number, refuse, whole
from rendezvous_env.limits import MOST_HELD_STEPS
from rendezvous_env.rewards.terms import RewardWeights
from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.scenario.scenario import Scenario

from ..policy import Policy, register
from .checkpoints import describe
from .features import can_steer
from .learned_policy import load
from .policy_settings import PolicySettings

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


@register("learned", fits=can_steer, kind="learned")
def _learned(scenario: Scenario) -> Policy:
    """Chooses how far aside of f the joined rule aims; certified, shipped with its weights."""
    return load(folder("learned"), scenario)


@register("learned-tank", fits=can_steer, kind="learned")
def _learned_tank(scenario: Scenario) -> Policy:
    """Chooses where to go, all round, under an energy tank; shipped with its weights."""
    return load(folder("learned-tank"), scenario)


@register("learned-tank-noise", fits=can_steer, kind="learned")
def _learned_tank_noise(scenario: Scenario) -> Policy:
    """The same, trained on with sensors that err, farther from edges; shipped."""
    return load(folder("learned-tank-noise"), scenario)


# ---- the preset ---------------------------------------------------------------------------------

POLICIES = {"heading": "learned", "tank": "learned-tank"}
"""The shipped policy of each guarantee."""


class Preset(NamedTuple):
    """What a shipped policy was trained in."""

    settings: PolicySettings
    """What it is shown and chooses, and how often."""
    reward: RewardWeights
    """Of its teams."""
    touch_penalty: float
    """What a robot paid for its first touch of an obstacle."""


@cache
def preset(guarantee: str | None) -> Preset:
    """That of a guarantee's shipped policy; without one that of "heading"."""
    about = describe(folder(POLICIES.get(guarantee or "", POLICIES["heading"])))
    return Preset(
        PolicySettings.from_plain(about["policy"]),
        RewardWeights(**about["scenario"]["reward"]),
        float(about["config"]["touch_penalty"]),
    )


def settings_for(
    scenario: Scenario, guarantee: str, arguments: Mapping[str, Any]
) -> PolicySettings:
    """The settings of a guarantee's shipped policy, some of them changed.

    Args:
        scenario: whose robots choose.
        guarantee: "heading" or "tank".
        arguments: of the guarantee's wrapper: min_alignment, decision_period (steps), and
            max_turn_rate or budget (m²/s).

    Raises:
        ValueError: for another argument, or an impossible value.
    """
    own = {"heading": "max_turn_rate", "tank": "budget"}[guarantee]
    changes: dict[str, Any] = {}
    for key, value in arguments.items():
        if key == "decision_period":
            changes["decision_time"] = whole(key, value, 1, MOST_HELD_STEPS) * scenario.tau
        elif key == "budget" and key == own:
            changes[key] = number(key, value, 0.0) / unit_of_tanks(scenario)
        elif key in ("min_alignment", own):
            changes[key] = number(key, value)
        else:
            refuse(key, value, "left to the learning preset; learning_preset=False takes it")
    return replace(preset(guarantee).settings, **changes)


def held_arguments(scenario: Scenario, guarantee: str) -> dict[str, Any]:
    """Arguments of a guarantee's wrapper for robots that no shipped policy steers.

    A choice is held as long as the shipped policy's; a tank has the same budget in units of r D̄,
    and its level is observed, as by the shipped policy.
    """
    settings = preset(guarantee).settings
    held: dict[str, Any] = {"decision_period": settings.decision_period(scenario)}
    if guarantee == "tank":
        held |= {"budget": settings.budget * unit_of_tanks(scenario), "observe_level": True}
    return held
