"""What comes of a training run, for the program that called it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import results

Row = Mapping[str, Any]
OnUpdate = Callable[[int, Row], bool | None]
"""Called after each update with its number and its metrics; True ends the run."""


@dataclass(frozen=True)
class Result:
    """A run at its end, or where it was stopped."""

    folder: Path
    """Of the run; ``learned_policy.load`` reads its policy, ``Config(resume=folder)`` goes on."""
    status: int
    """0, or 128 + the number of the signal that ended it."""
    stopped: bool
    """Whether ``on_update`` ended it."""
    steps: int
    """Decisions of all robots so far, those before a resumption too."""
    metrics: Row
    """Row of metrics.csv of the last update; empty if there was none."""
    evaluations: tuple[Row, ...]
    """Rows of evaluation.csv, those before a resumption too; NaN where a cell is empty."""

    @property
    def final(self) -> tuple[Row, ...]:
        """The last evaluation, a row for each scenario; empty without one."""
        return self._of_step(max((row["step"] for row in self.evaluations), default=None))

    @property
    def best(self) -> tuple[Row, ...]:
        """The evaluation with the largest ``score``, the first of equals; empty without one."""
        steps = dict.fromkeys(row["step"] for row in self.evaluations)
        return self._of_step(max(steps, key=lambda step: score(self._of_step(step)), default=None))

    def _of_step(self, step: int | None) -> tuple[Row, ...]:
        return tuple(row for row in self.evaluations if row["step"] == step)


def score(rows: tuple[Row, ...]) -> float:
    """Mean clean success over the scenarios of an evaluation, 0–1; plain success where robots pass
    through obstacles.
    """
    clean = [row["clean_success"] for row in rows]
    plain = [row["success"] for row in rows]
    values = [p if math.isnan(c) else c for c, p in zip(clean, plain, strict=True)]
    return sum(values) / len(values)


def read_evaluations(path: Path, step: int) -> tuple[Row, ...]:
    """The rows of an evaluation.csv up to a step, as numbers where they are some."""
    rows = results.read_csv(path) if path.exists() else []
    read = ({name: _value(name, cell) for name, cell in row.items()} for row in rows)
    return tuple(row for row in read if row["step"] <= step)


def _value(name: str, cell: str) -> Any:
    if name in ("step", "episodes"):
        return int(cell)
    with suppress(ValueError):
        return float(cell or "nan")
    return cell
