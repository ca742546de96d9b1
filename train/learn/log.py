"""Log of a training run: CSV files and the result object."""

import csv
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from statistics import fmean
from typing import Any

from rendezvous_env.checks import counted
from rendezvous_env.deprecation import RenamedKeys

from .. import results
from ..checks import UserError

METRICS = (
    "step", "update", "stage", "episodes", "success", "collision_free_success", "median_time",
    "return", "alignment", "policy_loss", "value_loss", "explained_variance", "approx_kl",
    "clip_fraction", "entropy", "learning_rate", "wall_s", "steps_per_s", "environment_share",
)  # fmt: skip
"""Columns of metrics.csv, one row per update: fractions in 0–1, times in s; empty if undefined."""
EVALUATION = ("step", *results.RESULT_COLUMNS)
"""Columns of evaluation.csv, one row per evaluation and scenario."""


class Table:
    """Append-only CSV file, truncated to a step when a run resumes.

    Rows after the step and an incomplete last row are removed by ``begin``. A damaged file is a
    UserError.
    """

    def __init__(self, path: Path, columns: Sequence[str], step: int) -> None:
        self._path, self._columns = path, list(columns)
        try:
            text = path.read_bytes().decode("utf-8") if path.exists() else ""
            whole = StringIO(text[: text.rfind("\n") + 1], newline="")
            header, *rows = list(csv.reader(whole)) or [self._columns]
        except (OSError, ValueError, csv.Error) as error:
            raise self._damaged(f"not readable ({error})") from error
        if results.current_columns(header) != self._columns:
            raise self._damaged(f"line 1 is not {','.join(columns)}")
        self._kept = []
        for number, row in enumerate(rows, start=2):
            if len(row) != len(columns):
                raise self._damaged(
                    f"line {number} has {counted(len(row), 'cell')}, not {len(columns)}"
                )
            cells = dict(zip(columns, row, strict=True))
            if not re.fullmatch(r"\d{1,19}", cells["step"], re.ASCII):
                said = f"line {number}: step is {cells['step']!r}; it must be an integer"
                raise self._damaged(said)
            if int(cells["step"]) <= step:
                self._kept.append(cells)

    def _damaged(self, what: str) -> UserError:
        return UserError(
            f"{self._path}: {what}; repair it, or move it away to continue without its rows"
        )

    def begin(self) -> None:
        """Write the rows that are kept."""
        results.write_csv(self._path, self._kept, self._columns)

    def add(self, row: Mapping[str, Any]) -> None:
        """Append a row; it is in the file when this returns."""
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file).writerow([results.plain(row[column]) for column in self._columns])


Row = Mapping[str, Any]
OnUpdate = Callable[[int, Row], bool | None]
"""Callback after each update with its number and metrics; True ends the run."""


@dataclass(frozen=True)
class Result:
    """Result of a finished or interrupted run."""

    folder: Path
    """Folder of the run: ``learned_policy.load`` reads its policy, ``Config(resume=folder)``
    resumes."""
    status: int  # 0, or 128 + signal number
    stopped: bool  # whether ``on_update`` ended it
    steps: int  # decisions of all robots so far, over all resumptions
    metrics: Row  # row of metrics.csv of the last update, if any
    evaluations: tuple[Row, ...]
    """Rows of evaluation.csv, those before a resumption too; NaN where a cell is empty."""

    @property
    def final(self) -> tuple[Row, ...]:
        """Last evaluation, one row per scenario; empty without one."""
        return max(self._by_step(), key=lambda rows: rows[0]["step"], default=())

    @property
    def best(self) -> tuple[Row, ...]:
        """Evaluation with the largest ``score``, the first of equals; empty without one."""
        return max(self._by_step(), key=score, default=())

    def _by_step(self) -> list[tuple[Row, ...]]:
        return [tuple(rows) for rows in results.grouped(self.evaluations, "step").values()]


def score(rows: tuple[Row, ...]) -> float:
    """Mean collision-free success over the scenarios of an evaluation, 0–1.

    Plain success where robots pass through obstacles.
    """
    shares = ((row["collision_free_success"], row["success"]) for row in rows)
    return fmean(success if math.isnan(clean) else clean for clean, success in shares)


def read_evaluations(path: Path, step: int) -> tuple[Row, ...]:
    """Rows of an evaluation.csv up to a step."""

    def value_of(name: str, cell: str) -> Any:
        if name in ("scenario", "policy"):
            return cell
        return int(cell) if name in ("step", "episodes") else float(cell or "nan")

    read = [{name: value_of(name, row[name]) for name in row} for row in results.read_csv(path)]
    return tuple(with_former_names(row) for row in read if row["step"] <= step)


def with_former_names(row: Mapping[str, Any]) -> dict[str, Any]:
    """Row whose columns also have their former names, with a DeprecationWarning."""
    return RenamedKeys(row, results.FORMER_COLUMNS)
