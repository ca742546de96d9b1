"""Reads a log of any known format."""

from pathlib import Path

from rendezvous_env.calibration import LogError, SensorLog

from ..checks import UserError
from . import mrclam, rosbag, table_files, wsr

FORMATS = (
    "a folder of MRCLAM files, a folder with tables bearings and poses (.csv or .parquet), a "
    "rosbag2 or MCAP recording, or WSR result files (.json)"
)


def read_log(path: Path, clock_offset: float = 0.0) -> SensorLog:
    """The log at a path.

    Args:
        path: file or folder of one of FORMATS.
        clock_offset: s, added to the times of bearings.

    Raises:
        UserError: naming the file, the line and the remedy.
    """
    if not path.exists():
        raise UserError(f"{path}: does not exist; give {FORMATS}")
    try:
        return _read(path, clock_offset)
    except LogError as error:
        raise UserError(str(error)) from None


def _read(path: Path, clock_offset: float) -> SensorLog:
    if rosbag.is_recording(path):
        return rosbag.read_recording(path, clock_offset)
    if path.suffix.lower() == ".json" or (path.is_dir() and _only_json(path)):
        return wsr.read_wsr(path)
    if path.is_dir() and mrclam.is_mrclam(path):
        return mrclam.read_mrclam(path, clock_offset)
    if path.is_dir() and any(table_files.table_in(path, one) for one in ("bearings", "poses")):
        return table_files.read_tables(path, clock_offset)
    if path.suffix.lower() in table_files.ENDINGS:
        return table_files.read_tables(path.parent, clock_offset, path)
    raise LogError(f"{path}: its format is unknown; give {FORMATS}")


def _only_json(folder: Path) -> bool:
    """True for a folder of JSON files without tables."""
    return any(folder.glob("*.json")) and not any(folder.glob("*.csv"))
