"""``rendezvous report``: one HTML page of what ``compare`` found, with an interactive replay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from rich.console import Console
from tyro.conf import Positional

from rendezvous_env.render.scene import outermost, shapes
from rendezvous_env.scenario.scenario import Scenario

from ..checks import UserError
from ..compare.ranking import Ranking, answer, leaders
from ..figures.figures import ROBOT_COLOURS
from ..recording import MAX_FRAMES
from ..results import atomic
from . import board
from .encoding import Encoded, encode_all, rounding
from .input import Comparison, read
from .skeleton import figures, part, terms, whole
from .words import counts, rankings

_SCRIPTS = (
    "data", "choice", "save", "world", "sight", "plots", "tables", "results", "pane", "replay",
)  # fmt: skip
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
    leaderboard's folder a page of its tables, figures and cards.

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
    recordings = "\n".join(
        f'<script id="recording-{number}" type="application/gzip">{one.text}</script>'
        for number, one in enumerate(encoded)
    )
    return whole(
        f"Rendezvous: {', '.join(found.scenarios)}",
        ("Replay", "Results", "Figures", "About"),
        sections,
        _data(found, ranked, encoded),
        _SCRIPTS,
        css=part("uPlot.min.css"),
        js=part("uPlot.iife.min.js"),
        recordings=recordings,
    )


# ---- data ---------------------------------------------------------------------------------------


def _data(
    found: Comparison, ranked: Sequence[Ranking], encoded: Sequence[Encoded]
) -> dict[str, Any]:
    """What the scripts read, besides the recordings themselves."""
    outcomes = {(row["scenario"], row["policy"], int(row["start"])): row for row in found.episodes}
    entries, worlds = [], dict[tuple[str, int], list[dict[str, Any]]]()
    recordings = found.recordings.items()
    for ((scenario, policy, start), recording), one in zip(recordings, encoded, strict=True):
        table, positions = recording["obstacles"], recording["positions"]
        if (scenario, start) not in worlds:
            worlds[scenario, start] = [
                {"centre": shape.centre.tolist(), "radius": shape.radius}
                | {"vertices": shape.vertices.tolist()}
                for shape in shapes(table, positions.shape[-1])
            ]
        points = outermost(positions, table)
        entries.append(
            {
                "scenario": scenario,
                "policy": policy,
                "start": start,
                "fields": [list(field.values()) for field in one.fields],
                "stride": one.stride,
                "obstacles": list(worlds).index((scenario, start)),
                "extent": np.stack([points.min(axis=0), points.max(axis=0)], axis=1).tolist(),
                "outcome": {name: outcomes[scenario, policy, start][name] for name in _OUTCOME},
            }
        )
    return {
        "run": {"seed": found.run["seed"]},
        "scenarios": {name: _scenario(scenario) for name, scenario in found.scenarios.items()},
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
        "obstacles": list(worlds.values()),
        "recordings": entries,
        "robot_colours": ROBOT_COLOURS,
    }


def _scenario(scenario: Scenario) -> dict[str, Any]:
    layout = scenario.observation_layout
    return {
        "limit": scenario.max_steps * scenario.tau,
        "nonholonomic": scenario.model.nonholonomic,
        "exact": scenario.sensing.exact,
        "own_row": "gravity" if scenario.model.nonholonomic else "own velocity",
        "neighbour_slots": layout.neighbour_slots,
        "obstacle_slots": layout.obstacle_slots,
        "silhouette_points": layout.silhouette_points,
    }


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
