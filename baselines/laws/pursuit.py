"""Pursuit by robots with a turn limit, which see bearings alone."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import real, refuse
from rendezvous_env.scenario.observation_layout import ObservedRows
from rendezvous_env.scenario.scenario import Scenario

from ..policy import Float32, Mask, Policy, RememberingPolicy, register, within_limits
from ..steering import turns
from .literature_laws import Order, chosen_rows, first_seen, rows_from_next
from .paper_laws import Array, is_unicycle, pitch_of

_SHARE = 0.8  # of ω_max r/2, the speed above which a target can run round its pursuer


@dataclass
class Pursuer(RememberingPolicy):
    """Keeps a target while it is seen, and then takes the first that is seen in an order of rows.

    Where nobody is seen it turns on the spot at ω_max: with a narrow field of view it searches.
    """

    scenario: Scenario
    speed: float  # c, m/s
    order: Order | None = None  # rows by preference, ([B,] n, K); None is ``rows_from_next``

    def _start(self, teams: int) -> None:
        self._targets = np.full((teams, self.scenario.n_robots), -1)

    def _forget(self, which: Mask) -> None:
        self._targets[which] = -1

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, a): v, and ω or (ω_α, ω_β); see ``Policy``."""
        rows = self.scenario.observation_layout.split(self._teams_of(observations))
        seen = np.any(rows.neighbours, axis=-1)
        order = rows_from_next(*seen.shape[-2:]) if self.order is None else self.order
        before = self._targets[..., np.newaxis]
        kept = np.take_along_axis(seen, np.maximum(before, 0), axis=-1) & (before >= 0)
        self._targets = np.where(kept[..., 0], self._targets, first_seen(seen, order))
        searching = np.zeros(self.scenario.action_size)
        searching[1] = self.scenario.turn_limit
        pursuing = self._actions(chosen_rows(rows.neighbours, self._targets), rows)
        actions = np.where(seen.any(axis=-1, keepdims=True), pursuing, searching)
        return self._as_given(within_limits(actions, self.scenario))

    @abstractmethod
    def _actions(self, bearing: Array, rows: ObservedRows) -> Array:
        """(B, n, a) for bearings (B, n, d) of targets."""


class Pursuit(Pursuer):
    """Pursue one robot that is seen until it is gone: turn towards it at ω_max, drive at c only
    while pointing at it, to within what is turned in a step.

        ω = ω_max sign α until α = 0,   v = c where α = 0, else 0,   c < ω_max r/2
                                                                        (guarantees 13, E2)
    """

    def _actions(self, bearing: Array, rows: ObservedRows) -> Array:
        if rows.gravity is None:
            turns = np.arctan2(bearing[..., 1:], bearing[..., :1])
        else:
            turns = yaw_and_pitch(bearing, pitch_of(rows.gravity))
        tau, fastest = self.scenario.tau, self.scenario.turn_limit
        off_course = np.arctan2(np.linalg.norm(bearing[..., 1:], axis=-1), bearing[..., 0])
        speed = np.where(off_course <= fastest * tau, self.speed, 0.0)
        return np.concatenate([speed[..., np.newaxis], turns / tau], axis=-1)


@dataclass
class Windshield(Pursuer):
    """A car that knows of its target only whether it is left, right or in the windshield.

    v = c,   ω = ω_max, 0 or −ω_max for α > φ, |α| ≤ φ, α < −φ      (Yu et al., 2012, eq. 3)
    """

    half_angle: float = field(kw_only=True)  # φ, rad

    def _actions(self, bearing: Array, rows: ObservedRows) -> Array:
        angle = np.arctan2(bearing[..., 1], bearing[..., 0])
        turn = np.where(np.abs(angle) > self.half_angle, np.sign(angle), 0.0)
        speed = np.full(turn.shape, self.speed)
        return np.stack([speed, self.scenario.turn_limit * turn], axis=-1)


def yaw_and_pitch(bearing: Array, pitch: Array) -> Array:
    """Turns in yaw and pitch, (..., 2), rad, from a body with pitch (...) to bearings (..., 3)."""
    forward, left, up = np.moveaxis(bearing, -1, 0)
    level = np.cos(pitch) * forward - np.sin(pitch) * up
    height = np.sin(pitch) * forward + np.cos(pitch) * up
    yaw = np.arctan2(left, level)
    return np.stack([yaw, np.arctan2(height, np.hypot(level, left)) - pitch], axis=-1)


def _speed(scenario: Scenario, speed: float | None) -> float:
    """c, m/s; at most the speed limit, and less than ω_max r/2."""
    fastest = scenario.turn_limit * scenario.merge_radius / 2.0
    if speed is None:
        return min(scenario.speed_limit, _SHARE * fastest)
    value = real(speed)
    if not (0.0 < value < fastest and value <= scenario.speed_limit):
        refuse(
            "speed",
            speed,
            f"positive, less than ω_max r/2 = {fastest:.6g} m/s and at most the speed limit, "
            f"{scenario.speed_limit:.6g} m/s",
        )
    return value


@register("pursuit", fits=turns, kind="field", on_request=True)
def _pursuit(scenario: Scenario, speed: float | None = None) -> Policy:
    """Turns towards one robot, and drives only while it points at it (E2)."""
    return Pursuit(scenario, _speed(scenario, speed))


@register("windshield", fits=is_unicycle, kind="field", on_request=True)
def _windshield(
    scenario: Scenario, half_angle: float | None = None, speed: float | None = None
) -> Policy:
    """Drives on, and turns by all it can while its target is beside the windshield."""
    n = scenario.n_robots
    angle = 0.5 * math.acos((n - 2) / (n - 1)) if half_angle is None else real(half_angle)
    if not 0.0 < angle < math.pi / 2:
        refuse("half_angle", half_angle, "positive and less than π/2 rad")
    return Windshield(scenario, _speed(scenario, speed), half_angle=angle)
