"""Obstacle avoidance from the bearings of obstacle edges, and the corresponding policies.

The policies apply law (4), h hᵀf, along the heading h of a rule, or along h certified by theorem C.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import number, positive, short_repr, to_float
from rendezvous_env.compilation import kernel
from rendezvous_env.engine.state_checks import check_numbers
from rendezvous_env.safety.heading import certified_heading, flexible_velocity, step_scale
from rendezvous_env.safety.settings import check_margin, check_vectors
from rendezvous_env.safety.turning import rates_of
from rendezvous_env.scenario.observation_layout import ROWS_PER_OBSTACLE
from rendezvous_env.scenario.scenario import Scenario

from ..policy import (
    Float32,
    Mask,
    Policy,
    StatefulPolicy,
    TeamPolicy,
    is_single_integrator,
    register,
    within_limits,
)
from ..steering import Steering, can_steer
from .merged_cones_3d import merged_headings_3d
from .merged_intervals_2d import axis_is_clear, merged_headings_2d
from .obstacle_edges import tangent_headings
from .planes_in_space import axis_is_clear_3d, headings_in_planes, widened_rays

FLAT = 0.04  # rad; maximum distance of flat sides between eight boundary rays from a round cone
Array = NDArray[np.float64]
HeadingRule = Callable[[Array, NDArray[Any]], Array]
"""Heading rule: net bearings and silhouettes → headings hᵢ, (..., d), unit vectors.

Net bearings fᵢ are (..., d), m/s; silhouettes are (..., M, S, d), unit vectors, zero where not
visible."""


def tangent_heading(net_bearing: Array, silhouettes: NDArray[Any]) -> Array:
    """Edge nearest to f of the most prominent visible obstacle (section IV-C, literally).

    The most prominent obstacle has the largest angular width; it need not block f.
    """
    return _over_robots(tangent_headings, net_bearing, silhouettes, False)


def tangent_blocking_heading(net_bearing: Array, silhouettes: NDArray[Any]) -> Array:
    """Section IV-C restricted to blocking obstacles: the most prominent one that f points into."""
    return _over_robots(tangent_headings, net_bearing, silhouettes, True)


def tangent_merged_heading(
    net_bearing: Array,
    silhouettes: NDArray[Any],
    *,
    clearance: float = 0.05,
    carried: Array | None = None,
    persistence: float = 0.0,
) -> Array:
    """Nearer edge of the merged interval that blocks f (theory 6).

    See ``merged_headings_2d`` and ``merged_headings_3d``. The clearance from edges is in rad. In
    the plane ``carried`` are the headings of the previous step, (..., d), zero where undefined.
    With a ``persistence``, the angles of edges from these headings count in addition to those from
    f.
    """
    f = check_vectors("net_bearing", net_bearing)
    if f.shape[-1] == 3:
        return _over_robots(merged_headings_3d, f, silhouettes, float(clearance))
    before = np.zeros_like(f) if carried is None else check_vectors("carried", carried, like=f)
    options = float(clearance), before.reshape(-1, 2), float(persistence)
    return _over_robots(merged_headings_2d, f, silhouettes, *options)


def _over_robots(
    rule: Any, net_bearing: Array, silhouettes: NDArray[Any], *options: bool | float | Array
) -> Array:
    f = check_vectors("net_bearing", net_bearing)
    d, slots = f.shape[-1], np.shape(silhouettes)[-3:-2] or (0,)
    shape = *f.shape[:-1], *slots, ROWS_PER_OBSTACLE[d], d
    given = check_numbers("silhouettes", silhouettes, shape, "(..., M, S, d)")
    headings, robots = np.empty_like(f), f.size // d  # -1 cannot be inferred without obstacles
    points = np.ascontiguousarray(given).reshape(robots, *shape[-3:])
    rule(f.reshape(robots, d), points, *options, headings.reshape(robots, d))
    return headings


def check_clearance(clearance: Any) -> None:
    """Validate a clearance: an angle in [0, π) rad."""
    if not 0 <= to_float(clearance) < np.pi:
        raise ValueError(f"clearance is {short_repr(clearance)}; it must be an angle in [0, π) rad")


def steered(steering: Steering, wanted: NDArray[Any], observations: NDArray[Any]) -> Float32:
    """Actions (..., n, a) that follow velocities (..., n, d), m/s, given (..., n, rows, d).

    A robot outside a shape never enters it along a ray outside its silhouette. A robot that turns
    on the spot until its axis is clear therefore hits no visible obstacle.
    """
    layout = steering.scenario.observation_layout
    actions = within_limits(steering.actions(wanted, observations), steering.scenario)
    if steering.turns:
        seen = np.ascontiguousarray(layout.split(observations).obstacles)
        pitches = steering.pitches(observations).reshape(-1)
        flat = actions.reshape(-1, actions.shape[-1])
        _hold_back(flat, seen.reshape(-1, *seen.shape[-3:]), pitches, steering.gate)
    return actions


@kernel(allocates=True)
def _hold_back(actions, silhouettes, pitches, gate):
    rays = np.empty(silhouettes.shape[1:])
    for i in range(actions.shape[0]):
        rates = rates_of(actions[i], gate)
        if gate.planar:
            clear = axis_is_clear(rates, silhouettes[i], gate)
        else:
            cones = rays[: widened_rays(silhouettes[i], FLAT, rays)]
            clear = axis_is_clear_3d(rates, pitches[i], cones, gate)
        if not clear:
            actions[i, 0] = 0.0


@dataclass(frozen=True)
class BareHeadingPolicy(TeamPolicy):
    """Heading rule with law (4), ṗᵢ = hᵢ hᵢᵀ fᵢ, which nonholonomic robots approximate."""

    scenario: Scenario
    rule: HeadingRule

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, a); see ``Policy``."""
        layout = self.scenario.observation_layout
        f, seen = layout.net_bearing(observations), layout.split(observations)
        velocity = flexible_velocity(f, self.rule(f, seen.obstacles))
        return steered(Steering(self.scenario), velocity, observations)


@dataclass
class CertifiedHeadingPolicy(StatefulPolicy):
    """Heading rule certified by theorem C, with velocities scaled for long steps.

        vᵢ = min(1, r/(2 Dᵢ τ)) hᵢ hᵢᵀ fᵢ                             (theory 3 and 4)

    The rule defines a line, so its heading is flipped to the side of f before certification.
    Nonholonomic robots lag behind their headings, and no theorem covers them.
    """

    scenario: Scenario
    rule: HeadingRule
    min_alignment: float = 0.1  # ε, minimum alignment: |hᵀf| ≥ ε‖f‖
    max_turn_rate: float = 3.0  # ω_max of the heading, rad/s

    def __post_init__(self) -> None:
        check_margin(self.min_alignment)
        positive("max_turn_rate", self.max_turn_rate, "rad/s")
        self._steering = Steering(self.scenario)

    @property
    def guarantee(self) -> dict[str, Any] | None:
        """As ``TeamPolicy``: certified headings, for holonomic robots."""
        if self.scenario.model.nonholonomic:
            return None
        return {"by": "heading", "min_alignment": self.min_alignment}

    def _start(self, teams: int) -> None:
        team = teams, self.scenario.n_robots
        self._previous: Array = np.zeros((*team, self.scenario.dim))
        self._sent = np.zeros((*team, self.scenario.action_size), np.float32)

    def _forget(self, which: Mask) -> None:
        self._previous[which], self._sent[which] = 0.0, 0.0

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, a); see ``Policy``."""
        return self.after(self.scenario.tau, observations, time)

    def after(self, elapsed: float, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """As ``RealTimePolicy.after``."""
        scenario, layout = self.scenario, self.scenario.observation_layout
        seen = self._teams_of(observations)
        f = layout.net_bearing(seen)
        self._previous = self._steering.turned(self._previous, self._sent, seen, elapsed)
        h = self._previous = certified_heading(
            self._aim(f, seen, elapsed),
            f,
            self._previous,
            min_alignment=self.min_alignment,
            dead_zone=scenario.dead_zone or 1.0,  # any value, since f is 0 without links
            max_turn=self.max_turn_rate * elapsed,
        )
        scale = step_scale(layout.degree(seen), scenario.merge_radius, scenario.tau)
        velocity = scale[..., np.newaxis] * flexible_velocity(f, h)
        self._sent = steered(self._steering, velocity, seen)
        return self._as_given(self._sent)

    def _aim(self, f: Array, seen: Float32, elapsed: float) -> Array:
        """Vectors (B, n, d) to certify."""
        raw = self.rule(f, self.scenario.observation_layout.split(seen).obstacles)
        return np.where(np.sum(raw * f, axis=-1, keepdims=True) < 0, -raw, raw)

    @property
    def headings(self) -> Array:
        """Headings of the previous step, (..., n, d); zero where undefined."""
        return np.zeros(0) if self._leading is None else self._as_given(self._previous).copy()


def can_pass_obstacles(scenario: Scenario) -> bool:
    """True if ``Steering`` supports a scenario's robots, and they sense obstacles."""
    return can_steer(scenario) and scenario.observation_layout.obstacle_slots > 0


def _among_obstacles(scenario: Scenario) -> bool:
    """True if actions are velocities, and robots sense obstacles."""
    return is_single_integrator(scenario) and can_pass_obstacles(scenario)


@register("tangent", fits=_among_obstacles, kind="rule")
def _tangent(scenario: Scenario) -> Policy:
    """Along the nearer edge of the widest visible obstacle (section IV-C)."""
    return BareHeadingPolicy(scenario, tangent_heading)


@register("tangent-blocking", fits=_among_obstacles, kind="rule")
def _tangent_blocking(scenario: Scenario) -> Policy:
    """As tangent, but only for obstacles that block f."""
    return BareHeadingPolicy(scenario, tangent_blocking_heading)


@register("tangent-merged", fits=can_pass_obstacles, kind="rule")
def _tangent_merged(scenario: Scenario, clearance: float = 0.05) -> Policy:
    """As tangent-blocking, with overlapping obstacles merged."""
    check_clearance(clearance)
    return BareHeadingPolicy(scenario, partial(tangent_merged_heading, clearance=clearance))


@register("tangent-certified", fits=_among_obstacles, kind="rule")
def _tangent_certified(
    scenario: Scenario, min_alignment: float = 0.1, max_turn_rate: float = 3.0
) -> Policy:
    """As tangent, with the certified heading of theorem C."""
    return CertifiedHeadingPolicy(scenario, tangent_heading, min_alignment, max_turn_rate)


@register("tangent-blocking-certified", fits=_among_obstacles, kind="rule")
def _tangent_blocking_certified(
    scenario: Scenario, min_alignment: float = 0.1, max_turn_rate: float = 3.0
) -> Policy:
    """As tangent-blocking, with the certified heading of theorem C."""
    return CertifiedHeadingPolicy(scenario, tangent_blocking_heading, min_alignment, max_turn_rate)


@register("tangent-merged-certified", fits=_among_obstacles, kind="rule")
def _tangent_merged_certified(
    scenario: Scenario,
    clearance: float = 0.05,
    min_alignment: float = 0.1,
    max_turn_rate: float = 3.0,
) -> Policy:
    """As tangent-merged, with the certified heading of theorem C."""
    check_clearance(clearance)
    rule = partial(tangent_merged_heading, clearance=clearance)
    return CertifiedHeadingPolicy(scenario, rule, min_alignment, max_turn_rate)


class TunedMergedPolicy(CertifiedHeadingPolicy):
    """As tangent-merged-certified, tuned and persistent in its choice of side.

    The persistence is λ of ``merged_headings_2d``; in 3-D a robot keeps its plane as well
    (``headings_in_planes``). An edge beyond the cap is used unmodified. The robot then slows down
    at the boundary of the cap and does not turn into an obstacle behind it.
    """

    def __init__(
        self,
        scenario: Scenario,
        clearance: float = 0.2,
        persistence: float | None = None,
        min_alignment: float = 0.05,
        max_turn_rate: float = 100.0,
    ) -> None:
        check_clearance(clearance)
        if persistence is None:
            persistence = 0.5 if scenario.dim == 2 else 0.35
        self._clearance, self._persistence = clearance, number("persistence", persistence, 0)
        super().__init__(scenario, tangent_merged_heading, min_alignment, max_turn_rate)

    def _start(self, teams: int) -> None:
        super()._start(teams)
        self._asides = np.zeros_like(self._previous)

    def _forget(self, which: Mask) -> None:
        super()._forget(which)
        self._asides[which] = 0.0

    def _aim(self, f: Array, seen: Float32, elapsed: float) -> Array:
        d, silhouettes = f.shape[-1], self.scenario.observation_layout.split(seen).obstacles
        rule = float(self._clearance), self._previous.reshape(-1, d), self._persistence
        if d == 2:
            return _over_robots(merged_headings_2d, f, silhouettes, *rule)
        self._asides = self._steering.turned(self._asides, self._sent, seen, elapsed)
        asides = self._asides.reshape(-1, 3)
        return _over_robots(headings_in_planes, f, silhouettes, *rule, asides)
