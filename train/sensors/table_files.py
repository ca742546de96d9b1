"""Tables in files, CSV or Parquet: ``bearings`` and ``poses`` in one folder."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.calibration import LogError, SensorLog, from_tables
from rendezvous_env.calibration.tables import BEARING_COLUMNS, POSE_COLUMNS
from rendezvous_env.checks import counted

from ..checks import check_installed

ENDINGS = (".csv", ".parquet")
_TEXTS = ("observer", "target", "robot")
_OPTIONAL = ("bearing", "elevation")
"""Columns of numbers that are empty in a row without target."""

Columns = dict[str, NDArray[Any]]


def table_in(folder: Path, name: str) -> Path | None:
    """The table of a name in a folder, if there is one."""
    found = [folder / f"{name}{ending}" for ending in ENDINGS]
    return next((path for path in found if path.is_file()), None)


def read_tables(folder: Path, clock_offset: float = 0.0, bearings: Path | None = None) -> SensorLog:
    """The log of ``bearings`` and ``poses`` in a folder.

    Raises:
        LogError: naming file, line and remedy.
    """
    seen = bearings or table_in(folder, "bearings")
    truth = table_in(folder, "poses")
    if seen is None or truth is None:
        missing = "bearings" if seen is None else "poses"
        raise LogError(
            f"{folder}: no {missing}.csv or {missing}.parquet; bearings have the columns "
            f"{', '.join(BEARING_COLUMNS)}, poses, which are ground truth, "
            f"{', '.join(POSE_COLUMNS)}"
        )
    return from_tables(
        read_table(seen), read_table(truth), source=str(folder), clock_offset=clock_offset
    )


def read_table(path: Path) -> Columns:
    """Columns of a CSV or Parquet file.

    Raises:
        LogError: naming the line and the remedy.
    """
    if path.suffix.lower() == ".parquet":
        return _read_parquet(path)
    return _read_csv(path)


def _read_parquet(path: Path) -> Columns:
    check_installed(str(path), "logs", "pyarrow")
    import pyarrow
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
    except (OSError, pyarrow.ArrowInvalid) as error:
        raise LogError(f"{path}: is not a Parquet file ({error}); write it again") from None
    return {name: table[name].to_numpy() for name in table.column_names}


def _read_csv(path: Path) -> Columns:
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    lines = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if _is_row(line)]
    if len(lines) < 2:
        raise LogError(f"{path}: has no rows; the first line has the names of the columns")
    delimiter = max(",;\t", key=lines[0][1].count)
    parsed = list(csv.reader([line for _, line in lines], delimiter=delimiter))
    names = [name.strip().lower() for name in parsed[0]]
    for (number, line), cells in zip(lines, parsed, strict=True):
        if len(cells) != len(names):
            raise LogError(
                f"{path}, line {number}: {line[:60]!r} has {counted(len(cells), 'cell')}, the "
                f"header has {len(names)}; correct or remove it"
            )
    columns = dict(zip(names, zip(*parsed[1:], strict=True), strict=True))
    numbers = [number for number, _ in lines[1:]]
    return {
        name: np.array(cells) if name in _TEXTS else _numbers(path, name, cells, numbers)
        for name, cells in columns.items()
        if name in (*BEARING_COLUMNS, *POSE_COLUMNS, "elevation", "z")
    }


def _is_row(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _numbers(
    path: Path, name: str, cells: tuple[str, ...], lines: list[int]
) -> NDArray[np.float64]:
    """A column of numbers; an empty cell is NaN where a row may lack the number."""
    try:
        return np.array(cells, np.float64)
    except ValueError:
        pass
    values = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        word = cell.strip()
        if not word and name in _OPTIONAL:
            continue
        try:
            values[row] = float(word)
        except ValueError:
            raise LogError(
                f"{path}, line {lines[row]}: {name} is {cell!r}; it must be a number: correct or "
                "remove the line"
            ) from None
    return values
