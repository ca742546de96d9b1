"""``rendezvous report``: one HTML page of what ``compare`` found, with an interactive replay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from rich.console import Console
from tyro.conf import Positional

from ..checks import UserError
from ..compare.ranking import Ranking, answer, leaders
from ..encoding import Encoded, encode_all, rounding
from ..recording import MAX_FRAMES
from ..results import atomic
from . import board
from .input import Comparison, read
from .replays import PLAYER, Replay, elements, player_data
from .skeleton import figures, part, terms, whole
from .words import counts, rankings

_OUTCOME = (
    "success",
    "clean",
    "time",
    "path_length",
    "contacts",
    "clearance",
    "min_alignment",
)
"""Columns of episodes.csv that are shown beside a replay."""
_NOTHING_KEPT = "No start was kept (compare ran with --keep 0), so there is nothing to replay."

EXAMPLES = ("out/compare", "results/leaderboard/smoke")


@dataclass(frozen=True)
class Config:
    """Make OUT/report.html of the results in OUT: tables, figures and an interactive replay; of a
    leaderboard's folder a page of its tables, figures, cards and replays.

    The page needs nothing but itself: no network, no server.
    """

    folder: Positional[Path] = Path("out/compare")
    """The folder that rendezvous compare or leaderboard --out wrote."""


def run(config: Config) -> int:
    """Write report.html into the folder.

    Raises:
        UserError: if the folder is missing, half written, of another format version, or not
            writable.
    """
    path, console, note = config.folder / "report.html", Console(), ""
    with console.status("writing the page …"):
        if board.is_one(config.folder):
            text = board.page(config.folder)
        else:
            found = read(config.folder)
            text, note = page(found), "" if found.recordings else f"note: {_NOTHING_KEPT}"
    try:
        with atomic(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"{path}: cannot write there: {error.strerror}") from error
    if note:
        console.print(note)
    console.print(f"{path} ({path.stat().st_size / 1e6:.1f} MB)", soft_wrap=True)
    return 0


def page(found: Comparison) -> str:
    """The whole page."""
    encoded = encode_all(list(found.recordings.values()))
    ranked = rankings(found)
    sections = Template(part("compared.html")).substitute(
        answer=escape(answer(ranked)),
        counts=escape(counts(found)),
        replay=part("replay.html") if encoded else f'<p class="note">{_NOTHING_KEPT}</p>',
        figures=figures(found.figures),
        about=_about(found, encoded),
    )
    shown = _replays(found, encoded)
    return whole(
        f"Rendezvous: {', '.join(found.scenarios)}",
        ("Replay", "Results", "Figures", "About"),
        sections,
        _data(found, ranked, shown),
        ("data", "choice", "save", *PLAYER, "tables", "results", "replay"),
        recordings=elements(shown),
    )


# ---- data ---------------------------------------------------------------------------------------


def _data(found: Comparison, ranked: Sequence[Ranking], shown: Sequence[Replay]) -> dict[str, Any]:
    """What the scripts read, besides the recordings themselves."""
    return player_data(shown, found.scenarios) | {
        "run": {"seed": str(found.run["seed"])},
        "rankings": [
            {
                "scenario": ranking.scenario,
                "top": list(ranking.top) if ranking.is_contest else [],
                "references": list(ranking.references),
            }
            for ranking in ranked
        ],
        "leaders": leaders(ranked),
        "results": found.rows,
        "paired": found.paired,
    }


def _replays(found: Comparison, encoded: Sequence[Encoded]) -> list[Replay]:
    """The recordings with what episodes.csv says of them."""
    outcomes = {(row["scenario"], row["policy"], int(row["start"])): row for row in found.episodes}
    return [
        Replay(*key, vars(one), {name: outcomes[key][name] for name in _OUTCOME})
        for key, one in zip(found.recordings, encoded, strict=True)
    ]


# ---- words --------------------------------------------------------------------------------------


def _about(found: Comparison, encoded: Sequence[Encoded]) -> str:
    run = found.run
    lines = {
        "Run": run["run"],
        "Command": " ".join(run["command_line"]),
        "Versions": ", ".join(f"{name} {version}" for name, version in run["versions"].items()),
        "Machine": f"{run['platform']}, Python {run['python']}",
        "Tables": "the numbers of results.csv and paired.csv, rounded for the eye; the exact text "
        "of each cell stands in its data-value, data-low and data-high",
        "Replay": _precision(found, encoded),
    }
    return terms(lines)


def _precision(found: Comparison, encoded: Sequence[Encoded]) -> str:
    """What the replay leaves out of what was recorded."""
    if not found.recordings:
        return _NOTHING_KEPT

    def half_step(name: str) -> float:
        return 0.5 * max(rounding(recording[name]) for recording in recordings)

    recordings = found.recordings.values()
    thin = sum(one.stride > 1 for one in encoded)
    kept = (
        f"{thin} of {len(encoded)} recordings are thinned out to keep the page small (said below "
        "them); the others have every recorded frame"
        if thin
        else "every recorded frame"
    )
    return (
        f"{kept} ({MAX_FRAMES} at most, besides merges: of a longer episode compare keeps every "
        "second, fourth, … step). Positions are rounded to within "
        f"{1000 * half_step('positions'):.2g} mm, "
        f"observation rows to {half_step('observations'):.2g}, frames and alignments to "
        f"{half_step('frames'):.2g}; times and V are 32-bit. Between two frames positions are "
        "interpolated for the eye, everything else stays that of the frame"
    )
