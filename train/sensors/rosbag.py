"""Recordings of the topics of ROS 2 nodes, rosbag2 or MCAP.

For each robot NAME a recording has ``/NAME/bearings``, std_msgs/Float64MultiArray, the angles that
its node receives, rad, and ``/NAME/pose``, geometry_msgs/PoseStamped, ground truth. Times are those
of recording, of one clock. examples/15_ros_recorder.py writes such files.
"""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from rendezvous_env.calibration import LogError, SensorLog, from_tables

from ..checks import check_installed

_TOPIC = re.compile(r"/(?P<robot>[^/]+)/(?P<what>bearings|pose)")
_TYPES = {"bearings": "std_msgs/msg/Float64MultiArray", "pose": "geometry_msgs/msg/PoseStamped"}
_FAR = 1e3


def is_recording(path: Path) -> bool:
    """True for a folder of rosbag2, or a file that one contains."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(path.glob("*.mcap"))
    return path.suffix.lower() in (".mcap", ".db3")


def read_recording(path: Path, clock_offset: float = 0.0) -> SensorLog:
    """The log of a recording; bearings without identity are assigned by ground truth.

    Raises:
        LogError: naming the topic and the remedy.
    """
    check_installed(str(path), "logs", "rosbags")
    seen, poses = _messages(path)
    truth = _columns(("time", "robot", "x", "y", "z", "heading"), poses)
    if not np.asarray(truth["z"], np.float64).any():
        truth.pop("z")
    tracks = _tracks(poses)
    rows: list[tuple[float, str, str, float]] = []
    for time, robot, angles in seen:
        rows += _assigned(time + clock_offset, robot, angles, tracks)
    return from_tables(
        _columns(("time", "observer", "target", "bearing"), rows), truth, source=str(path),
        frames="listed",
    ).noted("bearings have no identity; each is assigned to the robot nearest to it by ground truth")  # fmt: skip


def _columns(names: tuple[str, ...], rows: list[Any]) -> dict[str, Any]:
    return {name: np.array(cells) for name, cells in zip(names, zip(*rows, strict=True), strict=True)}


def _messages(path: Path) -> tuple[list[Any], list[Any]]:
    """Bearings (time, robot, angles) and poses (time, robot, x, y, z, heading)."""
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    folder = path if path.is_dir() or path.suffix == ".mcap" else path.parent
    seen, poses = [], []
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            used = _connections(path, reader.connections)
            start = reader.start_time
            for connection, stamp, raw in reader.messages(used):
                found = _TOPIC.fullmatch(connection.topic)
                assert found is not None
                message = reader.deserialize(raw, connection.msgtype)
                time, robot = 1e-9 * (stamp - start), found["robot"]
                if found["what"] == "bearings":
                    seen.append((time, robot, np.asarray(message.data, np.float64)))
                else:
                    poses.append((time, robot, *_pose(message)))
    except AnyReaderError as error:
        raise LogError(f"{path}: cannot be read ({error}); record it anew") from None
    for what, found_any in (("bearings", seen), ("pose", poses)):
        if not found_any:
            raise LogError(f"{path}: topics /NAME/{what} have no messages; record them as well")
    return seen, poses


def _connections(path: Path, connections: list[Any]) -> list[Any]:
    """Connections of known topics."""
    used = []
    for one in connections:
        found = _TOPIC.fullmatch(one.topic)
        if found is None:
            continue
        if one.msgtype != _TYPES[found["what"]]:
            raise LogError(
                f"{path}: {one.topic} is {one.msgtype}; it must be {_TYPES[found['what']]}"
            )
        used.append(one)
    if not used:
        topics = ", ".join(sorted({one.topic for one in connections})[:6]) or "none"
        raise LogError(
            f"{path}: no topics /NAME/bearings and /NAME/pose; topics are {topics}: record these"
        )
    return used


def _pose(message: Any) -> tuple[float, float, float, float]:
    """x, y, z, m, and heading, rad, of a PoseStamped."""
    place, q = message.pose.position, message.pose.orientation
    heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
    return place.x, place.y, place.z, heading


def _tracks(poses: list[Any]) -> dict[str, Any]:
    """Times, x, y and unwrapped headings of each robot."""
    robots = sorted({pose[1] for pose in poses})
    tables = {}
    for robot in robots:
        own = np.array([(t, x, y, h) for t, name, x, y, _, h in poses if name == robot])
        own[:, 3] = np.unwrap(own[:, 3])
        tables[robot] = own
    return tables


def _assigned(
    time: float, robot: str, angles: Any, tracks: dict[str, Any]
) -> list[tuple[float, str, str, float]]:
    """Rows of a message; an empty one is a row without target."""
    from scipy.optimize import linear_sum_assignment

    if not len(angles) or robot not in tracks:
        return [(time, robot, "", math.nan)] if not len(angles) else []
    x, y, heading = _at(tracks[robot], time)
    others = [name for name in tracks if name != robot]
    places = np.array([_at(tracks[name], time)[:2] for name in others])
    true = np.arctan2(places[:, 1] - y, places[:, 0] - x) - heading
    apart = np.abs(np.angle(np.exp(1j * (angles[:, None] - true))))
    rows, columns = linear_sum_assignment(apart)
    return [(time, robot, others[j], float(angles[i])) for i, j in zip(rows, columns, strict=True)]


def _at(track: Any, time: float) -> tuple[float, float, float]:
    x, y, heading = (float(np.interp(time, track[:, 0], column)) for column in track.T[1:])
    return x, y, heading
