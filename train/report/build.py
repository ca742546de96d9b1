"""``rendezvous report``: one HTML page of what ``compare`` found, with an interactive replay."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
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
from .encoding import Encoded, encode_all, rounding
from .input import Comparison, read
from .words import caption, counts, rankings

_PAGE = files("train.report") / "page"
_SCRIPTS = ("data", "choice", "save", "world", "sight", "plots", "tables", "pane", "replay")
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

EXAMPLES = ("out/compare",)


@dataclass(frozen=True)
class Config:
    """Make OUT/report.html of the results in OUT: tables, figures and an interactive replay.

    The page needs nothing but itself: no network, no server.
    """

    folder: Positional[Path] = Path("out/compare")
    """The folder that rendezvous compare --out wrote."""


def run(config: Config) -> int:
    """Write report.html into the folder.

    Raises:
        UserError: if the folder is missing, half written, of another format version, or not
            writable.
    """
    found = read(config.folder)
    path = config.folder / "report.html"
    console = Console()
    with console.status("writing the page …"):
        text = page(found)
    try:
        with atomic(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"{path}: cannot write there: {error.strerror}") from error
    if not found.recordings:
        console.print(f"note: {_NOTHING_KEPT}")
    console.print(f"{path} ({path.stat().st_size / 1e6:.1f} MB)", soft_wrap=True)
    return 0


def page(found: Comparison) -> str:
    """The whole page."""
    encoded = encode_all(list(found.recordings.values()))
    ranked = rankings(found)
    return Template(_part("page.html")).substitute(
        title=escape(f"Rendezvous: {', '.join(found.scenarios)}"),
        answer=escape(answer(ranked)),
        counts=escape(counts(found)),
        css=_part("page.css"),
        uplot_css=_part("uPlot.min.css"),
        uplot_js=_part("uPlot.iife.min.js"),
        js='(() => {\n"use strict";\n' + "\n".join(_part(f"{s}.js") for s in _SCRIPTS) + "})();",
        replay=_part("replay.html") if encoded else f'<p class="note">{_NOTHING_KEPT}</p>',
        figures="\n".join(_figures(found)),
        about=_about(found, encoded),
        recordings="\n".join(
            f'<script id="recording-{number}" type="application/gzip">{one.text}</script>'
            for number, one in enumerate(encoded)
        ),
        data=_json(_data(found, ranked, encoded)),
    )


def _part(name: str) -> str:
    return (_PAGE / name).read_text(encoding="utf-8")


def _json(data: Any) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


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


def _figures(found: Comparison) -> Iterator[str]:
    for path in found.figures:
        source = base64.b64encode(path.read_bytes()).decode("ascii")
        name, said = escape(path.name), escape(caption(path.stem))
        yield (
            f'<figure id="{escape(path.stem)}"><img loading="lazy" alt="{said}" '
            f'src="data:image/png;base64,{source}"><figcaption>{said} <button type="button" '
            f'class="save" data-name="{name}" aria-label="Save {name}">PNG</button></figcaption>'
            "</figure>"
        )
    if not found.figures:
        yield '<p class="note">The folder has no figures; compare draws them by default.</p>'


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
    items = (f"<dt>{escape(name)}</dt><dd>{escape(line)}</dd>" for name, line in lines.items())
    return f"<dl>{''.join(items)}</dl>"


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
