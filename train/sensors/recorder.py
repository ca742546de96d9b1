"""Writer of recordings that ``rendezvous sensor`` reads: bearings and poses of robots, as MCAP."""

import math
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from .rosbag import TYPES, check_rosbags


class Recorder:
    """Context that writes a rosbag2 folder of topics ``/NAME/bearings`` and ``/NAME/pose``.

    Args:
        path: folder, which must not exist.

    Raises:
        UserError: if rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        check_rosbags(path)
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> Self:
        self._writer.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.close()

    def write(self, robot: str, what: str, time: int, raw: bytes) -> None:
        """Write a serialised message of a robot's topic, bearings or pose, received at time, ns."""
        topic = f"/{robot}/{what}"
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, TYPES[what], typestore=self._store
            )
        self._writer.write(self._connections[topic], time, raw)

    def write_bearings(self, robot: str, time: float, angles: Sequence[float]) -> None:
        """Write the angles, rad, of all robots that one detects at a time, s."""
        types = self._store.types
        layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        message = types[TYPES["bearings"]](layout=layout, data=np.asarray(angles, np.float64))
        self._write(robot, "bearings", time, message)

    def write_pose(self, robot: str, time: float, place: Sequence[float], heading: float) -> None:
        """Write a robot's ground truth: x, y, z, m, and heading, rad, at a time, s."""
        types = self._store.types
        half = 0.5 * heading
        turned = types["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)
        )
        at = types["geometry_msgs/msg/Point"](*(float(one) for one in place))
        stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="world")
        pose = types["geometry_msgs/msg/Pose"](position=at, orientation=turned)
        self._write(robot, "pose", time, types[TYPES["pose"]](header=header, pose=pose))

    def _write(self, robot: str, what: str, time: float, message: Any) -> None:
        raw = self._store.serialize_cdr(message, TYPES[what])
        self.write(robot, what, round(time * 1e9), bytes(raw))
