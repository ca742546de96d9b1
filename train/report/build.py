"""``rendezvous report``: HTML page of a comparison with an interactive replay."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from string import Template

import numpy as np
from tyro.conf import Positional

from rendezvous_env.checks import counted

from ..checks import Flags, UserError, user_error
from ..compare.evaluation import Episodes
from ..compare.playing import Played
from ..compare.ranking import Ranking, answer, leaders, rank
from ..compare.settings import Job
from ..console import Console
from ..encoding import Encoded, encode_all, rounding
from ..recording import MAX_FRAMES
from ..results import write_text
from . import leaderboard
from .input import Comparison, half_written, read
from .skeleton import PLAYER, Replay, assemble, elements, figures, part, player_data, terms

_OUTCOME = (
    "success", "collision_free", "time", "path_length", "contacts", "clearance", "min_alignment",
)  # fmt: skip
"""Columns of episodes.csv shown with a replay."""
_NOTHING_KEPT = "No episode was recorded (--keep-trajectories 0), so there is no replay."

EXAMPLES = ("out/compare", "results/leaderboard/smoke")


@dataclass(frozen=True)
class Config(Flags):
    """Write OUT/report.html with the tables, figures and replays of a comparison or leaderboard.

    The page is self-contained: it needs neither network nor server.
    """

    folder: Positional[Path] = Path("out/compare")
    """Folder written by rendezvous compare or leaderboard --out."""


def run(config: Config) -> int:
    """Write report.html into the folder."""
    path, console = config.folder / "report.html", Console()
    with console.status("writing the page …"):
        text, note = _page_of(config.folder)
    with user_error(f"{path}: cannot write there: ", OSError):
        write_text(path, text)
    if note:
        console.print(note)
    console.print(f"{path} ({path.stat().st_size / 1e6:.1f} MB)", soft_wrap=True)
    return 0


def _page_of(folder: Path) -> tuple[str, str]:
    """Page of a comparison or a leaderboard, and a note for the terminal."""
    command = "leaderboard" if leaderboard.is_one(folder) else "compare"
    try:
        if command == "leaderboard":
            return leaderboard.page(folder), ""
        found = read(folder)
        return page(found), "" if found.recordings else f"note: {_NOTHING_KEPT}"
    except UserError:
        raise
    except Exception as error:  # valid digests, but not written by the command
        what = f"not readable ({type(error).__name__}: {error})"
        raise half_written(folder, what, command) from error


def page(found: Comparison) -> str:
    """The page as HTML."""
    encoded = encode_all(list(found.recordings.values()))
    outcomes = {
        (row["scenario"], row["policy"], int(row["initial_condition"])): row
        for row in found.episodes
    }
    shown = [
        Replay(*key, vars(one), {name: outcomes[key][name] for name in _OUTCOME})
        for key, one in zip(found.recordings, encoded, strict=True)
    ]
    ranked = rankings(found)
    sections = Template(part("compared.html")).substitute(
        answer=escape(answer(ranked)),
        counts=escape(_counts(found)),
        replay=part("replay.html") if encoded else f'<p class="note">{_NOTHING_KEPT}</p>',
        figures=figures(found.figures),
        about=_about(found, encoded),
    )
    data = player_data(shown, found.scenarios) | {
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
    return assemble(
        f"Rendezvous: {', '.join(found.scenarios)}",
        ("Replay", "Results", "Figures", "About"),
        sections,
        data,
        ("data", "choice", "save", *PLAYER, "tables", "results", "replay"),
        recordings=elements(shown),
    )


def rankings(found: Comparison) -> list[Ranking]:
    """Rankings of ``compare``, from episodes.csv."""
    played = []
    for name, policies in found.run["policies"].items():
        for policy in policies:
            own = [r for r in found.episodes if (r["scenario"], r["policy"]) == (name, policy)]
            columns = {
                field.name: np.array([float(row[field.name] or "nan") for row in own])
                for field in fields(Episodes)
            }
            columns["success"] = columns["success"] == 1.0
            made = found.run.get("labels", {}).get(policy, policy)
            job = Job(found.scenarios[name], made, policy if made != policy else "")
            played.append(Played(job, Episodes(**columns), {}))
    return rank(played)


def _counts(found: Comparison) -> str:
    """Numbers of scenarios, policies and initial conditions, as text."""
    policies = {name for played in found.run["policies"].values() for name in played}
    first, count = found.run["seed"], found.run["episodes"]
    counts = found.run["initial_conditions"].items()
    seeds = f"seeds {first}–{first + count - 1}" if count > 1 else f"seed {first}"
    said = f"{counted(count, 'initial condition')} each ({seeds})"
    if single := [name for name, own in counts if own == 1 < count]:
        said += f"; one of {', '.join(single)}, whose initial condition is given"
    said += "".join(f"; {own} of {name}" for name, own in counts if 1 < own < count)
    return (
        f"{counted(len(found.scenarios), 'scenario')}, {counted(len(policies), 'policy')}, {said}"
    )


def _about(found: Comparison, encoded: Sequence[Encoded]) -> str:
    run = found.run
    lines = {
        "Run": run["run"],
        "Command": shlex.join(run["command_line"]),
        "Versions": ", ".join(f"{name} {version}" for name, version in run["versions"].items()),
        "Machine": f"{run['platform']}, Python {run['python']}",
        "Tables": "the numbers of results.csv and paired.csv, rounded; the exact text of each "
        "cell is in its data-value, data-low and data-high",
        "Replay": _precision(found, encoded),
    }
    return terms(lines)


def _precision(found: Comparison, encoded: Sequence[Encoded]) -> str:
    """Rounding and subsampling of the replay, as text."""
    if not found.recordings:
        return _NOTHING_KEPT

    def half_step(name: str) -> float:
        return 0.5 * max(rounding(recording[name]) for recording in found.recordings.values())

    thin = sum(one.stride > 1 for one in encoded)
    verb = "is" if thin == 1 else "are"
    kept = (
        f"{thin} of {counted(len(encoded), 'recording')} {verb} subsampled to keep the page small "
        "(noted below them); the others have every recorded frame"
        if thin
        else "every recorded frame"
    )
    return (
        f"{kept} ({MAX_FRAMES} at most, besides merges: of a longer episode compare keeps every "
        "second, fourth, … step). Positions are rounded to within "
        f"{1000 * half_step('positions'):.2g} mm, "
        f"observation rows to {half_step('observations'):.2g}, frames and alignments to "
        f"{half_step('frames'):.2g}; times and V are 32-bit. Between two frames positions are "
        "interpolated; everything else is that of the frame"
    )
