"""Common structure of report pages: one file with data, style, scripts and replays."""

import base64
import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

from rendezvous_env.scenario.scenario import Scenario

from ..compare.statistics import rounding_of_clearance, rounding_of_v
from ..figures.figures import ROBOT_COLOURS

_PAGE = files(__package__) / "page"
_CAPTIONS = {
    "success": "Fraction of initial conditions with rendezvous, by policy. Open marks: all "
    "robots met. Filled: collision-free. Lines: 95 % intervals.",
    "times": "Median time until all robots met, with its 95 % interval; time-outs count as later "
    "than the limit.",
    "against-obstacles": "Collision-free success against the number of obstacles. Bars: 95 % "
    "intervals.",
    "against-robots": "Collision-free success against the number of robots among the same number "
    "of obstacles. Bars: 95 % intervals.",
    "price": "Collision-free success and time against the fraction of steps in which V increased.",
    "profiles": "Fraction of runs that reach each level of collision-free success.",
}


def part(name: str) -> str:
    """Contents of a file of the page template."""
    return (_PAGE / name).read_text(encoding="utf-8")


def assemble(
    title: str,
    links: Sequence[str],
    sections: str,
    data: Any,
    scripts: Sequence[str],
    recordings: str,
) -> str:
    """Assemble the page from sections (HTML), their titles, script data (DATA) and recordings.

    The plotting library is included if there are recordings. The section "About" has id "run".
    """
    ids = {"About": "run"}
    own = "\n".join(part(f"{name}.js") for name in scripts)
    css, js = (part(f"uPlot.{end}") if recordings else "" for end in ("min.css", "iife.min.js"))
    plain = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return Template(part("page.html")).substitute(
        title=escape(title),
        links=" ".join(f'<a href="#{ids.get(one, one.lower())}">{one}</a>' for one in links),
        sections=sections,
        css=css + part("page.css"),
        js=f'{js}\n(() => {{\n"use strict";\n{own}}})();',
        recordings=recordings,
        data=plain.replace("<", "\\u003c"),  # must not end the enclosing script element
    )


def figures(paths: Sequence[Path]) -> str:
    """Figures with captions, as HTML."""
    return "\n".join(map(_figure, paths)) or (
        '<p class="note">The folder has no figures; compare draws them by default.</p>'
    )


def _figure(path: Path) -> str:
    source = base64.b64encode(path.read_bytes()).decode("ascii")
    kind, _, scenario = path.stem.partition("-")
    if kind == "trajectories":
        said = (
            f"{scenario}: the paths of the robots from the first initial condition under each "
            "policy. Dots: initial positions. Crosses: merges. Orange: obstacles."
        )
    else:
        numbered, _, number = path.stem.rpartition("-")
        said = _CAPTIONS.get(numbered if number.isdigit() else path.stem, path.stem)
    name, said = escape(path.name), escape(said)
    return (
        f'<figure id="{escape(path.stem)}"><img loading="lazy" alt="{said}" '
        f'src="data:image/png;base64,{source}"><figcaption>{said} <button type="button" '
        f'class="save" data-name="{name}" aria-label="Save {name}">PNG</button></figcaption>'
        "</figure>"
    )


def terms(lines: Mapping[str, str]) -> str:
    """Definition list of terms, as HTML."""
    items = (f"<dt>{escape(name)}</dt><dd>{escape(line)}</dd>" for name, line in lines.items())
    return f"<dl>{''.join(items)}</dl>"


PLAYER = ("world", "sight", "plots", "pane")
"""Scripts of the player; "replay" is last, since it uses the tables."""


class Replay(NamedTuple):
    """A replayable episode."""

    scenario: str
    policy: str
    start: int
    shown: Mapping[str, Any]  # fields of ``encoding.Encoded``
    outcome: Mapping[str, str]  # of episodes.csv, with success, collision_free, time


def elements(replays: Sequence[Replay]) -> str:
    """HTML elements with the recordings, in the order of ``player_data``."""
    return "\n".join(
        f'<script id="recording-{number}" type="application/gzip">{replay.shown["text"]}</script>'
        for number, replay in enumerate(replays)
    )


def player_data(replays: Sequence[Replay], scenarios: Mapping[str, Scenario]) -> dict[str, Any]:
    """Data of the player apart from the recordings; obstacles are stored once per episode."""
    worlds = {(one.scenario, one.start): one.shown["obstacles"] for one in replays}
    places = {world: number for number, world in enumerate(worlds)}
    return {
        "scenarios": {name: _scenario(scenario) for name, scenario in scenarios.items()},
        "obstacles": list(worlds.values()),
        "recordings": [
            {key: one.shown[key] for key in ("fields", "stride", "extent")}
            | {"scenario": one.scenario, "policy": one.policy, "start": one.start}
            | {"obstacles": places[one.scenario, one.start], "outcome": one.outcome}
            for one in replays
        ],
        "robot_colours": ROBOT_COLOURS,
    }


def _scenario(scenario: Scenario) -> dict[str, Any]:
    layout = scenario.observation_layout
    return {
        "limit": scenario.max_steps * scenario.tau,
        "rounding": rounding_of_v(scenario),
        "contact": rounding_of_clearance(scenario),
        "nonholonomic": scenario.model.nonholonomic,
        "exact": scenario.sensing.exact,
        "own_row": "gravity" if scenario.model.nonholonomic else "own velocity",
        "neighbour_slots": layout.neighbour_slots,
        "obstacle_slots": layout.obstacle_slots,
        "rows_per_obstacle": layout.rows_per_obstacle,
    }
