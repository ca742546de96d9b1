"""Bearing-only pursuit laws for robots with limited turn rate."""

import math
from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import floats, raise_invalid, to_float
from rendezvous_env.scenario.observation_layout import ObservedRows
from rendezvous_env.scenario.scenario import Scenario

from ..policy import Float32, Mask, StatefulPolicy, register, within_limits
from ..steering import turns
from .literature_laws import Order, chosen_rows, first_seen, rows_from_next
from .paper_laws import Array, is_unicycle, pitch_of

_SHARE = 0.8  # of ω_max r/2, the speed above which a target can circle its pursuer


@dataclass
class Pursuer(StatefulPolicy):
    """Base class of pursuit laws.

    A robot keeps its target while visible, then takes the first visible row in a fixed order.
    Without a visible robot it turns on the spot at ω_max, which scans a narrow field of view.
    """

    scenario: Scenario
    speed: Any = None  # c, m/s, less than ω_max r/2; None is slightly less, or the speed limit
    order: Order | None = None  # rows by preference, ([B,] n, K); None is ``rows_from_next``

    def __post_init__(self) -> None:
        limit, given = self.scenario.speed_limit, self.speed
        fastest = self.scenario.turn_limit * self.scenario.merge_radius / 2.0
        self.speed = min(limit, _SHARE * fastest) if given is None else to_float(given)
        if given is not None and not (0.0 < self.speed < fastest and self.speed <= limit):
            raise_invalid(
                "speed",
                given,
                f"positive, less than ω_max r/2 = {fastest:.6g} m/s and at most the speed limit, "
                f"{limit:.6g} m/s",
            )
        if self.order is not None:
            n, rows = self.scenario.n_robots, self.scenario.observation_layout.neighbour_slots
            order = floats("order", self.order)
            if order.shape[-2:] != (n, rows) or not np.isin(order, np.arange(rows)).all():
                raise_invalid(
                    "order", self.order, f"rows below {rows}, ([B,] n, K) = ([B,] {n}, {rows})"
                )
            self.order = order.astype(np.int64)

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


@register("pursuit", fits=turns, kind="field")
class Pursuit(Pursuer):
    """Turns towards one robot, and drives only while facing it (E2).

        ω = ω_max sign α until α = 0,   v = c where α = 0, else 0,   c < ω_max r/2
                                                                        (guarantees 13, E2)

    The tolerance of α = 0 is the rotation within one step.
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


@register("windshield", fits=is_unicycle, kind="field")
@dataclass
class Windshield(Pursuer):
    """Drives at constant speed, and turns at ω_max while its target is outside the windshield.

    v = c,   ω = ω_max, 0 or −ω_max for α > φ, |α| ≤ φ, α < −φ      (Yu et al., 2012, eq. 3)
    """

    half_angle: Any = field(default=None, kw_only=True)  # φ, rad; None is half of lemma 11's

    def __post_init__(self) -> None:
        super().__post_init__()
        n, given = self.scenario.n_robots, self.half_angle
        usual = 0.5 * math.acos((n - 2) / (n - 1))
        self.half_angle = usual if given is None else to_float(given)
        if not 0.0 < self.half_angle < math.pi / 2:
            raise_invalid("half_angle", given, "positive and less than π/2 rad")

    def _actions(self, bearing: Array, rows: ObservedRows) -> Array:
        angle = np.arctan2(bearing[..., 1], bearing[..., 0])
        turn = np.where(np.abs(angle) > self.half_angle, np.sign(angle), 0.0)
        speed = np.full(turn.shape, self.speed)
        return np.stack([speed, self.scenario.turn_limit * turn], axis=-1)


def yaw_and_pitch(bearing: Array, pitch: Array) -> Array:
    """Yaw and pitch rotations, (..., 2), rad, from a body with pitch (...) to bearings (..., 3)."""
    forward, left, up = np.moveaxis(bearing, -1, 0)
    level = np.cos(pitch) * forward - np.sin(pitch) * up
    height = np.sin(pitch) * forward + np.cos(pitch) * up
    yaw = np.arctan2(left, level)
    return np.stack([yaw, np.arctan2(height, np.hypot(level, left)) - pitch], axis=-1)
