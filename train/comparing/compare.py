"""``rendezvous compare``: policies on the same starts, as an answer, tables, files and figures."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from .. import folders
from ..unfinished import Part
from . import cells, gallery, level_tables, matrix, out_folder, ranking, tables
from .ceilings import play_ceilings
from .files import count_excess, description, paired_rows, write, write_summary
from .plan import Config, Job, plan
from .playing import Played, play_all, play_job, summary

__all__ = ["Config", "Job", "Played", "plan", "play_job", "run", "summary"]


@dataclass
class _Clock:
    """Where the time goes, by the wall clock."""

    began: float = field(default_factory=time.perf_counter)
    """When the command began, s."""
    parts: dict[str, float] = field(default_factory=dict)
    """Time of each part that is over, s."""

    def now(self, part: str) -> None:
        """All since the last call was spent on ``part``."""
        self.parts[part] = self.total - sum(self.parts.values())

    @property
    def total(self) -> float:
        """Since the command began, s."""
        return time.perf_counter() - self.began

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
    lock = folders.held(out_folder.lock_of(out), f"--out {config.out}")
    with folders.made(out.parent), lock:
        asked = cells.plan_of(jobs, config)
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
    files = play_ceilings(part, jobs, config, console) if config.ceiling else []
    clock.now("playing")
    playing = clock.parts.pop("playing") - compile_time
    clock.parts |= {"compiling": compile_time, "playing": playing}
    rows, rankings = [summary(done) for done in played], ranking.rank(played)
    pairs = paired_rows(played, config.against)
    files += write(part, played, rows, pairs)
    if sweeps := config.sweeps():
        files += level_tables.write(part, sweeps, rows)
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
        level_tables.show(config.sweeps(), rows, console)
    else:
        matrix.show(rankings, console)
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
