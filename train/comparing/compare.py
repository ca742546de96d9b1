"""``rendezvous compare``: policies on the same starts, as a table, files and figures."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from rendezvous_env.experiment import scenarios as named_scenarios
from rendezvous_env.experiment.scenario import Scenario

from .. import folders, results
from ..checks import check_least
from ..errors import UserError
from ..learned import policies
from ..recording import Recording
from . import ceiling, cells, out_folder, statistics, tables
from .episodes import Episodes, play
from .out_folder import Part

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEFAULT_SCENARIOS = (
    "fig3",
    "fig4",
    "duo",
    "swarm-20",
    "ring-12",
    "tree-12",
    "random-10",
    "unicycle-6",
    "uav-6",
    "cloud-8",
    "clutter-4",
    "clutter-8",
    "clutter-12",
    "clutter-16",
    "clutter-24",
    "clutter-16-team-3",
    "clutter-16-team-8",
    "clutter-16-team-16",
    "clutter-16-team-32",
)
_ROUNDING = 1e-9  # m²/s, of V; a larger rise at a merge above its bound is an error


@dataclass(frozen=True)
class Config:
    """Compare policies on the same starts and under one speed limit."""

    scenarios: tuple[str, ...] = DEFAULT_SCENARIOS
    """Names of scenarios, or paths of TOML files."""
    policies: tuple[str, ...] = ()
    """Names of policies; none means every one that fits. Where one does not fit it is left out."""
    episodes: int = 100
    """Starts for each scenario."""
    seed: int = 0
    """Start k of every scenario has the seed SEED + k, whatever the policy."""
    out: Path = Path("out/compare")
    """Folder for tables, trajectories and figures; one that is there is replaced at the end. Until
    then what is finished lies in OUT.part, and the same command goes on with it."""
    fresh: bool = False
    """Whether to throw away what another command has left unfinished in OUT.part."""
    keep: int = 5
    """Starts of which trajectories are kept."""
    ceiling: int = 0
    """Randomised runs of law (4) on each start, the best of which says what any heading policy can
    reach; 0 leaves this out."""
    figures: bool = True
    """Whether to draw figures."""
    pdf: bool = False
    """Whether to write each figure as PDF too, for print."""


@dataclass(frozen=True)
class Job:
    """One policy on one scenario."""

    scenario: Scenario
    """The experiment."""
    policy: str
    """Name of the policy."""


@dataclass(frozen=True)
class Played:
    """What came of a job."""

    job: Job
    """The job."""
    episodes: Episodes
    """Measured, one entry for each start."""
    recordings: list[Recording]
    """Of the first starts."""


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
    if not config.policies and (reason := policies.left_out()):
        console.print(f"left out: {policies.LEARNED} ({reason})")
    if count := part.count():
        console.print(f"goes on with {count} finished parts in {part.folder}")
    began = time.perf_counter()
    played, compile_time = play_all(jobs, config, part, console)
    duration = time.perf_counter() - began - compile_time
    rows = [summary(done) for done in played]
    files = _write_ceilings(part, jobs, config, console) if config.ceiling else []
    files += write(part, played, rows)
    console.print(tables.results_table(rows, {job.scenario.name: job.scenario for job in jobs}))
    if config.figures:
        files += _draw(part, rows, played, config.pdf, console)
    timing = {"compile_s": compile_time, "compare_s": duration}
    part.finish(files, _description(config, played, timing))
    console.print(
        f"{len(jobs)} × {config.episodes} episodes in {duration:.1f} s; files in {config.out}"
    )
    return _report_excess(played)


# ---- plan ---------------------------------------------------------------------------------------


def plan(config: Config) -> list[Job]:
    """The jobs that a configuration asks for.

    Raises:
        UserError: for an unknown name or an impossible number.
    """
    check_least(config, episodes=1, seed=0, keep=0, ceiling=0)
    if config.seed + config.episodes > 2**63:
        raise UserError(f"--seed is {config.seed}; with {config.episodes} starts it is too large")
    policies.check_names(config.policies)
    jobs: list[Job] = []
    for scenario in _resolve(config.scenarios):
        fitting = policies.fitting(scenario, config.policies)
        if not fitting:
            known = ", ".join(policies.names(scenario))
            raise UserError(f"no policy of those named fits {scenario.name}; these do: {known}")
        jobs += [Job(scenario, name) for name in fitting]
    return jobs


def _resolve(given: Sequence[str]) -> list[Scenario]:
    if not given:
        raise UserError("--scenarios names none; known are " + ", ".join(named_scenarios.names()))
    try:
        resolved = [named_scenarios.resolve(name) for name in given]
    except (ValueError, OSError) as error:
        raise UserError(str(error)) from error
    names = [scenario.name for scenario in resolved]
    for name in names:
        if "/" in name or os.sep in name:
            raise UserError(f"scenario name {name!r} would name a folder; leave out the slash")
        if names.count(name) > 1:
            raise UserError(f"two scenarios are called {name!r}; their results would mix")
    return resolved


# ---- play ---------------------------------------------------------------------------------------


def play_job(job: Job, *, episodes: int, seed: int, keep: int = 0, **options: Any) -> Played:
    """Play one job; ``options`` are those of ``episodes.play``."""
    scenario, name = job.scenario, job.policy
    make = partial(policies.make, name, scenario)
    margin = policies.promised_margin(name, make())
    done = play(scenario, make, margin=margin, episodes=episodes, seed=seed, keep=keep, **options)
    return Played(job, *done)


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


def _write_ceilings(part: Part, jobs: Sequence[Job], config: Config, console: Console) -> list[str]:
    """Estimate what law (4) can reach in each scenario with obstacles; a table and ceiling.csv.

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


def summary(played: Played) -> dict[str, Any]:
    """The row of results.csv that belongs to a job."""
    scenario, name = played.job.scenario, played.job.policy
    limit = scenario.max_steps * scenario.tau
    return statistics.summarise(scenario.name, name, played.episodes, limit)


# ---- files --------------------------------------------------------------------------------------


def write(part: Part, played: Sequence[Played], rows: Sequence[dict[str, Any]]) -> list[str]:
    """Write results.csv, episodes.csv, paired.csv and trajectories.npz; their names."""
    tables = {
        "results.csv": (results.RESULT_COLUMNS, rows),
        "episodes.csv": (results.EPISODE_COLUMNS, _episode_rows(played)),
        "paired.csv": (results.PAIRED_COLUMNS, _paired_rows(played)),
    }
    for name, (columns, content) in tables.items():
        results.write_csv(part.folder / name, columns, content)
    results.write_arrays(part.folder / "trajectories.npz", _arrays(played), part.run)
    return [*tables, "trajectories.npz"]


def _episode_rows(played: Sequence[Played]) -> Iterator[dict[str, Any]]:
    for done in played:
        head = {"scenario": done.job.scenario.name, "policy": done.job.policy}
        yield from (head | row for row in done.episodes.rows())


def _paired_rows(played: Sequence[Played]) -> Iterator[dict[str, Any]]:
    by_scenario: dict[str, dict[str, Episodes]] = {}
    for done in played:
        by_scenario.setdefault(done.job.scenario.name, {})[done.job.policy] = done.episodes
    for scenario, episodes in by_scenario.items():
        yield from statistics.compare_pairs(scenario, episodes)


def _arrays(played: Sequence[Played]) -> dict[str, np.ndarray[Any, Any]]:
    """Recorded arrays under scenario/policy/start/name."""
    return {
        f"{done.job.scenario.name}/{done.job.policy}/{start}/{name}": array
        for done in played
        for start, recording in enumerate(done.recordings)
        for name, array in recording.items()
    }


def _description(
    config: Config, played: Sequence[Played], timing: dict[str, float]
) -> dict[str, Any]:
    """Content of run.json."""
    used = {done.job.scenario.name: done.job.scenario for done in played}
    return results.provenance() | {
        "seed": config.seed,
        "episodes": config.episodes,
        "keep": config.keep,
        "scenarios": {name: scenario.to_plain() for name, scenario in used.items()},
        "policies": {
            name: [done.job.policy for done in played if done.job.scenario.name == name]
            for name in used
        },
        "merges_above_bound": _count_excess(played),
        "timing": timing,
    }


def _draw(
    part: Part,
    rows: Sequence[dict[str, Any]],
    played: Sequence[Played],
    pdf: bool,
    console: Console,
) -> list[str]:
    """Draw all figures; the names of their files."""
    from ..pictures import figures

    files = []
    with console.status("drawing …"):
        for name, figure in _figures(rows, played):
            for ending in ("png", "pdf") if pdf else ("png",):
                files.append(f"{name}.{ending}")
                figures.save(figure, part.folder / files[-1], part.run)
    return files


def _figures(
    rows: Sequence[dict[str, Any]], played: Sequence[Played]
) -> Iterator[tuple[str, Figure]]:
    """Every figure with the name of its file."""
    from ..pictures import figures, path_figures

    yield "success", figures.success_figure(rows)
    yield "times", figures.time_figure(rows)
    scenarios = list(dict.fromkeys(done.job.scenario for done in played))
    for quantity in ("obstacles", "robots"):
        for number, group in enumerate(figures.sweeps(scenarios, quantity)):
            figure = figures.sweep_figure(rows, group, quantity)
            yield f"against-{quantity}" + (f"-{number + 1}" if number else ""), figure
    for scenario, recordings in _first_starts(played).items():
        if scenario.dim == 2 and scenario.obstacles:
            page = path_figures.trajectories_figure(scenario, recordings)
            yield f"trajectories-{scenario.name}", page


def _first_starts(played: Sequence[Played]) -> dict[Scenario, dict[str, Recording]]:
    """Recordings of the first start, by scenario and policy."""
    first: dict[Scenario, dict[str, Recording]] = {}
    for done in played:
        if done.recordings:
            first.setdefault(done.job.scenario, {})[done.job.policy] = done.recordings[0]
    return first


def _count_excess(played: Sequence[Played]) -> int:
    return sum(int((done.episodes.merge_excess > _ROUNDING).sum()) for done in played)


def _report_excess(played: Sequence[Played]) -> int:
    if count := _count_excess(played):
        print(
            f"error: in {count} episodes a merge raised V above its bound (theory 5); "
            "see merge_excess in episodes.csv",
            file=sys.stderr,
        )
    return int(count > 0)
