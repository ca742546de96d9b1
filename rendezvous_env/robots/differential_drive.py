"""Wheel speeds of a differential drive for the desired velocity of a policy.

Plain Python, for one robot. Bearings and velocities refer to the point P at a distance l ahead of
the axle, which is holonomic. With a velocity (x, y) of P in the body frame, x ahead, y to the left,

    v = x,   ω = y/l                                          (speed and turn rate of the body)
    w = (2v ∓ L ω)/(2R)                                       (left and right wheel, rad/s)

for wheels of radius R at distance L. Both are limited together:

    w ← w min(1, W/max|w|)                                    (speed)
    w ← w₋ + (w − w₋) min(1, A dt/max|w − w₋|)                (acceleration, from w₋ before)

The first preserves the direction of P, since x : y = v : l ω. With the second, both wheels reach
their target at the same time.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..checks import floats, positive, raise_invalid, to_float
from ..limits import LARGEST
from ..physics.half_planes import nearest_within

Pair = tuple[float, float]
_OFF_UNIT = 1e-3  # of a direction's length, as float32 and messages round
_BELOW = 1.0 - 1e-9  # factor on wheel speeds, so that those computed from v and ω stay in the limit


class Machine(NamedTuple):
    """Parameters of a differential drive; defaults are those of the Robotarium."""

    wheel_radius: float = 0.016
    """Wheel radius R, m."""
    base_length: float = 0.11
    """Distance L between the wheels, m."""
    lead: float = 0.025
    """Distance l from the axle to P, m."""
    wheel_speed: float = 12.5
    """Maximum wheel speed W, rad/s."""
    wheel_acceleration: float = math.inf
    """Maximum wheel acceleration A, rad/s²."""
    timeout: float = 0.2
    """Time without a new command after which the robot stops, s."""


def keep_apart(velocity: Sequence[float], near: ArrayLike, rooms: ArrayLike = 0.0) -> Pair:
    """Closest admissible velocity to a desired one, v, (x, y), m/s, for collision avoidance.

        min ‖x − v‖²   subject to   x·g_k ≤ c_k                    (buffered Voronoi cells)

    With c_k = 0 distances do not decrease while robots move, from directions alone. With
    c_k = (d_k − D)/(2 dt), for known distances d_k, they stay at least D (Zhou et al. 2017).

    Args:
        velocity: v.
        near: g_k, (k, 2), unit vectors to nearby robots, in the frame of the velocity.
        rooms: c_k, (k,) or one for all, m/s; negative values count as 0.

    Raises:
        ValueError: naming the argument with a wrong shape or a value that is not finite or not of
            unit length.
    """
    wanted, normals = _velocity(velocity), np.atleast_2d(floats("near", near))
    normals, most = normals if normals.size else normals.reshape(0, 2), floats("rooms", rooms)
    lengths, count = np.linalg.norm(normals, axis=-1, keepdims=True), len(normals)
    if normals.shape != (count, 2) or not (abs(lengths - 1.0) <= _OFF_UNIT).all():
        raise_invalid("near", normals.tolist(), "unit vectors, (k, 2)")
    if most.shape not in ((), (1,), (count,)) or np.isnan(most).any():
        raise_invalid(
            "rooms", most.tolist(), f"one number (m/s), or one for each of {count} directions"
        )
    most = np.maximum(np.broadcast_to(most, count), 0.0)
    x, y = nearest_within(wanted, normals / lengths, most, count)
    return float(x), float(y)


def _velocity(given: ArrayLike) -> Pair:
    pair = floats("velocity", given)
    if pair.shape != (2,) or not (abs(pair) <= LARGEST).all():
        raise_invalid("velocity", pair.tolist(), f"two finite numbers of at most {LARGEST:g} (m/s)")
    return float(pair[0]), float(pair[1])


class DifferentialDrive:
    """Wheel controller of one robot.

    Raises:
        ValueError: naming the invalid field of the machine, its value and the remedy.
    """

    def __init__(self, machine: Machine = Machine()) -> None:  # noqa: B008 - immutable
        if not isinstance(machine, Machine):
            raise_invalid("machine", machine, "a Machine")
        for name, value in machine._asdict().items():
            if not (name == "wheel_acceleration" and value == math.inf):
                positive(name, value)
        self.machine = machine
        self.reset()

    def reset(self) -> None:
        """Reset to rest without a command."""
        self.wheels: Pair = (0.0, 0.0)
        """Last commanded wheel speeds, left and right, rad/s."""
        self._wanted: Pair = (0.0, 0.0)
        self._age = 0.0

    def command(self, velocity: Sequence[float], yaw: float, dt: float) -> Pair:
        """Speed and turn rate (v, ω), m/s and rad/s, for a new velocity of P, dt s after the last.

        The velocity, m/s, is the output of a policy's ``act``, in the frame in which ``yaw``, rad,
        is the orientation of the body.

        Raises:
            ValueError: naming the argument; the state is unchanged.
        """
        machine, (x, y) = self.machine, _velocity(velocity)
        if not math.isfinite(to_float(yaw)):
            raise_invalid("yaw", yaw, "a finite number (rad)")
        positive("dt", dt, "s")
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, turn = c * x + s * y, 0.5 * machine.base_length * ((c * y - s * x) / machine.lead)
        left, right = (ahead - turn) / machine.wheel_radius, (ahead + turn) / machine.wheel_radius
        largest = max(abs(left), abs(right))
        factor = machine.wheel_speed * _BELOW / largest if largest > machine.wheel_speed else 1.0
        self._wanted, self._age = (left * factor, right * factor), 0.0
        return self._go(dt)

    def hold(self, dt: float) -> Pair:
        """As ``command`` without a new velocity: zero-order hold, and stop after ``timeout``."""
        self._age += positive("dt", dt, "s")
        if self._age >= self.machine.timeout:
            self._wanted = (0.0, 0.0)
        return self._go(dt)

    def _go(self, dt: float) -> Pair:
        """Accelerate both wheels; v = R (w_r + w_l)/2 and ω = R (w_r − w_l)/L."""
        machine, (left, right) = self.machine, self._wanted
        before, most = self.wheels, machine.wheel_acceleration * dt
        largest = max(abs(left - before[0]), abs(right - before[1]))
        if largest > most:
            left = before[0] + (left - before[0]) * most / largest
            right = before[1] + (right - before[1]) * most / largest
        self.wheels, radius = (left, right), machine.wheel_radius
        return 0.5 * radius * (left + right), radius * (right - left) / machine.base_length
