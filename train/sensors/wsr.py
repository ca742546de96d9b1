"""Result files of the Harvard-REACT WSR toolbox: angles of arrival of WiFi packets, JSON.

A file has experiments with a packet of each transmitter; times only number the experiments.
"""

import json
import math
from pathlib import Path
from typing import Any

from rendezvous_env.calibration import LogError, SensorLog, from_tables

_PACKETS = 10.0  # s between two experiments, so that ground truth is at each of them
Row = tuple[float, str, str, float]


def read_wsr(path: Path) -> SensorLog:
    """The log of a result file, or of all in a folder; the highest peak of each packet counts.

    Raises:
        LogError: naming the file, the experiment and the remedy.
    """
    files = sorted(path.glob("*.json")) if path.is_dir() else [path]
    rows: list[Row] = []
    poses: list[tuple[float, str, float, float, float]] = []
    for file in files:
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
        except ValueError as error:
            raise LogError(f"{file}: is not JSON ({error}); give a result file") from None
        for key, packets in found.items():
            time = _PACKETS * (len(poses) + 1)
            try:
                rows += [_row(time, file, packet) for packet in packets]
                poses += _poses(time, file, packets)
            except (KeyError, TypeError, ValueError) as error:
                raise LogError(
                    f"{file}, experiment {key}: {type(error).__name__} {error}; give a result file "
                    "of the WSR toolbox"
                ) from None
    columns = dict(
        zip(("time", "observer", "target", "bearing"), zip(*rows, strict=True), strict=True)
    )
    truth = dict(zip(("time", "robot", "x", "y", "heading"), zip(*poses, strict=True), strict=True))
    return from_tables(columns, truth, source=str(path), frames="detected", timed=False).noted(
        "times only number the experiments; nothing that depends on time is fitted"
    )


def _row(time: float, file: Path, packet: dict[str, Any]) -> Row:
    peaks = packet["d_INFO_AOA_profile"]["Top_N_peaks"]
    azimuth = math.radians(float(peaks["1"]["estimated_azimuth"]))
    return time, "receiver", str(packet["a_INFO_Transmitting_robot"]["Name"]), azimuth


def _poses(time: float, file: Path, packets: list[dict[str, Any]]) -> list[Any]:
    """Poses of the receiver and of its transmitters, which move between experiments."""
    start = packets[0]["b_INFO_Receiving_robot"]["groundtruth_start_position"]
    told = [(time, "receiver", float(start["x"]), float(start["y"]), 0.0)]
    for packet in packets:
        sender = packet["a_INFO_Transmitting_robot"]
        azimuth = math.radians(float(sender["groundtruth_azimuth"]))
        place = sender["groundtruth_position"]
        distance = math.hypot(place["x"] - start["x"], place["y"] - start["y"])
        x = start["x"] + distance * math.cos(azimuth)
        y = start["y"] + distance * math.sin(azimuth)
        told.append((time, str(sender["Name"]), x, y, 0.0))
    return told
