"""Recordings of the topics of ROS 2 nodes, rosbag2 or MCAP.

For each robot NAME a recording has ``/NAME/bearings``, std_msgs/Float64MultiArray, the angles that
its node receives, rad, and ``/NAME/pose``, geometry_msgs/PoseStamped, ground truth. Times are those
of recording, of one clock. examples/17_ros_recorder.py writes such files.
"""

import importlib.util
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.calibration import LogError, SensorLog, from_tables

from ..checks import UserError

_TOPIC = re.compile(r"/(?P<robot>[^/]+)/(?P<what>bearings|pose)")
TYPES = {"bearings": "std_msgs/msg/Float64MultiArray", "pose": "geometry_msgs/msg/PoseStamped"}
"""Message types of the topics."""
_FAR = 0.3  # rad; maximum angle between a bearing and its robot
_ASSIGNED = "bearings have no identity; each is assigned to the nearest robot by ground truth"
_UNSEEN = 0.5  # s; margin around the first and last pose within which a robot is assigned
_SAMPLE = 400  # messages from which the delay is estimated, s
_DELAYS = np.arange(-0.3, 1.001, 0.05)

Floats = NDArray[np.float64]


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
    check_rosbags(path)
    seen, poses = _messages(path)
    truth = _columns(("time", "robot", "x", "y", "z", "heading"), poses)
    if not np.asarray(truth["z"], np.float64).any():
        truth.pop("z")
    seen = [(t + clock_offset, robot, angles) for t, robot, angles in seen]
    rows = _identified(seen, _tracks(poses))
    return from_tables(
        _columns(("time", "observer", "target", "bearing"), rows), truth, source=str(path),
        frames="listed",
    ).noted(_ASSIGNED)  # fmt: skip


def check_rosbags(path: Path) -> None:
    """Raise a UserError if rosbags, a namespace package, is not installed."""
    if importlib.util.find_spec("rosbags") is None:
        raise UserError(f"{path} needs rosbags; pip install 'rendezvous-env[logs]'")


def _columns(names: tuple[str, ...], rows: list[Any]) -> dict[str, Any]:
    return {
        name: np.array(cells) for name, cells in zip(names, zip(*rows, strict=True), strict=True)
    }


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
                message: Any = reader.deserialize(raw, connection.msgtype)
                time, robot = 1e-9 * (stamp - start), found["robot"]
                if found["what"] == "bearings":
                    seen.append((time, robot, np.asarray(message.data, np.float64)))
                else:
                    poses.append((time, robot, *_pose(message)))
    except AnyReaderError as error:
        raise LogError(f"{path}: cannot be read ({error}); record it again") from None
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
        if one.msgtype != TYPES[found["what"]]:
            raise LogError(
                f"{path}: {one.topic} is {one.msgtype}; it must be {TYPES[found['what']]}"
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


def _identified(
    seen: list[tuple[float, str, Floats]], tracks: dict[str, Floats]
) -> list[tuple[float, str, str, float]]:
    """Rows (time, observer, target, bearing); an empty message is a row without target."""
    from scipy.optimize import linear_sum_assignment

    names = list(tracks)
    seen = [one for one in seen if one[1] in tracks]
    some = [one for one in seen if len(one[2])]
    some = some[:: max(1, len(some) // _SAMPLE)]
    spreads = [_spread(some, _true(some, tracks, delay)) for delay in _DELAYS]
    true = _true(seen, tracks, float(_DELAYS[int(np.argmin(spreads))]))
    rows = []
    for (time, robot, angles), bearings in zip(seen, true, strict=True):
        if not len(angles):
            rows.append((time, robot, "", math.nan))
            continue
        # a bearing far from all robots must not displace another one
        others = np.array([k for k, name in enumerate(names) if name != robot])
        apart = np.minimum(_apart(angles, bearings[others]), _FAR)
        found = zip(*linear_sum_assignment(apart), strict=True)
        rows += [(time, robot, names[others[j]], float(angles[i])) for i, j in found]
    return rows


def _true(seen: list[tuple[float, str, Floats]], tracks: dict[str, Floats], delay: float) -> Floats:
    """True bearings (M, n), rad, of all robots at M messages; NaN of the observer."""
    time = np.array([one[0] for one in seen]) - delay
    numbers = {name: k for k, name in enumerate(tracks)}
    own = np.arange(len(seen)), np.array([numbers[one[1]] for one in seen], np.int64)
    x, y, heading = (
        np.stack([np.interp(time, t[:, 0], t[:, k]) for t in tracks.values()], axis=-1)
        for k in (1, 2, 3)
    )
    bearing = np.arctan2(y - y[own][:, None], x - x[own][:, None]) - heading[own][:, None]
    bearing[own] = np.nan
    for k, track in enumerate(tracks.values()):  # robots that have merged have no pose any more
        late = (time < track[0, 0] - _UNSEEN) | (time > track[-1, 0] + _UNSEEN)
        bearing[late, k] = np.nan
    return bearing


def _apart(angles: Floats, bearings: Floats) -> Floats:
    """Angles (k, n) between measured (k,) and true bearings (n,); π where there is none."""
    apart = np.abs(np.angle(np.exp(1j * (angles[:, None] - bearings))))
    return np.nan_to_num(apart, nan=np.pi)


def _spread(seen: list[tuple[float, str, Floats]], true: Floats) -> float:
    """Mean angle to the nearest robot, clipped."""
    nearest = [
        np.minimum(_apart(one[2], bearings).min(axis=1), _FAR)
        for one, bearings in zip(seen, true, strict=True)
    ]
    return float(np.concatenate(nearest).mean()) if nearest else 0.0
