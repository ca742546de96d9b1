"""The table that compare shows first: clean success of every policy on every scenario."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from .. import policies
from .ranking import Ranking

_HEADING = 9
"""Characters of a line in which a scenario's name stands; longer names take more lines."""
_BETWEEN = 2
BEST, TIED = "*", "="


def show(rankings: Sequence[Ranking], console: Console) -> None:
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
