"""What policies do at each level of a sensor's field: levels.csv and tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from .. import results
from ..unfinished import Part
from .levels import Sweep
from .matrix import percent

COLUMNS = ("base", "field", "level", *results.RESULT_COLUMNS)
"""Of levels.csv: a scenario, a field of its sensor and the level at which it stands; then the row
of results.csv. A level is empty where the field is that of an exact sensor and no number."""


def rows_of(sweep: Sweep, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of levels.csv that belong to a sweep.

    Args:
        sweep: scenario, field and levels.
        rows: of results.csv.
    """
    return [
        {"base": sweep.base.name, "field": sweep.field, "level": level} | row
        for level, scenario in zip(sweep.levels, sweep.scenarios, strict=True)
        for row in rows
        if row["scenario"] == scenario.name
    ]


def write(part: Part, sweeps: Sequence[Sweep], rows: Sequence[dict[str, Any]]) -> list[str]:
    """Write levels.csv; its name."""
    found = [row for sweep in sweeps for row in rows_of(sweep, rows)]
    results.write_csv(part.folder / "levels.csv", COLUMNS, found)
    return ["levels.csv"]


def show(sweeps: Sequence[Sweep], rows: Sequence[dict[str, Any]], console: Console) -> None:
    """Print a table for each sweep: clean success and median time of each policy and level."""
    for sweep in sweeps:
        own = rows_of(sweep, rows)
        title = f"{sweep.base.name}: {sweep.field}, {own[0]['episodes']} starts"
        console.print(f"[bold]{escape(title)}[/bold]; met cleanly %, median s")
        console.print(_table(sweep, own))
        console.print()


def _table(sweep: Sweep, rows: Sequence[dict[str, Any]]) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("policy")
    for level in sweep.labels:
        table.add_column(level, justify="right")
    limit = sweep.base.max_steps * sweep.base.tau
    for policy in dict.fromkeys(row["policy"] for row in rows):
        own = [row for row in rows if row["policy"] == policy]
        table.add_row(escape(policy), *(_cell(row, limit) for row in own))
    return table


def _cell(row: dict[str, Any], limit: float) -> str:
    value = row["success"] if math.isnan(row["clean_success"]) else row["clean_success"]
    median = row["median_time"]
    time = f"> {limit:.3g}" if median >= limit else f"{median:.3g}"
    return f"{percent(value, row['episodes'])}, {time}"
