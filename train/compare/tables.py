"""Tables for the terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from rendezvous_env.scenario.scenario import Scenario

from .. import policies
from .ranking import Ranking
from .sweep import Sweep
from .sweep import rows_of as sweep_rows

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

_ROUNDING = 1e-9  # m²/s, of V

WIDTH = 118
"""Characters that the table needs; on a narrower terminal its lines wrap, and nothing is lost."""


def results_table(rows: Sequence[Mapping[str, Any]], scenarios: Mapping[str, Scenario]) -> Table:
    """The rows of results.csv for people.

    Args:
        rows: as ``statistics.summarise`` gives them.
        scenarios: by name; give the time limits.
    """
    table = Table(
        title="Policies on the same starts",
        box=None,
        header_style="bold",
        pad_edge=False,
        caption_justify="left",
    )
    for column in _COLUMNS:
        table.add_column(column, justify="left" if column == "policy" else "right", no_wrap=True)
    last = None
    for row in rows:
        if row["scenario"] != last:
            last = row["scenario"]
            count = row["episodes"]
            starts = "one start" if count == 1 else f"{count} starts"
            table.add_row(f"[bold]{escape(last)}[/bold], {starts}")
        scenario = scenarios[row["scenario"]]
        table.add_row(*_cells(row, scenario.max_steps * scenario.tau))
    table.caption = (
        "median: time-outs count as later than the limit; T/bound, V rise, clear, align: the worst "
        "of all starts\nV rise: the largest in a step up to its first merge, m²/s; none: V fell in "
        "every step, or stayed; contacts can raise it"
    )
    return table


def _cells(row: Mapping[str, Any], limit: float) -> tuple[str, ...]:
    return (
        f"  {escape(row['policy'])}",
        f"{100 * row['success']:.0f}",
        _percent(row["clean_success"], row["clean_low"], row["clean_high"]),
        _time_cell(row, limit),
        _number(row["time_over_bound"], ".2g"),
        _number(row["path_length"], ".1f"),
        _rise(row["max_rise_between_merges"]),
        _number(row["min_clearance"], ".2f"),
        _number(row["min_alignment"], ".2f"),
    )


def _rise(value: float) -> str:
    """Of V; a negative one says that V fell all the way."""
    return "none" if value <= _ROUNDING else f"{value:.2g}"


def _percent(value: float, low: float, high: float) -> str:
    """A share with its interval, if it has one; – where it does not apply."""
    if value != value:
        return "–"
    interval = f" [{100 * low:.0f}, {100 * high:.0f}]" if low == low else ""
    return f"{100 * value:.0f}{interval}"


def _time_cell(row: Mapping[str, Any], limit: float) -> str:
    """Median and interval, if it has one; a time at the limit is later than it."""
    median, low, high = (
        f"> {limit:.3g}" if row[name] >= limit else f"{row[name]:.3g}"
        for name in ("median_time", "time_low", "time_high")
    )
    has_interval = row["time_low"] < limit
    return f"{median} [{low}, {high}]" if has_interval else median


def _number(value: float, style: str) -> str:
    """A number, without a minus sign on a rounded zero; – where it does not apply."""
    return "–" if value != value else format(value, "z" + style)


def paired_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Rows of paired.csv for people: one policy against the others, start by start."""
    table = Table(
        title=f"Against {escape(rows[0]['against'])} on the same starts",
        box=None,
        header_style="bold",
        pad_edge=False,
        caption_justify="left",
        caption="points: of clean success; better: meeting cleanly and sooner on a start, a tie "
        "counts half; [95 % bootstrap intervals]",
    )
    for column in ("policy", "points", "better %"):
        table.add_column(column, justify="left" if column == "policy" else "right")
    last = None
    for row in rows:
        if row["scenario"] != last:
            last = row["scenario"]
            table.add_row(f"[bold]{escape(last)}[/bold]")
        ends = (
            ("clean_difference_low", "clean_difference_high"),
            ("improvement_low", "improvement_high"),
        )
        difference = [100 * row[name] for name in ("clean_difference", *ends[0])]
        better = (row[name] for name in ("probability_of_improvement", *ends[1]))
        table.add_row(f"  {escape(row['policy'])}", _points(*difference), _percent(*better))
    return table


def _points(value: float, low: float, high: float) -> str:
    """A difference in percentage points with its interval."""
    if value != value:
        return "–"
    interval = f" [{low:+z.1f}, {high:+z.1f}]" if low == low else ""
    return f"{value:+z.1f}{interval}"


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


_HEADING = 9
"""Characters of a line in which a scenario's name stands; longer names take more lines."""
_BETWEEN = 2
BEST, TIED = "*", "="


def show_matrix(rankings: Sequence[Ranking], console: Console) -> None:
    """Print the matrix, in as many parts as the console is too narrow for, and its marks."""
    for part in _parts(rankings, console.width):
        console.print(_table(part))
    for note in _notes(rankings):
        console.print(note)


def _parts(rankings: Sequence[Ranking], width: int) -> Iterator[Sequence[Ranking]]:
    """As many scenarios beside each other as fit beside the policies' names."""
    names = max(len(name) for ranking in rankings for name in ranking.share)
    columns = max(1, (width - min(names, width // 2)) // (_HEADING + _BETWEEN))
    for first in range(0, len(rankings), columns):
        yield rankings[first : first + columns]


def _table(rankings: Sequence[Ranking]) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, _BETWEEN, 0, 0))
    table.add_column("met cleanly, %", overflow="fold")
    for ranking in rankings:
        name = textwrap.fill(ranking.scenario, _HEADING)
        table.add_column(Text(name), justify="right", vertical="bottom", min_width=5)
    shown = dict.fromkeys(name for ranking in rankings for name in ranking.share)
    table.add_row("starts", *(Text(str(ranking.starts)) for ranking in rankings), style="dim")
    for name in sorted(shown, key=_order):
        table.add_row(escape(name), *(_cell(ranking, name) for ranking in rankings))
    return table


def _order(name: str) -> int:
    """References last; the others stay as they were asked for."""
    return int(policies.kind_of(name) == "privileged")


def _cell(ranking: Ranking, name: str) -> RenderableType:
    if name not in ranking.share:
        return ""
    value = ranking.share[name]
    text = percent(value, ranking.starts)
    if name == ranking.best and ranking.is_contest:
        return Text(f"{text}{BEST}", style="bold")
    mark = TIED if name in ranking.tied else " "
    return Text(f"{text}{mark}", style="dim" if name in ranking.references else "")


def percent(share: float, starts: int) -> str:
    """A share in per cent, with a digit after the point where there are starts to mean it; – where
    it does not apply.
    """
    return "–" if share != share else f"{100 * share:.{int(starts >= 400)}f}"


def _notes(rankings: Sequence[Ranking]) -> Iterator[str]:
    """What the marks mean that are there."""
    if any(ranking.is_contest for ranking in rankings):
        yield (
            f"{BEST} best of a scenario (among equals the soonest); {TIED} not told from it: the "
            "95 % bootstrap interval of the difference on the same starts holds 0"
        )
    if references := dict.fromkeys(name for ranking in rankings for name in ranking.references):
        yield (
            f"{', '.join(references)}: reference, knows the map and all positions; what it passes "
            "cleanly is possible"
        )
    if through := [ranking.scenario for ranking in rankings if _unknown(ranking)]:
        yield f"– in {', '.join(through)}: robots pass through obstacles, nothing is clean or not"


def _unknown(ranking: Ranking) -> bool:
    return any(value != value for value in ranking.share.values())


def show_sweeps(sweeps: Sequence[Sweep], rows: Sequence[dict[str, Any]], console: Console) -> None:
    """Print a table for each sweep: clean success and median time of each policy and level."""
    for sweep in sweeps:
        own = sweep_rows(sweep, rows)
        title = f"{sweep.base.name}: {sweep.field}, {own[0]['episodes']} starts"
        console.print(f"[bold]{escape(title)}[/bold]; met cleanly %, median s")
        console.print(_sweep_table(sweep, own))
        console.print()


def _sweep_table(sweep: Sweep, rows: Sequence[dict[str, Any]]) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("policy")
    for level in sweep.labels:
        table.add_column(level, justify="right")
    limit = sweep.base.max_steps * sweep.base.tau
    for policy in dict.fromkeys(row["policy"] for row in rows):
        own = [row for row in rows if row["policy"] == policy]
        table.add_row(escape(policy), *(_sweep_cell(row, limit) for row in own))
    return table


def _sweep_cell(row: dict[str, Any], limit: float) -> str:
    value = row["success"] if math.isnan(row["clean_success"]) else row["clean_success"]
    median = row["median_time"]
    time = f"> {limit:.3g}" if median >= limit else f"{median:.3g}"
    return f"{percent(value, row['episodes'])}, {time}"
