"""Play the jobs of a comparison, those that are finished aside."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from .. import results
from ..learned import policies
from ..recording import Recording
from . import ceiling, cells, statistics, tables
from .episodes import Episodes, play
from .out_folder import Part
from .plan import Config, Job


@dataclass(frozen=True)
class Played:
    """What came of a job."""

    job: Job
    """The job."""
    episodes: Episodes
    """Measured, one entry for each start."""
    recordings: list[Recording]
    """Of the first starts."""


def play_job(job: Job, *, episodes: int, seed: int, keep: int = 0, **options: Any) -> Played:
    """Play one job; ``options`` are those of ``episodes.play``."""
    scenario, name = job.scenario, job.policy
    make = partial(policies.make, name, scenario)
    margin = policies.promised_margin(name, make())
    done = play(scenario, make, margin=margin, episodes=episodes, seed=seed, keep=keep, **options)
    return Played(job, *done)


def summary(played: Played) -> dict[str, Any]:
    """The row of results.csv that belongs to a job."""
    scenario, name = played.job.scenario, played.job.policy
    limit = scenario.max_steps * scenario.tau
    return statistics.summarise(scenario.name, name, played.episodes, limit)


def _compile(jobs: Sequence[Job], console: Console) -> float:
    """Play two steps of every job, so that its kernels are compiled; the time it took, s."""
    began = time.perf_counter()
    with console.status("preparing; the first use on a machine compiles, which takes a minute …"):
        for job in jobs:
            limit = 2 * job.scenario.tau
            short = Job(job.scenario.replace(time_limit=limit), job.policy)
            play_job(short, episodes=2, seed=0)
    seconds = time.perf_counter() - began
    console.print(f"kernels ready in {seconds:.1f} s (compiled on first use, then cached)")
    return seconds


def play_all(
    jobs: Sequence[Job], config: Config, part: Part, console: Console
) -> tuple[list[Played], float]:
    """Play all jobs that are not finished one after the other, under a progress bar.

    Returns:
        What came of all jobs, and the time that compiling took, s.
    """
    finished = [cells.load(part, number) for number in range(len(jobs))]
    left = [job for job, cell in zip(jobs, finished, strict=True) if cell is None]
    compile_time = _compile(left, console)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    played = []
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("", total=len(jobs))
        for number, (job, cell) in enumerate(zip(jobs, finished, strict=True)):
            progress.update(bar, description=f"{job.scenario.name} · {job.policy}".ljust(40))
            if cell is None:
                advance = _advance(progress, bar, number)
                counts = {"episodes": config.episodes, "seed": config.seed, "keep": config.keep}
                played.append(play_job(job, **counts, on_progress=advance))
                cells.save(part, number, (played[-1].episodes, played[-1].recordings))
            else:
                played.append(Played(job, *cell))
            progress.update(bar, completed=number + 1)
        progress.update(bar, description="done".ljust(40))
    return played, compile_time


def _advance(progress: Progress, bar: Any, number: int) -> Any:
    """What moves the bar within job ``number``, at most every tenth of a second."""
    last = time.monotonic()

    def advance(share: float) -> None:
        nonlocal last
        if time.monotonic() - last > 0.1:
            last = time.monotonic()
            progress.update(bar, completed=number + share)

    return advance


def play_ceilings(part: Part, jobs: Sequence[Job], config: Config, console: Console) -> list[str]:
    """Estimate what can be reached in each scenario with obstacles; a table and ceiling.csv.

    Returns:
        Names of the files.
    """
    scenarios = [job.scenario for job in jobs]
    reachable = [scenario for scenario in dict.fromkeys(scenarios) if ceiling.applies(scenario)]
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    rows = []
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("", total=len(reachable))
        for number, scenario in enumerate(reachable):
            progress.update(
                bar, description=f"{scenario.name} · best of {config.ceiling}".ljust(40)
            )
            best = cells.load_ceiling(part, number)
            if best is None:
                best = ceiling.estimate(
                    scenario,
                    config.ceiling,
                    episodes=config.episodes,
                    seed=config.seed,
                    on_progress=_advance(progress, bar, number),
                )
                cells.save_ceiling(part, number, best)
            rows.append(best.row(scenario))
        progress.update(bar, completed=len(reachable), description="done".ljust(40))
    results.write_csv(part.folder / "ceiling.csv", ceiling.COLUMNS, rows)
    console.print(tables.ceiling_table(rows))
    return ["ceiling.csv"]
