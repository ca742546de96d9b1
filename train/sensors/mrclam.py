"""Folders of the UTIAS MRCLAM data sets (Leung, Halpern, Barfoot and Liu, IJRR 30(8), 2011).

``RobotN_Measurement.dat`` has time s, bar code, range m and bearing rad; ``RobotN_Groundtruth.dat``
time s, x m, y m and heading rad; ``Barcodes.dat`` maps subjects to bar codes; landmarks with their
places are in ``Landmark_Groundtruth.dat``. Lines that begin with # are comments.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.calibration import LogError, SensorLog, from_tables

Floats = NDArray[np.float64]


def is_mrclam(folder: Path) -> bool:
    """True for a folder of such a data set."""
    return (folder / "Barcodes.dat").is_file() or any(folder.glob("Robot*_Measurement.dat"))


def read_mrclam(folder: Path, clock_offset: float = 0.0) -> SensorLog:
    """The log of a folder; only frames with a detection count.

    Raises:
        LogError: naming file, line and remedy.
    """
    subjects = _barcodes(folder / "Barcodes.dat")
    robots = sorted(
        int(found[1])
        for path in folder.glob("Robot*_Measurement.dat")
        if (found := re.fullmatch(r"Robot(\d+)_Measurement", path.stem))
    )
    if not robots:
        raise LogError(f"{folder}: no file RobotN_Measurement.dat; give the folder of a data set")
    rows, poses = [], []
    for robot in robots:
        truth = folder / f"Robot{robot}_Groundtruth.dat"
        if not truth.is_file():
            raise LogError(f"{truth}: is missing; ground truth of each robot is needed")
        table = read_numbers(truth, 4, "time s, x m, y m, heading rad")
        poses.append(_with(table, robot))
        seen = read_numbers(
            folder / f"Robot{robot}_Measurement.dat", 4, "time s, bar code, range m, bearing rad"
        )
        rows += [(t, robot, subjects.get(int(c), f"barcode {int(c)}"), b) for t, c, _, b in seen]
    poses += _landmarks(folder / "Landmark_Groundtruth.dat", poses[0][0, 0], set(robots))
    time, observer, target, bearing = zip(*rows, strict=True)
    columns = {
        "time": np.array(time), "observer": np.array(observer),
        "target": np.array([str(one) for one in target]), "bearing": np.array(bearing),
    }  # fmt: skip
    return from_tables(
        columns, np.concatenate(poses), source=str(folder), clock_offset=clock_offset,
        frames="detected",
    )  # fmt: skip


def _with(table: Floats, robot: int) -> Floats:
    """Columns time, robot, x, y, heading."""
    return np.column_stack([table[:, 0], np.full(len(table), float(robot)), table[:, 1:4]])


def _barcodes(path: Path) -> dict[int, int]:
    """Subjects by bar code."""
    if not path.is_file():
        raise LogError(f"{path}: is missing; it maps bar codes to subjects")
    table = read_numbers(path, 2, "subject, bar code").astype(np.int64)
    codes, counts = np.unique(table[:, 1], return_counts=True)
    if (counts > 1).any():
        raise LogError(f"{path}: bar code {codes[counts > 1][0]} has two subjects; correct one")
    return {int(code): int(subject) for subject, code in table}


def _landmarks(path: Path, time: float, robots: set[int]) -> list[Floats]:
    """Poses of landmarks, as poses at one time; none without the file."""
    if not path.is_file():
        return []
    table = read_numbers(path, 3, "subject, x m, y m")
    return [
        np.array([[time, subject, x, y, 0.0]])
        for subject, x, y in table[:, :3]
        if int(subject) not in robots
    ]


def read_numbers(path: Path, least: int, columns: str) -> Floats:
    """Numbers of a file, one row per line; lines that begin with # are comments.

    Raises:
        LogError: naming the line and the remedy, unless each has ``least`` finite numbers or more.
    """
    try:
        table = np.loadtxt(path, comments="#", ndmin=2, encoding="utf-8", dtype=np.float64)
        if len(table) and table.shape[1] >= least and np.isfinite(table).all():
            return table
    except (ValueError, UnicodeDecodeError):
        pass
    return _read_lines(path, least, columns)


def _read_lines(path: Path, least: int, columns: str) -> Floats:
    rows = []
    text = path.read_text(encoding="utf-8", errors="replace")
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            row = [float(word) for word in words[:least]]
        except ValueError:
            row = []
        if len(row) < least or not np.isfinite(row).all():
            raise LogError(
                f"{path}, line {number}: {line.strip()[:60]!r}; a line has {columns}: correct or "
                "remove it"
            )
        rows.append(row)
    if not rows:
        raise LogError(f"{path}: has no rows; a line has {columns}")
    return np.array(rows)
