"""``rendezvous compare``: policies on the same starts, as a table, files and figures."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from rich.console import Console

from .. import folders
from ..learned import policies
from . import cells, gallery, out_folder, tables
from .files import count_excess, description, write
from .out_folder import Part
from .plan import Config, Job, plan
from .playing import Played, play_all, play_ceilings, play_job, summary

__all__ = ["Config", "Job", "Played", "plan", "play_job", "run", "summary"]


def run(config: Config) -> int:
    """Compare, print the table, write all files.

    Returns:
        Exit status: 1 if a merge raised V above its proven bound, else 0.

    Raises:
        UserError: for an unknown name, an impossible number or a folder that cannot be written.
    """
    console = Console(width=max(Console().width, tables.WIDTH))
    jobs = plan(config)
    out = out_folder.destination(config.out)
    lock = folders.held(out_folder.lock_of(out), f"--out {config.out}")
    with folders.made(out.parent), lock:
        asked = cells.plan_of(jobs, config)
        part = out_folder.open_part(config.out, out, asked, fresh=config.fresh)
        if part is None:
            console.print(f"{out} holds this comparison: it was finished, but not renamed yet")
            return 0
        try:
            return _run(config, jobs, part, console)
        except KeyboardInterrupt as error:
            if count := part.count():
                error.add_note(
                    f"{count} finished parts lie in {part.folder}; the same command goes on"
                )
            raise
        finally:
            part.discard_if_empty()


def _run(config: Config, jobs: Sequence[Job], part: Part, console: Console) -> int:
    for name in () if config.policies else policies.SHIPPED:
        if reason := policies.left_out(name):
            console.print(f"left out: {name} ({reason})")
    if count := part.count():
        console.print(f"goes on with {count} finished parts in {part.folder}")
    began = time.perf_counter()
    played, compile_time = play_all(jobs, config, part, console)
    duration = time.perf_counter() - began - compile_time
    rows = [summary(done) for done in played]
    files = play_ceilings(part, jobs, config, console) if config.ceiling else []
    files += write(part, played, rows)
    console.print(tables.results_table(rows, {job.scenario.name: job.scenario for job in jobs}))
    if config.figures:
        files += gallery.draw(part, rows, played, config.pdf, console)
    timing = {"compile_s": compile_time, "compare_s": duration}
    part.finish(files, description(config, played, timing))
    console.print(
        f"{len(jobs)} × {config.episodes} episodes in {duration:.1f} s; files in {config.out}"
    )
    return _report_excess(played)


def _report_excess(played: Sequence[Played]) -> int:
    if count := count_excess(played):
        print(
            f"error: in {count} episodes a merge raised V above its bound (theory 5); "
            "see merge_excess in episodes.csv",
            file=sys.stderr,
        )
    return int(count > 0)
