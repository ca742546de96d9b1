"""Tables for the terminal."""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from rendezvous_env.checks import counted
from rendezvous_env.scenario.scenario import Scenario

from ..console import Console
from ..results import grouped
from .ranking import NONE_MET, ONE_START, Ranking
from .statistics import rounding_of_clearance, rounding_of_v
from .sweep import Sweep, rows_of

WIDTH = 118
"""Width of the table, characters; lines wrap on narrower terminals."""

Row = Mapping[str, Any]


def _empty(*columns: str, **options: Any) -> Table:
    """Table without rules; names in the first column, numbers right-aligned."""
    table = Table(box=None, header_style="bold", pad_edge=False, caption_justify="left", **options)
    for number, column in enumerate(columns):
        table.add_column(column, justify="right" if number else "left")
    return table


def results_table(rows: Sequence[Row], scenarios: Mapping[str, Scenario]) -> Table:
    """Table of the rows of results.csv; scenarios by name provide the time limits."""
    columns = ("policy", "met %", "collision-free % [95 %]", "median s [95 %]", "T/bound", "path m")
    table = _empty(*columns, "V rise", "clear m", "align", title="Policies")
    for column in table.columns:
        column.no_wrap = True
    for name, own in grouped(rows, "scenario").items():
        first, scenario = own[0], scenarios[name]
        limit, rounding = scenario.max_steps * scenario.tau, rounding_of_v(scenario)
        episodes = counted(first["episodes"], "episode")
        table.add_row(f"{name}, {episodes}", style="bold")
        for row in own:
            times = (_time(row[name], limit) for name in ("median_time", "time_low", "time_high"))
            median, low, high = times
            table.add_row(
                f"  {row['policy']}",
                f"{100 * row['success']:.0f}",
                _percent(row, "collision_free_success", "collision_free"),
                f"{median} [{low}, {high}]" if row["time_low"] < limit else median,
                number(row["time_over_bound"], ".2g"),
                _metres(row["path_length"], 1),
                "none" if (rise := row["max_rise_between_merges"]) <= rounding else f"{rise:.2g}",
                _clearance(row["min_clearance"], scenario),
                number(row["min_alignment"], ".2f"),
            )
    table.caption = (
        "initial conditions are the same for all policies\n"
        "median: time-outs count as later than the limit; T/bound, V rise, clear, align: the worst "
        "of all episodes\n"
        "V rise: the largest in a step up to its first merge, m²/s; none: V fell in every step, or "
        "stayed; contacts can raise it"
    )
    return table


def _percent(row: Row, value: str, interval: str, style: str = ".0f") -> str:
    """Percentage with its interval, if any; – if not applicable."""
    value, low, high = (row[name] for name in (value, f"{interval}_low", f"{interval}_high"))
    if value != value:
        return "–"
    cells = [format(100 * number, style) for number in (value, low, high)]
    return f"{cells[0]} [{cells[1]}, {cells[2]}]" if low == low else cells[0]


def number(value: float, style: str) -> str:
    """Format a number without negative zero; – if not applicable."""
    return "–" if value != value else format(value, "z" + style)


def _metres(value: float, digits: int) -> str:
    """Format a length with a number of decimals, or with two significant digits if all are 0."""
    return number(value, ".2g" if 0.0 < abs(value) < 10.0**-digits else f".{digits}f")


def _clearance(value: float, scenario: Scenario) -> str:
    """Format a clearance, m; that of a contact is 0 up to rounding."""
    return _metres(0.0 if abs(value) < rounding_of_clearance(scenario) else value, 2)


def paired_table(rows: Sequence[Row]) -> Table:
    """Table of the rows of paired.csv."""
    table = _empty(
        *("policy", "points", "better %"),
        title=f"Against {rows[0]['against']}, same initial conditions",
        caption="points: of collision-free success; better: without a collision and sooner, "
        "a tie counts half; [95 % intervals]",
    )
    for name, own in grouped(rows, "scenario").items():
        table.add_row(name, style="bold")
        for row in own:
            points = _percent(
                row, "collision_free_difference", "collision_free_difference", "+z.1f"
            )
            better = _percent(row, "probability_of_improvement", "improvement")
            table.add_row(f"  {row['policy']}", points, better)
    return table


def ceiling_table(rows: Sequence[Row]) -> Table:
    """Table of the rows of ceiling.csv: collision-free success, of all runs also success, %."""
    columns = ("planner", "any run", "any run met", "mean run", "never")
    title = "What can be reached: by a planner, and by law (4), the best of its randomised runs"
    table = _empty("scenario", "runs", *columns, title=title)
    for row in rows:
        names = (
            "collision_free_planner", "collision_free_best", "success_best", "collision_free_mean",
        )  # fmt: skip
        shares = (number(100 * row[name], ".1f") for name in names)
        never = f"{row['never_collision_free']} of {row['episodes']}"
        table.add_row(row["scenario"], str(row["runs"]), *shares, never)
    return table


_HEADING, _LONGEST_WORD = 9, 14
"""Minimum and maximum line length of a scenario's name, characters."""
_BETWEEN = 2
BEST, TIED = "*", "="


def show_matrix(rankings: Sequence[Ranking], console: Console) -> None:
    """Print the matrix, split if the console is too narrow, with a legend of its marks."""
    names = max(len(name) for ranking in rankings for name in ranking.share)
    room = console.width - min(names, console.width // 2)
    words = (len(word) + 1 for ranking in rankings for word in ranking.scenario.split("-"))
    heading = min(max(_HEADING, *words), _LONGEST_WORD)
    columns = max(1, room // (heading + _BETWEEN))
    for first in range(0, len(rankings), columns):
        console.print(_matrix(rankings[first : first + columns], heading))
    for note in _notes(rankings):
        console.print(note)


def _matrix(rankings: Sequence[Ranking], heading: int) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, _BETWEEN, 0, 0))
    table.add_column("collision-free, %", overflow="fold")
    for ranking in rankings:
        name = textwrap.fill(ranking.scenario, heading)
        table.add_column(Text(name), justify="right", vertical="bottom", min_width=5)
    shown = dict.fromkeys(name for ranking in rankings for name in ranking.share)
    table.add_row("episodes", *(Text(str(ranking.count)) for ranking in rankings), style="dim")
    references = {name for ranking in rankings for name in ranking.references}
    for name in sorted(shown, key=lambda name: name in references):
        table.add_row(name, *(_cell(ranking, name) for ranking in rankings))
    return table


def _cell(ranking: Ranking, name: str) -> RenderableType:
    if name not in ranking.share:
        return ""
    text = percent(ranking.share[name], ranking.count)
    if name == ranking.best and ranking.is_contest:
        return Text(f"{text}{BEST}", style="bold")
    mark = TIED if name in ranking.tied else " "
    return Text(f"{text}{mark}", style="dim" if name in ranking.references else "")


def percent(share: float, count: int) -> str:
    """Percentage, with one decimal if the number of episodes supports it."""
    return "–" if share != share else f"{100 * share:.{int(count >= 400)}f}"


def _notes(rankings: Sequence[Ranking]) -> Iterator[str]:
    """Legend of the marks in use."""
    if any(ranking.is_contest for ranking in rankings):
        yield (
            f"{BEST} best of a scenario (among equals the soonest); {TIED} tied with it: the "
            "95 % interval of the paired difference contains 0"
        )
    if references := dict.fromkeys(name for ranking in rankings for name in ranking.references):
        yield (
            f"{', '.join(references)}: oracle with the map and all positions; its success is an "
            "upper bound"
        )
    for reason in (ONE_START, NONE_MET):
        if found := [one.scenario for one in rankings if one.undecided == reason]:
            yield f"{', '.join(found)}: {reason}"
    through = [one.scenario for one in rankings if np.isnan(list(one.share.values())).any()]
    if through:
        yield f"– in {', '.join(through)}: robots pass through obstacles; contacts do not count"


def show_sweeps(sweeps: Sequence[Sweep], rows: Sequence[dict[str, Any]], console: Console) -> None:
    """Print a table per sweep: collision-free success and median time of each policy."""
    for sweep in sweeps:
        own, limit = rows_of(sweep, rows), sweep.base.max_steps * sweep.base.tau
        title = f"{sweep.base.name}: {sweep.field}, {counted(own[0]['episodes'], 'episode')}"
        console.print(f"{title}; collision-free %, median s", style="bold")
        table = _empty("policy", *sweep.labels)
        for policy, found in grouped(own, "policy").items():
            cells = []
            for row in found:
                counts = not math.isnan(row["collision_free_success"])
                share = percent(
                    row["collision_free_success" if counts else "success"], row["episodes"]
                )
                cells.append(f"{share}, {_time(row['median_time'], limit)}")
            table.add_row(policy, *cells)
        console.print(table)
        console.print()


def _time(seconds: float, limit: float) -> str:
    """Format a time; the limit is shown as a lower bound."""
    return f"> {limit:.3g}" if seconds >= limit else f"{seconds:.3g}"
