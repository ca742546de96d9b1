"""Pursuit by robots with a turn limit, which see bearings alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import bools, real, refuse
from rendezvous_env.scenario.observation_layout import ObservedRows

from ..policy import Policy, TeamPolicy, register, within_limits
from .neighbour_order import chosen_rows, first_seen, rows_from_next
from .paper_laws import Array, pitch_of

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario

_SHARE = 0.8
"""Of ω_max r/2, the speed above which a target can run round its pursuer."""


@dataclass
class Pursuer(TeamPolicy):
    """Keeps a target while it is seen, and then takes the first that is seen in an order of rows.

    Where nobody is seen it turns on the spot at ω_max: with a narrow field of view it searches.
    Other leading axes of the observations are other teams, and start anew.
    """

    scenario: Scenario
    """Of robots with a turn limit."""
    speed: float
    """c, m/s."""
    order: NDArray[np.int64] | None = None
    """Rows, the most liked first, (n, K) or (..., n, K); None is the next robot's first, see
    ``rows_from_next``."""
    _target: NDArray[np.int64] = field(
        init=False, repr=False, default_factory=lambda: np.zeros(0, np.int64)
    )

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (..., n, a): v, and ω or (ω_α, ω_β); see ``Policy``."""
        rows = self.scenario.observation_layout.split(observations)
        seen = np.any(rows.neighbours, axis=-1)
        bearing = chosen_rows(rows.neighbours, self._targets(seen))
        searching = np.zeros(self.scenario.action_size)
        searching[1] = self.scenario.turn_limit
        found = seen.any(axis=-1, keepdims=True)
        actions = np.where(found, self._actions(bearing, rows), searching)
        return within_limits(actions, self.scenario)

    def _actions(self, bearing: Array, rows: ObservedRows) -> Array:
        """(..., n, a) for bearings (..., n, d) of targets."""
        raise NotImplementedError

    def _targets(self, seen: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Rows (..., n) of the targets: those there were, where they are still seen."""
        order = rows_from_next(*seen.shape[-2:]) if self.order is None else self.order
        best = first_seen(seen, order)
        if self._target.shape == best.shape:
            before = self._target
            kept = np.take_along_axis(seen, np.maximum(before, 0)[..., np.newaxis], axis=-1)[..., 0]
            best = np.where(kept & (before >= 0), before, best)
        self._target = best
        return best

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget the targets of the teams where ``mask`` is true, of all if it is None."""
        if mask is None:
            self._target = np.zeros(0, np.int64)
        elif self._target.size:
            self._target[bools("mask", mask, self._target.shape[:-1], "teams")] = -1


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

    half_angle: float = field(kw_only=True)
    """φ, rad."""

    def _actions(self, bearing: Array, rows: ObservedRows) -> Array:
        angle = np.arctan2(bearing[..., 1], bearing[..., 0])
        turn = np.where(np.abs(angle) > self.half_angle, np.sign(angle), 0.0)
        speed = np.full(turn.shape, self.speed)
        return np.stack([speed, self.scenario.turn_limit * turn], axis=-1)


def yaw_and_pitch(bearing: Array, pitch: Array) -> Array:
    """Turns in yaw and in pitch that point a body at a bearing of its frame.

    Args:
        bearing: (..., 3).
        pitch: β of the body, (...), rad.

    Returns:
        (..., 2), rad.
    """
    forward, left, up = np.moveaxis(bearing, -1, 0)
    level = np.cos(pitch) * forward - np.sin(pitch) * up
    height = np.sin(pitch) * forward + np.cos(pitch) * up
    yaw = np.arctan2(left, level)
    return np.stack([yaw, np.arctan2(height, np.hypot(level, left)) - pitch], axis=-1)


# ---- as policies --------------------------------------------------------------------------------


def _speed(scenario: Scenario, speed: float | None) -> float:
    """c, m/s; at most the speed limit, and less than ω_max r/2.

    Raises:
        ValueError: for another one.
    """
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


@register(
    "pursuit",
    fits=lambda scenario: scenario.robot_model in ("unicycle", "nonholonomic_3d"),
    kind="field",
    on_request=True,
)
def _pursuit(scenario: Scenario, speed: float | None = None) -> Policy:
    """Turns towards one robot, and drives only while it points at it (E2)."""
    return Pursuit(scenario, _speed(scenario, speed))


@register(
    "windshield",
    fits=lambda scenario: scenario.robot_model == "unicycle",
    kind="field",
    on_request=True,
)
def _windshield(
    scenario: Scenario, half_angle: float | None = None, speed: float | None = None
) -> Policy:
    """Drives on, and turns by all it can while its target is beside the windshield."""
    n = scenario.n_robots
    angle = 0.5 * math.acos((n - 2) / (n - 1)) if half_angle is None else real(half_angle)
    if not 0.0 < angle < math.pi / 2:
        refuse("half_angle", half_angle, "positive and less than π/2 rad")
    return Windshield(scenario, _speed(scenario, speed), half_angle=angle)
