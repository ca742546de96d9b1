"""``rendezvous compare``: policies on the same starts, as an answer, tables, files and figures."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from .. import results
from ..resume import Part, claimed
from . import gallery, out_folder, ranking, statistics, sweep, tables
from .evaluation import Episodes
from .playing import Played, plan_of, play_all, play_job, summary
from .ranking import Ranking, answer
from .settings import Config, Job, plan
from .upper_bound import play_upper_bounds

__all__ = ["Config", "Job", "Played", "plan", "play_job", "run", "summary"]


class _Clock:
    """Where the time goes, by the wall clock: s of each part that is over, by its name."""

    def __init__(self) -> None:
        self._began, self.parts = time.perf_counter(), dict[str, float]()

    def now(self, part: str) -> None:
        """All since the last call was spent on ``part``."""
        self.parts[part] = self.total - sum(self.parts.values())

    @property
    def total(self) -> float:
        """Since the command began, s."""
        return time.perf_counter() - self._began

    def timing(self) -> dict[str, float]:
        """The parts and the time in all, s, as run.json names them."""
        parts = {f"{name.replace(' ', '_')}_s": seconds for name, seconds in self.parts.items()}
        return parts | {"total_s": self.total}

    def line(self) -> str:
        """The time in all, and its parts."""
        split = ", ".join(f"{name} {seconds:.1f}" for name, seconds in self.parts.items())
        return f"{self.total:.1f} s: {split}"


def run(config: Config) -> int:
    """Compare, print the answer, write all files.

    Returns:
        Exit status: 1 if a merge raised V above its proven bound, else 0.

    Raises:
        UserError: for an unknown name, an impossible number or a folder that cannot be written.
    """
    console, clock = Console(), _Clock()
    jobs = plan(config)
    out = out_folder.destination(config.out)
    with claimed(out.parent, f".{out.name}.lock", f"--out {config.out}"):
        asked = plan_of(jobs, config)
        part = out_folder.open_part(config.out, out, asked, fresh=config.fresh)
        if part is None:
            console.print(
                f"{out} holds this comparison: it was finished, but not renamed yet",
                soft_wrap=True,
            )
            return 0
        with part.at_work(console):
            return _run(config, jobs, out, part, console, clock)


def _run(
    config: Config, jobs: Sequence[Job], out: Path, part: Part, console: Console, clock: _Clock
) -> int:
    clock.now("setting up")
    played, compile_time = play_all(jobs, config, part, console)
    files = play_upper_bounds(part, jobs, config, console) if config.ceiling else []
    clock.now("playing")
    playing = clock.parts.pop("playing") - compile_time
    clock.parts |= {"compiling": compile_time, "playing": playing}
    rows, rankings = [summary(done) for done in played], ranking.rank(played)
    pairs = paired_rows(played, config.against)
    files += write(part, played, rows, pairs)
    if sweeps := config.sweeps():
        files += sweep.write(part, sweeps, rows)
    _show(config, jobs, console, rankings, rows, pairs)
    clock.now("tables")
    if config.figures:
        files += gallery.draw(part, rows, played, config, console)
        clock.now("drawing")
    about = description(config, played, clock.timing())
    out_folder.finish(out, part, files, about)
    if config.json is not None:
        kept = {name: about[name] for name in ("seed", "command_line", "versions", "timing")}
        write_summary(config.json, rankings, rows, pairs, kept)
    episodes = sum(len(done.episodes.success) for done in played)
    console.print(f"{episodes} episodes in {clock.line()}; files in {config.out}", soft_wrap=True)
    return _report_excess(played)


def _show(
    config: Config,
    jobs: Sequence[Job],
    console: Console,
    rankings: Sequence[ranking.Ranking],
    rows: Sequence[dict[str, Any]],
    pairs: Sequence[dict[str, Any]],
) -> None:
    """The answer, the matrix, and what was asked for besides."""
    console.print(f"\n[bold]{ranking.answer(rankings)}[/bold]\n")
    if config.sensing:
        tables.show_sweeps(config.sweeps(), rows, console)
    else:
        tables.show_matrix(rankings, console)
    if config.against is not None:
        console.print()
        console.print(
            tables.paired_table([row for row in pairs if row["against"] == config.against])
        )
    if config.details:
        used = {job.scenario.name: job.scenario for job in jobs}
        wide = Console(width=max(console.width, tables.WIDTH))
        wide.print()
        wide.print(tables.results_table(rows, used))
    else:
        console.print("times, lengths, margins: --details, or results.csv")
    console.print()


def _report_excess(played: Sequence[Played]) -> int:
    if count := count_excess(played):
        print(
            f"error: in {count} episodes a merge raised V above its bound (theory 5); "
            "see merge_excess in episodes.csv",
            file=sys.stderr,
        )
    return int(count > 0)


_ROUNDING = 1e-9  # m²/s, of V; a larger rise at a merge above its bound is an error


def write(
    part: Part,
    played: Sequence[Played],
    rows: Sequence[dict[str, Any]],
    pairs: Sequence[dict[str, Any]],
) -> list[str]:
    """Write results.csv, episodes.csv, paired.csv and trajectories.npz; their names."""
    tables = {
        "results.csv": (results.RESULT_COLUMNS, rows),
        "episodes.csv": (results.EPISODE_COLUMNS, _episode_rows(played)),
        "paired.csv": (results.PAIRED_COLUMNS, pairs),
    }
    for name, (columns, content) in tables.items():
        results.write_csv(part.folder / name, columns, content)
    results.write_arrays(part.folder / "trajectories.npz", _arrays(played), part.run)
    return [*tables, "trajectories.npz"]


def _episode_rows(played: Sequence[Played]) -> Iterator[dict[str, Any]]:
    for done in played:
        head = {"scenario": done.job.scenario.name, "policy": done.job.policy}
        yield from (head | row for row in done.episodes.rows())


def paired_rows(played: Sequence[Played], against: str | None) -> list[dict[str, Any]]:
    """The rows of paired.csv; where ``against`` was not played another is the reference."""
    by_scenario: dict[str, dict[str, Episodes]] = {}
    for done in played:
        by_scenario.setdefault(done.job.scenario.name, {})[done.job.policy] = done.episodes
    return [
        row
        for scenario, episodes in by_scenario.items()
        for row in statistics.compare_pairs(
            scenario, episodes, against if against in episodes else None
        )
    ]


def _arrays(played: Sequence[Played]) -> dict[str, np.ndarray[Any, Any]]:
    """Recorded arrays under scenario/policy/start/name."""
    return {
        f"{done.job.scenario.name}/{done.job.policy}/{start}/{name}": array
        for done in played
        for start, recording in done.recordings.items()
        for name, array in recording.items()
    }


def description(
    config: Config, played: Sequence[Played], timing: dict[str, float]
) -> dict[str, Any]:
    """What run.json says of a comparison."""
    used = {done.job.scenario.name: done.job.scenario for done in played}
    return results.provenance() | {
        "seed": config.seed,
        "episodes": config.episodes or max(len(done.episodes.success) for done in played),
        "keep": max(min(config.kept(one), config.starts(one)) for one in used.values()),
        "starts": {done.job.scenario.name: len(done.episodes.success) for done in played},
        "scenarios": {name: scenario.to_plain() for name, scenario in used.items()},
        "policies": {
            name: [done.job.policy for done in played if done.job.scenario.name == name]
            for name in used
        },
        "merges_above_bound": count_excess(played),
        "timing": timing,
    }


def write_summary(
    path: Path,
    rankings: Sequence[Ranking],
    rows: Sequence[dict[str, Any]],
    pairs: Sequence[dict[str, Any]],
    about: Mapping[str, Any],
) -> None:
    """Write all that was found in short, as JSON: what ``--json`` asks for.

    The names of columns are those of results.csv and paired.csv; null where it does not apply.
    """
    results.write_json(
        path,
        {
            "answer": answer(rankings),
            "scenarios": {
                ranking.scenario: {
                    "starts": ranking.starts,
                    "best": ranking.best if ranking.is_contest else None,
                    "tied": list(ranking.tied),
                    "references": list(ranking.references),
                    "policies": {
                        row["policy"]: _plain(row, results.RESULT_COLUMNS[2:])
                        for row in rows
                        if row["scenario"] == ranking.scenario
                    },
                }
                for ranking in rankings
            },
            "paired": [_plain(row, results.PAIRED_COLUMNS) for row in pairs],
            **about,
        },
    )


def _plain(row: Mapping[str, Any], columns: Sequence[str]) -> dict[str, Any]:
    """Cells as numbers and words, null where they are empty."""
    cells = {column: results.plain(row[column]) for column in columns}
    return {column: None if cell == "" else cell for column, cell in cells.items()}


def count_excess(played: Sequence[Played]) -> int:
    """Episodes in which a merge raised V above its proven bound."""
    return sum(int((done.episodes.merge_excess > _ROUNDING).sum()) for done in played)
