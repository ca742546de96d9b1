"""Validation of one robot's sensor messages, and conversion to a frame that does not turn.

Inputs are angles in the body frame, as plain numbers of any middleware. The node of
examples/14_ros_node.py passes those of ROS.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.scenario.observation_layout import ObservationLayout

TOPICS = ("imu", "bearings", "edges")
"""Required message topics."""
_OFF_UNIT = 1e-2  # tolerance of the squared length of a quaternion
Angles = NDArray[np.float64]


class Readings(NamedTuple):
    """Arguments of ``RobotPolicy.act`` in a frame that does not turn, and the body's yaw in it."""

    bearings: NDArray[np.float64]  # (k, 2), unit vectors
    obstacles: NDArray[np.float64]  # (m, 2, 2), unit vectors
    yaw: float  # rad


def yaw_of(orientation: Sequence[float], covariance: Sequence[float] = ()) -> float | None:
    """Yaw, rad, of a quaternion x, y, z, w; None if it is not available.

    That is, if the first entry of the covariance is negative (sensor_msgs/Imu), or if it is not a
    finite unit quaternion.
    """
    if len(covariance) and covariance[0] < 0.0:
        return None
    x, y, z, w = (float(part) for part in orientation)
    if not abs(x * x + y * y + z * z + w * w - 1.0) <= _OFF_UNIT:  # also NaN
        return None
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def angles_of(data: ArrayLike, most: int, width: int = 1) -> Angles | None:
    """Angles (k, width), rad, of a flat list; None if the list is invalid.

    That is, if an angle is not finite, the number is no multiple of ``width``, or there are more
    than ``most`` rows.
    """
    try:
        angles = np.asarray(data, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        return None
    if angles.size % width or angles.size > most * width or not np.isfinite(angles).all():
        return None
    return angles.reshape(-1, width)


class BodyReadings:
    """Latest orientation, bearings and edges of one planar robot.

        readings = BodyReadings(scenario.observation_layout)
        readings.see_orientation(now, (x, y, z, w), covariance)     # on each message
        readings.see_bearings(now, angles)
        readings.see_edges(now, angles)
        seen = readings.at(now)                                     # None: rest

    A malformed message, or one without a known orientation, is dropped and counted in ``dropped``,
    by topic. The previous message then stays valid until it is too old. Angles are
    counter-clockwise from the body's x axis, rad. Times are s of a monotonic clock.

    Args:
        layout: layout of the scenario, which limits the numbers of neighbours and obstacles.
        max_age: maximum age of the last message of each topic, s; beyond it the robot rests.
    """

    def __init__(self, layout: ObservationLayout, max_age: float = 0.2) -> None:
        self._layout, self.max_age = layout, max_age
        self.yaw = 0.0
        """Latest yaw, rad."""
        self.heard_at = dict.fromkeys(TOPICS, -math.inf)
        """Time of the last valid message of each topic, s."""
        self.dropped = dict.fromkeys(TOPICS, 0)
        """Number of dropped messages of each topic."""
        self._bearings, self._edges = np.zeros((0, 1)), np.zeros((0, 2))

    def see_orientation(
        self, now: float, orientation: Sequence[float], covariance: Sequence[float] = ()
    ) -> bool:
        """Store a quaternion x, y, z, w with its covariance; returns whether it is valid."""
        yaw = yaw_of(orientation, covariance)
        if yaw is not None:
            self.yaw = yaw
        return self._note("imu", now, yaw)

    def see_bearings(self, now: float, angles: ArrayLike) -> bool:
        """Store the bearings of all visible neighbours, (k,); returns whether they are valid."""
        found = self._turned(now, angles_of(angles, self._layout.neighbour_slots))
        if found is not None:
            self._bearings = found
        return self._note("bearings", now, found)

    def see_edges(self, now: float, angles: ArrayLike) -> bool:
        """Store both edges of all visible obstacles, (2 m,); returns whether they are valid."""
        found = self._turned(now, angles_of(angles, self._layout.obstacle_slots, 2))
        if found is not None:
            self._edges = found
        return self._note("edges", now, found)

    def at(self, now: float) -> Readings | None:
        """Current readings; None if one of the topics is missing or too old."""
        if not now - min(self.heard_at.values()) < self.max_age:
            return None
        bearings = np.stack([np.cos(self._bearings), np.sin(self._bearings)], axis=-1)[:, 0]
        edges = np.stack([np.cos(self._edges), np.sin(self._edges)], axis=-1)
        return Readings(bearings, edges, self.yaw)

    def _turned(self, now: float, angles: Angles | None) -> Angles | None:
        """Angles in a frame that does not turn; None without a known orientation."""
        known = now - self.heard_at["imu"] < self.max_age
        return self.yaw + angles if known and angles is not None else None

    def _note(self, topic: str, now: float, found: Any) -> bool:
        if found is None:
            self.dropped[topic] += 1
            return False
        self.heard_at[topic] = now
        return True
