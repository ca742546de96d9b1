"""Heading rules as policies: law (4) drives them, bare or certified."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.experiment.checks import between, bools, number, positive
from rendezvous_env.guarantee.heading import certified_heading, flexible_velocity, step_scale

from .heading_rules import Array, HeadingRule, check_clearance, tangent_joined_heading
from .policy import within_limits

if TYPE_CHECKING:
    from rendezvous_env.experiment.scenario import Scenario


@dataclass(frozen=True)
class BareHeadingPolicy:
    """A heading rule with law (4): ṗᵢ = hᵢ hᵢᵀ fᵢ."""

    scenario: Scenario
    """Whose robots it steers."""
    rule: HeadingRule
    """Where they head."""

    def __call__(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Velocities (..., n, d); see ``Policy``."""
        layout = self.scenario.observation_layout
        f, seen = layout.net_bearing(observations), layout.split(observations)
        return within_limits(flexible_velocity(f, self.rule(f, seen.obstacles)), self.scenario)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Nothing to forget."""


@dataclass
class CertifiedHeadingPolicy:
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

    def __call__(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
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
    """λ of ``joined_plane.joined_headings_2d``."""

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
