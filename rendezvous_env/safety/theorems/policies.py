"""Certificates of policies, from the settings of their filters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from ...checks import raise_other_scenario, short_repr
from ...scenario.scenario import Scenario
from ..settings import MAX_TURN_RATE, bounded_error
from .theorem import at_most

Guarantee = dict[str, Any]
"""Arguments of ``certificate``, see ``guarantee_of``."""
TimeBound = Callable[[str], float | None]
"""Guaranteed rendezvous time under a filter, s, by its name; None without a guarantee."""
WRAPPERS = {
    "heading": "HeadingVectorWrapper",
    "tank": "EnergyTankWrapper",
    "gains": "GainWrapper",
    "links": "LinkKeepingWrapper",
}
"""Wrappers with a guarantee for any policy, by their name in ``certificate``."""
_POLICIES = {"heading": "baselines.HeadingPolicy", "tank": "baselines.TankPolicy"}
"""Policies with the same guarantee around a function of observations."""
_NOT_OF_FILTERS = ("name", "on_merge", "reward", "costs", "time_limit")
"""Fields of a scenario that do not affect filters."""
_TOLD = ("heading", "tank", "links")
"""Filters that need the bearing error as a setting."""


def guarantee_of(scenario: Scenario, policy: object) -> Guarantee | None:
    """Arguments of ``certificate`` from a policy's ``guarantee``; None without one.

    ``guarantee`` may also contain ``max_turn_rate``, rad/s, of a filter of nonholonomic robots, and
    ``observes_merges``, whether a tank observes merges.

    Raises:
        TypeError: for a policy that cannot be called.
        ValueError: for a policy that was made for another scenario.
    """
    if isinstance(policy, str) or not callable(policy):
        wanted = "a function of observations and time; baselines.make(name, scenario) makes one"
        raise TypeError(f"policy is {short_repr(policy)}; it must be {wanted}")
    own = getattr(policy, "scenario", None)
    if isinstance(own, Scenario) and (differing := _differing_fields(own, scenario)):
        raise_other_scenario(name_of(policy), own.name, scenario.name, differing)
    found = getattr(policy, "guarantee", None)
    return dict(found) if isinstance(found, Mapping) else None


def _differing_fields(one: Scenario, other: Scenario) -> dict[str, tuple[Any, Any]]:
    """Values of two scenarios in the fields that differ and affect filters."""
    names = [field.name for field in fields(one) if field.name not in _NOT_OF_FILTERS]
    values = {name: (getattr(one, name), getattr(other, name)) for name in names}
    return {name: (own, here) for name, (own, here) in values.items() if own != here}


def unmet(scenario: Scenario, guarantee: Guarantee) -> str:
    """Reason why a filter's settings void its guarantee in this scenario; empty if valid."""
    own, told = bounded_error(scenario.sensing, scenario.dim), guarantee.get("bearing_error", 0.0)
    if guarantee.get("by") in _TOLD and told < own:
        return (
            f"none: the sensor's bearings may err by {own:.4g} rad, and the policy's filter "
            f"expects {told:.4g} rad at most; make it with bearing_error={own:.6g}"
        )
    needed = min(scenario.min_turn_limit, MAX_TURN_RATE)
    if scenario.model.nonholonomic and guarantee.get("max_turn_rate", math.inf) < needed:
        return (
            f"none: the policy's filter turns robots by {guarantee['max_turn_rate']:.4g} rad/s at "
            f"most; make it with max_turn_rate={needed:.6g} or more"
        )
    return ""


def no_guarantee(policy: object, time_bound: TimeBound) -> str:
    """Message about an uncertified policy, with wrappers that would guarantee rendezvous.

    ``time_bound(by)`` is a wrapper's time bound, s, or None without a guarantee.
    """
    found = {by: time_bound(by) for by in WRAPPERS}
    kept = {by: bound for by, bound in found.items() if bound is not None}
    words = f"none: {name_of(policy)} may choose any action, and no theorem covers it. "
    if kept:
        listed = [f"rendezvous_env.{WRAPPERS[by]} ({_within(bound)})" for by, bound in kept.items()]
        words += f"Guaranteed for any policy under {_joined(listed)}"
        if around := [_POLICIES[by] for by in kept if by in _POLICIES]:
            words += f", or as a policy inside {_joined(around)}"
        words += ". "
    else:
        words += "No wrapper guarantees rendezvous in this scenario either. "
    return f"{words}rendezvous verify --policy MODULE:FUNCTION searches for counterexamples"


def name_of(policy: object) -> str:
    """Name of a policy in messages: a function's name, or an object's class."""
    return str(getattr(policy, "__name__", None) or type(policy).__name__.lstrip("_"))


def _within(bound: float) -> str:
    return f"within {at_most(bound)} s" if math.isfinite(bound) else "no bound on the time"


def _joined(words: list[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last
