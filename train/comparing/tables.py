"""Tables for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from baselines import privileged_planner
from rendezvous_env.experiment.scenario import Scenario

_COLUMNS = (
    "policy",
    "met %",
    "cleanly % [95 %]",
    "median s [95 %]",
    "T/bound",
    "path m",
    "V rise",
    "clear m",
    "align",
)

WIDTH = 118
"""Characters that the table needs; on a narrower terminal its lines wrap, and nothing is lost."""


def results_table(rows: Sequence[Mapping[str, Any]], scenarios: Mapping[str, Scenario]) -> Table:
    """The rows of results.csv for people.

    Args:
        rows: as ``statistics.summarise`` gives them.
        scenarios: by name; give the time limits.
    """
    table = Table(
        title="Policies on the same starts", box=None, header_style="bold", pad_edge=False
    )
    for column in _COLUMNS:
        table.add_column(column, justify="left" if column == "policy" else "right", no_wrap=True)
    last = None
    for row in rows:
        if row["scenario"] != last:
            last = row["scenario"]
            table.add_row(f"[bold]{last}[/bold]")
        scenario = scenarios[row["scenario"]]
        table.add_row(*_cells(row, scenario.max_steps * scenario.tau))
    table.caption = (
        "median: time-outs count as later than the limit; T/bound, V rise between merges (m²/s), "
        "clearance,\nalignment: the worst of all starts; V rise 0: it never rose, and contacts can "
        "raise it"
    )
    if any(row["policy"] == privileged_planner.NAME for row in rows):
        table.caption += (
            f"\n{privileged_planner.NAME} knows the map and all positions: what it passes cleanly "
            "is possible"
        )
    return table


def _cells(row: Mapping[str, Any], limit: float) -> tuple[str, ...]:
    return (
        f"  {row['policy']}",
        f"{100 * row['success']:.0f}",
        _percent(row["clean_success"], row["clean_low"], row["clean_high"]),
        _time_cell(row, limit),
        _number(row["time_over_bound"], ".2g"),
        _number(row["path_length"], ".1f"),
        "0" if row["max_rise_between_merges"] <= 1e-9 else f"{row['max_rise_between_merges']:.2g}",
        _number(row["min_clearance"], ".2f"),
        _number(row["min_alignment"], ".2f"),
    )


def _percent(value: float, low: float, high: float) -> str:
    return f"{100 * value:.0f} [{100 * low:.0f}, {100 * high:.0f}]"


def _time_cell(row: Mapping[str, Any], limit: float) -> str:
    """Median and interval; a time at the limit is later than it."""
    if row["time_low"] >= limit:
        return f"> {limit:.3g}"
    median, low, high = (
        f"> {limit:.3g}" if row[name] >= limit else f"{row[name]:.3g}"
        for name in ("median_time", "time_low", "time_high")
    )
    return f"{median} [{low}, {high}]"


def _number(value: float, style: str) -> str:
    """A number, without a minus sign on a rounded zero; – where it does not apply."""
    return "–" if value != value else format(value, "z" + style)


def ceiling_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """The rows of ceiling.csv for people."""
    table = Table(
        title="What can be reached: by a planner, and by law (4), the best of its randomised runs",
        box=None,
        header_style="bold",
        pad_edge=False,
    )
    columns = ("planner cleanly %", "cleanly %", "met %", "mean run cleanly %", "never cleanly")
    for column in ("scenario", "runs", *columns):
        table.add_column(column, justify="left" if column == "scenario" else "right")
    for row in rows:
        names = ("clean_planner", "clean_best", "success_best", "clean_mean")
        table.add_row(
            row["scenario"],
            str(row["runs"]),
            *(_number(100 * row[name], ".1f") for name in names),
            f"{row['never_clean']} of {row['episodes']}",
        )
    return table
