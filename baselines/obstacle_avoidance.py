"""Scripted heading policies for single integrators among obstacles.

Each rule gives a heading h from the edges of obstacles; the velocity is law (4), h hᵀf. The
certified form of a rule passes its heading through theorem C first.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.experiment.checks import between, bools, number, positive, real, shown
from rendezvous_env.experiment.observation_layout import SILHOUETTE_POINTS
from rendezvous_env.guarantee.heading import (
    certified_heading,
    check_vectors,
    flexible_velocity,
    step_scale,
)

from .policy import Policy, is_single_integrator, register, within_limits
from .silhouettes import joined_headings_2d, joined_headings_3d, tangent_headings

if TYPE_CHECKING:
    from rendezvous_env.experiment.scenario import Scenario

Array = NDArray[np.float64]


class HeadingRule(Protocol):
    """A pure function from what robots see to headings."""

    def __call__(self, net_bearing: Array, silhouettes: NDArray[Any]) -> Array:
        """Headings hᵢ, (..., d), unit vectors.

        Args:
            net_bearing: fᵢ, (..., d), m/s.
            silhouettes: unit bearings, (..., M, S, d); zero where no obstacle is seen.
        """
        ...


def tangent_heading(net_bearing: Array, silhouettes: NDArray[Any]) -> Array:
    """Section IV-C read literally: the edge nearest to f of the most prominent obstacle in sight.

    The most prominent obstacle is the one with the largest angular width, whether it stands in the
    way or not. With none in sight h = f/‖f‖ (the x axis where f = 0).

    Args:
        net_bearing: fᵢ, (..., d), m/s.
        silhouettes: unit bearings, (..., M, S, d).

    Returns:
        Headings, (..., d).

    Raises:
        ValueError: naming an argument of the wrong shape, or that is not finite.
    """
    return _over_robots(tangent_headings, net_bearing, silhouettes, False)


def tangent_blocking_heading(net_bearing: Array, silhouettes: NDArray[Any]) -> Array:
    """Section IV-C for obstacles in the way only: of those that f points into, the most prominent.

    Args:
        net_bearing: fᵢ, (..., d), m/s.
        silhouettes: unit bearings, (..., M, S, d).

    Returns:
        Headings, (..., d); f/‖f‖ (the x axis where f = 0) if nothing is in the way.

    Raises:
        ValueError: naming an argument of the wrong shape, or that is not finite.
    """
    return _over_robots(tangent_headings, net_bearing, silhouettes, True)


def tangent_joined_heading(
    net_bearing: Array,
    silhouettes: NDArray[Any],
    *,
    clearance: float = 0.05,
    carried: Array | None = None,
    persistence: float = 0.0,
) -> Array:
    """Overlapping silhouettes are one obstacle; pass it on the nearer side (theory 6).

    Details are with ``silhouettes.joined_headings_2d`` and ``joined_headings_3d``.

    Args:
        net_bearing: fᵢ, (..., d), m/s.
        silhouettes: unit bearings, (..., M, S, d).
        clearance: angle by which to stay clear of an edge, rad.
        carried: headings of the step before, (..., d), zero where there is none; in the plane only.
        persistence: how much an edge's angle from the carried heading counts beside that from f.

    Returns:
        Headings, (..., d); f/‖f‖ (the x axis where f = 0) if nothing is in the way.

    Raises:
        ValueError: naming an argument of the wrong shape, or that is not finite.
    """
    f = check_vectors("net_bearing", net_bearing)
    if f.shape[-1] == 3:
        return _over_robots(joined_headings_3d, f, silhouettes, float(clearance))
    before = np.zeros_like(f) if carried is None else check_vectors("carried", carried, like=f)
    options = float(clearance), before.reshape(-1, 2), float(persistence)
    return _over_robots(joined_headings_2d, f, silhouettes, *options)


def _over_robots(
    rule: Any, net_bearing: Array, silhouettes: NDArray[Any], *options: bool | float | Array
) -> Array:
    f = check_vectors("net_bearing", net_bearing)
    points = np.ascontiguousarray(silhouettes)
    d, leading = f.shape[-1], f.shape[:-1]
    seen = (SILHOUETTE_POINTS[d], d)
    if points.ndim != f.ndim + 2 or (*points.shape[:-3], *points.shape[-2:]) != (*leading, *seen):
        raise ValueError(
            f"silhouettes has shape {points.shape}; with net_bearing of shape {f.shape} it must be "
            f"(..., M, {seen[0]}, {seen[1]})"
        )
    if points.dtype not in (np.float32, np.float64):
        raise ValueError(f"silhouettes are {points.dtype}; they must be float32 or float64")
    headings = np.empty_like(f)
    robots = f.size // d
    points = points.reshape(robots, *points.shape[-3:])  # -1 cannot be inferred without obstacles
    rule(f.reshape(robots, d), points, *options, headings.reshape(robots, d))
    return headings


@dataclass(frozen=True)
class HeadingPolicy:
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
            max_turn=self.max_turn_rate * scenario.tau,
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
    """λ of ``silhouettes.joined_headings_2d``."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_clearance(self.clearance)
        number("persistence", self.persistence, 0)

    def _aim(self, f: Array, silhouettes: NDArray[Any]) -> Array:
        return tangent_joined_heading(
            f,
            silhouettes,
            clearance=self.clearance,
            carried=self._previous,
            persistence=self.persistence,
        )


# ---- registry -----------------------------------------------------------------------------------


def _fits(scenario: Scenario) -> bool:
    return is_single_integrator(scenario) and scenario.observation_layout.obstacle_slots > 0


@register("tangent", fits=_fits)
def _tangent(scenario: Scenario) -> Policy:
    return HeadingPolicy(scenario, tangent_heading)


@register("tangent-blocking", fits=_fits)
def _tangent_blocking(scenario: Scenario) -> Policy:
    return HeadingPolicy(scenario, tangent_blocking_heading)


@register("tangent-joined", fits=_fits)
def _tangent_joined(scenario: Scenario, clearance: float = 0.05) -> Policy:
    return HeadingPolicy(scenario, _joined_with(clearance))


@register("tangent-certified", fits=_fits)
def _tangent_certified(
    scenario: Scenario, min_alignment: float = 0.1, max_turn_rate: float = 3.0
) -> Policy:
    return CertifiedHeadingPolicy(scenario, tangent_heading, min_alignment, max_turn_rate)


@register("tangent-blocking-certified", fits=_fits)
def _tangent_blocking_certified(
    scenario: Scenario, min_alignment: float = 0.1, max_turn_rate: float = 3.0
) -> Policy:
    return CertifiedHeadingPolicy(scenario, tangent_blocking_heading, min_alignment, max_turn_rate)


@register("tangent-joined-certified", fits=_fits)
def _tangent_joined_certified(
    scenario: Scenario,
    clearance: float = 0.05,
    min_alignment: float = 0.1,
    max_turn_rate: float = 3.0,
) -> Policy:
    rule = _joined_with(clearance)
    return CertifiedHeadingPolicy(scenario, rule, min_alignment, max_turn_rate)


@register("tangent-joined-tuned", fits=lambda scenario: _fits(scenario) and scenario.dim == 2)
def _tangent_joined_tuned(
    scenario: Scenario,
    clearance: float = 0.2,
    persistence: float = 0.5,
    min_alignment: float = 0.05,
    max_turn_rate: float = 100.0,
) -> Policy:
    return TunedJoinedPolicy(
        scenario,
        _joined_with(clearance),
        min_alignment,
        max_turn_rate,
        clearance=clearance,
        persistence=persistence,
    )


def _check_clearance(clearance: Any) -> None:
    if not 0 <= real(clearance) < np.pi:
        raise ValueError(f"clearance is {shown(clearance)}; it must be an angle in [0, π) rad")


def _joined_with(clearance: float) -> HeadingRule:
    _check_clearance(clearance)

    def rule(net_bearing: Array, silhouettes: NDArray[Any]) -> Array:
        return tangent_joined_heading(net_bearing, silhouettes, clearance=clearance)

    return rule
