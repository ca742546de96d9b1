"""Scripted heading policies for single integrators among obstacles, by name.

Each rule gives a heading h from the edges of obstacles; the velocity is law (4), h hᵀf. The
certified form of a rule passes its heading through theorem C first.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import between, bools, number, positive
from rendezvous_env.safety.heading import certified_heading, flexible_velocity, step_scale

from ..policy import Policy, TeamPolicy, is_single_integrator, register, within_limits
from .heading_rules import (
    Array,
    HeadingRule,
    check_clearance,
    tangent_blocking_heading,
    tangent_heading,
    tangent_joined_heading,
)

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario

__all__ = [
    "BareHeadingPolicy",
    "CertifiedHeadingPolicy",
    "HeadingRule",
    "TunedJoinedPolicy",
    "tangent_blocking_heading",
    "tangent_heading",
    "tangent_joined_heading",
]


@dataclass(frozen=True)
class BareHeadingPolicy(TeamPolicy):
    """A heading rule with law (4): ṗᵢ = hᵢ hᵢᵀ fᵢ."""

    scenario: Scenario
    """Whose robots it steers."""
    rule: HeadingRule
    """Where they head."""

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Velocities (..., n, d); see ``Policy``."""
        layout = self.scenario.observation_layout
        f, seen = layout.net_bearing(observations), layout.split(observations)
        return within_limits(flexible_velocity(f, self.rule(f, seen.obstacles)), self.scenario)


@dataclass
class CertifiedHeadingPolicy(TeamPolicy):
    """A heading rule made certain to meet: theorem C, and velocities scaled where the step is long.

        vᵢ = min(1, r/(2 Dᵢ τ)) hᵢ hᵢᵀ fᵢ                             (theory 3 and 4)

    The rule means a line, so its heading is flipped to the side of f before it is certified. The
    policy remembers the headings of every robot, with the leading axes of the observations; other
    leading axes are other teams, and start anew.
    """

    scenario: Scenario
    """Whose robots it steers."""
    rule: HeadingRule
    """Where they would like to head."""
    min_alignment: float = 0.1
    """ε, the margin |hᵀf| ≥ ε‖f‖."""
    max_turn_rate: float = 3.0
    """ω_max of the heading, rad/s."""
    _previous: Array = field(init=False, repr=False, default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        between("min_alignment", self.min_alignment, 0, 1)
        positive("max_turn_rate", self.max_turn_rate, "rad/s")

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Velocities (..., n, d); see ``Policy``."""
        return self.after(self.scenario.tau, observations, time)

    def after(
        self, elapsed: float, observations: NDArray[Any], time: ArrayLike
    ) -> NDArray[np.float32]:
        """As a call, where the call before was so many seconds ago; see ``RealTimePolicy``."""
        scenario, layout = self.scenario, self.scenario.observation_layout
        f, seen = layout.net_bearing(observations), layout.split(observations)
        if self._previous.shape != f.shape:
            self._previous = np.zeros_like(f)
        raw = self._aim(f, seen.obstacles)
        h = self._previous = certified_heading(
            raw,
            f,
            self._previous,
            min_alignment=self.min_alignment,
            dead_zone=scenario.dead_zone or 1.0,  # without a link f is 0 whatever it is
            max_turn=self.max_turn_rate * elapsed,
        )
        degree = layout.degree(observations)
        scale = step_scale(degree, scenario.merge_radius, scenario.tau)[..., np.newaxis]
        return within_limits(scale * flexible_velocity(f, h), scenario)

    def _aim(self, f: Array, silhouettes: NDArray[Any]) -> Array:
        """Raw vectors (..., d) that are to be certified."""
        raw = self.rule(f, silhouettes)
        return np.where(np.sum(raw * f, axis=-1, keepdims=True) < 0, -raw, raw)

    @property
    def headings(self) -> Array:
        """The headings last taken, (..., n, d); zero for a robot that has none yet."""
        return self._previous.copy()

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the headings of the teams where ``mask`` is true, of all if it is None."""
        if mask is None:
            self._previous = np.zeros(0)
        elif self._previous.size:
            self._previous[bools("mask", mask, self._previous.shape[:-2], "teams")] = 0.0


@dataclass
class TunedJoinedPolicy(CertifiedHeadingPolicy):
    """The joined rule in the plane as good as tuning makes it; certified, and with two changes.

    A robot stands by the side that it has chosen (``persistence``), and an edge that lies beyond
    the cap is aimed at as it is, which leaves the robot slow at the edge of the cap, instead of
    being turned round into what lies behind it.
    """

    clearance: float = 0.2
    """Angle by which to stay clear of an edge, rad."""
    persistence: float = 0.5
    """λ of ``merged_silhouettes_2d.joined_headings_2d``."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_clearance(self.clearance)
        number("persistence", self.persistence, 0)

    def _aim(self, f: Array, silhouettes: NDArray[Any]) -> Array:
        return tangent_joined_heading(
            f,
            silhouettes,
            clearance=self.clearance,
            carried=self._previous,
            persistence=self.persistence,
        )


# ---- by name ------------------------------------------------------------------------------------


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
