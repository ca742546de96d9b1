"""Messages of one robot's sensors, checked: angles in its body in, bearings in a frame at rest out.

Plain numbers, as any middleware has them; the node of examples/14_ros_node.py passes those of ROS.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.scenario.observation_layout import ObservationLayout

TOPICS = ("imu", "bearings", "edges")
"""What a robot waits for."""
_OFF_UNIT = 1e-2  # by which the square of a quaternion's length may differ from 1
Angles = NDArray[np.float64]


class Readings(NamedTuple):
    """What ``RobotPolicy.act`` takes, in a frame that does not turn, and the body's yaw in it."""

    bearings: NDArray[np.float64]  # (k, 2), unit vectors
    obstacles: NDArray[np.float64]  # (m, 2, 2), unit vectors
    yaw: float  # rad


def yaw_of(orientation: Sequence[float], covariance: Sequence[float] = ()) -> float | None:
    """Yaw, rad, of a quaternion x, y, z, w; None where there is no estimate, which a negative first
    entry of the covariance says (sensor_msgs/Imu), or where it is no finite unit quaternion.
    """
    if len(covariance) and covariance[0] < 0.0:
        return None
    x, y, z, w = (float(part) for part in orientation)
    if not abs(x * x + y * y + z * z + w * w - 1.0) <= _OFF_UNIT:  # NaN, too
        return None
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def angles_of(data: ArrayLike, most: int, width: int = 1) -> Angles | None:
    """Angles (k, width), rad, of a flat list; None where one is not finite, where they are no
    multiple of ``width``, or where there are more than ``most`` rows.
    """
    try:
        angles = np.asarray(data, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        return None
    if angles.size % width or angles.size > most * width or not np.isfinite(angles).all():
        return None
    return angles.reshape(-1, width)


class BodyReadings:
    """The newest orientation, bearings and edges of one robot in the plane.

        readings = BodyReadings(scenario.observation_layout)
        readings.see_orientation(now, (x, y, z, w), covariance)     # each as its message comes
        readings.see_bearings(now, angles)
        readings.see_edges(now, angles)
        seen = readings.at(now)                                     # None: rest

    A message that is malformed, or that comes while no orientation is known, is dropped and counted
    in ``dropped``, by topic; what was heard before it counts until it is too old. Angles are
    counter-clockwise from the body's x axis, rad, and times s of a clock that only goes forward.

    Args:
        layout: of the scenario: so many neighbours and obstacles there may be.
        max_age: s; a robot that has not heard one of the TOPICS for so long rests.
    """

    def __init__(self, layout: ObservationLayout, max_age: float = 0.2) -> None:
        self._layout, self.max_age = layout, max_age
        self.yaw = 0.0
        """Newest, rad."""
        self.heard_at = dict.fromkeys(TOPICS, -math.inf)
        """When the last message of each topic came that could be used, s."""
        self.dropped = dict.fromkeys(TOPICS, 0)
        """How many messages of each topic could not be used."""
        self._bearings, self._edges = np.zeros((0, 1)), np.zeros((0, 2))

    def see_orientation(
        self, now: float, orientation: Sequence[float], covariance: Sequence[float] = ()
    ) -> bool:
        """Take a quaternion x, y, z, w and its covariance; whether it could be used."""
        yaw = yaw_of(orientation, covariance)
        if yaw is not None:
            self.yaw = yaw
        return self._note("imu", now, yaw)

    def see_bearings(self, now: float, angles: ArrayLike) -> bool:
        """Take the bearings of all neighbours in sight, (k,); whether they could be used."""
        found = self._turned(now, angles_of(angles, self._layout.neighbour_slots))
        if found is not None:
            self._bearings = found
        return self._note("bearings", now, found)

    def see_edges(self, now: float, angles: ArrayLike) -> bool:
        """Take both edges of all obstacles in sight, (2 m,); whether they could be used."""
        found = self._turned(now, angles_of(angles, self._layout.obstacle_slots, 2))
        if found is not None:
            self._edges = found
        return self._note("edges", now, found)

    def at(self, now: float) -> Readings | None:
        """What is seen now; None where one of the topics is missing or too old."""
        if not now - min(self.heard_at.values()) < self.max_age:
            return None
        bearings = np.stack([np.cos(self._bearings), np.sin(self._bearings)], axis=-1)[:, 0]
        edges = np.stack([np.cos(self._edges), np.sin(self._edges)], axis=-1)
        return Readings(bearings, edges, self.yaw)

    def _turned(self, now: float, angles: Angles | None) -> Angles | None:
        """Angles in a frame that does not turn; None while no orientation is known."""
        known = now - self.heard_at["imu"] < self.max_age
        return self.yaw + angles if known and angles is not None else None

    def _note(self, topic: str, now: float, found: Any) -> bool:
        if found is None:
            self.dropped[topic] += 1
            return False
        self.heard_at[topic] = now
        return True
