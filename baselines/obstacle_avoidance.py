"""Scripted heading policies for single integrators among obstacles, by name.

Each rule gives a heading h from the edges of obstacles; the velocity is law (4), h hᵀf. The
certified form of a rule passes its heading through theorem C first.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from .heading_policies import BareHeadingPolicy, CertifiedHeadingPolicy, TunedJoinedPolicy
from .heading_rules import (
    HeadingRule,
    check_clearance,
    tangent_blocking_heading,
    tangent_heading,
    tangent_joined_heading,
)
from .policy import Policy, is_single_integrator, register

if TYPE_CHECKING:
    from rendezvous_env.experiment.scenario import Scenario

__all__ = [
    "BareHeadingPolicy",
    "CertifiedHeadingPolicy",
    "HeadingRule",
    "TunedJoinedPolicy",
    "tangent_blocking_heading",
    "tangent_heading",
    "tangent_joined_heading",
]


def _fits(scenario: Scenario) -> bool:
    return is_single_integrator(scenario) and scenario.observation_layout.obstacle_slots > 0


@register("tangent", fits=_fits, kind="rule")
def _tangent(scenario: Scenario) -> Policy:
    """Section IV-C read literally: to the nearer edge of an obstacle that is near."""
    return BareHeadingPolicy(scenario, tangent_heading)


@register("tangent-blocking", fits=_fits, kind="rule")
def _tangent_blocking(scenario: Scenario) -> Policy:
    """The same, only for an obstacle that stands in the way of f."""
    return BareHeadingPolicy(scenario, tangent_blocking_heading)


@register("tangent-joined", fits=_fits, kind="rule")
def _tangent_joined(scenario: Scenario, clearance: float = 0.05) -> Policy:
    """The same, with silhouettes that overlap taken for one."""
    return BareHeadingPolicy(scenario, _joined_with(clearance))


@register("tangent-certified", fits=_fits, kind="rule")
def _tangent_certified(
    scenario: Scenario, min_alignment: float = 0.1, max_turn_rate: float = 3.0
) -> Policy:
    """The rule tangent through the certified heading of theorem C."""
    return CertifiedHeadingPolicy(scenario, tangent_heading, min_alignment, max_turn_rate)


@register("tangent-blocking-certified", fits=_fits, kind="rule")
def _tangent_blocking_certified(
    scenario: Scenario, min_alignment: float = 0.1, max_turn_rate: float = 3.0
) -> Policy:
    """The rule tangent-blocking through the certified heading of theorem C."""
    return CertifiedHeadingPolicy(scenario, tangent_blocking_heading, min_alignment, max_turn_rate)


@register("tangent-joined-certified", fits=_fits, kind="rule")
def _tangent_joined_certified(
    scenario: Scenario,
    clearance: float = 0.05,
    min_alignment: float = 0.1,
    max_turn_rate: float = 3.0,
) -> Policy:
    """The rule tangent-joined through the certified heading of theorem C."""
    rule = _joined_with(clearance)
    return CertifiedHeadingPolicy(scenario, rule, min_alignment, max_turn_rate)


@register(
    "tangent-joined-tuned", fits=lambda scenario: _fits(scenario) and scenario.dim == 2, kind="rule"
)
def _tangent_joined_tuned(
    scenario: Scenario,
    clearance: float = 0.2,
    persistence: float = 0.5,
    min_alignment: float = 0.05,
    max_turn_rate: float = 100.0,
) -> Policy:
    """The joined rule, certified and tuned: it keeps to a side once taken."""
    return TunedJoinedPolicy(
        scenario,
        _joined_with(clearance),
        min_alignment,
        max_turn_rate,
        clearance=clearance,
        persistence=persistence,
    )


def _joined_with(clearance: float) -> HeadingRule:
    check_clearance(clearance)
    return partial(tangent_joined_heading, clearance=clearance)
