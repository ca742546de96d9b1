"""``rendezvous compare``: policies on the same initial conditions; tables, files and figures."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rendezvous_env.checks import counted

from .. import results
from ..console import Console
from ..resume import RunCheckpoint
from ..tasks import Workers, parallel_map
from . import out_folder, statistics, sweep, tables, upper_bound
from .playing import Played, blocks_of, by_scenario, joined, plan_of, play_all, play_job, summary
from .ranking import Ranking, answer, rank
from .settings import Config, Job, plan

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Config", "Job", "Played", "plan", "play_job", "run", "summary"]

Row = dict[str, Any]
Picture = tuple[str, Callable[[], "Figure"]]
"""Name of a figure and the function that draws it."""


class _Clock(dict[str, float]):
    """Wall-clock time of each finished stage, s."""

    def __init__(self) -> None:
        super().__init__()
        self._began = time.perf_counter()

    @property
    def total(self) -> float:
        """Time since the start of the command, s."""
        return time.perf_counter() - self._began

    def now(self, part: str) -> None:
        """Attribute the time since the last call to a stage."""
        self[part] = self.total - sum(self.values())


def run(config: Config) -> int:
    """Run the comparison, print the summary and write all files.

    Returns:
        Exit status: 1 if a merge raised V above its proven bound, else 0.
    """
    console, clock = Console(), _Clock()
    jobs = plan(config)
    out = out_folder.destination(config.out)
    part = RunCheckpoint(out_folder.part_of(out), plan_of(jobs, config), "comparison")
    with part.at_work(config.out, console, fresh=config.fresh):
        results.put_back(out)
        clock.now("setting up")
        found, clock["compiling"] = _play(config, jobs, part, console)
        clock.now("playing")
        files = write(part, found, config)
        _show(found, config, console)
        clock.now("tables")
        if config.figures:
            files += _draw(part, found, config, console)
            clock.now("drawing")
        timing = {f"{name.replace(' ', '_')}_s": seconds for name, seconds in clock.items()}
        about = description(config, found, timing | {"total_s": clock.total})
        if config.json is not None:
            kept = {name: about[name] for name in ("seed", "command_line", "versions", "timing")}
            write_summary(config.json, found, kept)
        out_folder.seal(part.whole, files, {**about, "run": part.run})
        results.put_in_place(part.whole, out)
        part.discard()
    episodes = sum(len(done.episodes.success) for done in found.played)
    split = ", ".join(f"{name} {seconds:.1f}" for name, seconds in clock.items())
    said = f"{counted(episodes, 'episode')} in {clock.total:.1f} s: {split}; files in "
    console.print(f"{said}{config.out}", soft_wrap=True)
    if found.excess:
        print(
            f"error: in {counted(found.excess, 'episode')} a merge raised V above its bound "
            "(theory 5); see merge_excess in episodes.csv",
            file=sys.stderr,
        )
    return int(found.excess > 0)


@dataclass(frozen=True)
class ComparisonResult:
    """Results of a comparison."""

    played: list[Played]  # in the order of the jobs
    rows: list[Row]  # of results.csv
    pairs: list[Row]  # of paired.csv
    bounds: list[Row]  # of ceiling.csv
    rankings: list[Ranking]

    @property
    def excess(self) -> int:
        """Number of episodes in which a merge raised V above its proven bound plus rounding."""
        return sum(
            int((one.episodes.merge_excess > statistics.rounding_of_v(one.job.scenario)).sum())
            for one in self.played
        )


def _play(
    config: Config, jobs: Sequence[Job], part: RunCheckpoint, console: Console
) -> tuple[ComparisonResult, float]:
    """Results, and the time that workers spent on compiling or loading kernels, s."""
    blocks = [blocks_of(number, job, config) for number, job in enumerate(jobs)]
    bounded = filter(upper_bound.applies, dict.fromkeys(job.scenario for job in jobs))
    runs = {one: upper_bound.tasks_of(one, config) for one in bounded if config.ceiling}
    cells, compiling = play_all([*chain(*blocks, *runs.values())], config, part, console)
    played = [joined([cells[task.name] for task in own]) for own in blocks]
    bounds = [
        upper_bound.row_of(scenario, [cells[task.name] for task in own])
        for scenario, own in runs.items()
    ]
    rows, pairs = list(map(summary, played)), paired_rows(played, config.against)
    return ComparisonResult(played, rows, pairs, bounds, rank(played)), compiling


def paired_rows(played: Sequence[Played], against: str | None) -> list[Row]:
    """Rows of paired.csv; another reference is used where ``against`` was not run."""
    return [
        row
        for scenario, own in by_scenario(played).items()
        for row in statistics.compare_pairs(scenario, own, against if against in own else None)
    ]


def _show(found: ComparisonResult, config: Config, console: Console) -> None:
    """Print the summary, the matrix and the requested details."""
    if config.ceiling:
        console.print(tables.ceiling_table(found.bounds))
    console.print(f"\n{answer(found.rankings)}\n", style="bold")
    if config.sensing:
        tables.show_sweeps(config.sweeps(), found.rows, console)
    else:
        tables.show_matrix(found.rankings, console)
    if config.against is not None:
        console.print()
        own = [row for row in found.pairs if row["against"] == config.against]
        console.print(tables.paired_table(own))
    if config.details:
        used = {done.job.scenario.name: done.job.scenario for done in found.played}
        wide = Console(width=max(console.width, tables.WIDTH))
        wide.print()
        wide.print(tables.results_table(found.rows, used))
    else:
        console.print("times, lengths, margins: --details, or results.csv")
    console.print()


def write(part: RunCheckpoint, found: ComparisonResult, config: Config) -> list[str]:
    """Write all tables and trajectories.npz; returns their names."""
    episodes = (
        {"scenario": done.job.scenario.name, "policy": done.job.name} | row
        for done in found.played
        for row in done.episodes.rows()
    )
    levels = (sweep.rows_of(one, found.rows) for one in config.sweeps())
    lists = {
        "results.csv": found.rows,
        "episodes.csv": list(episodes),
        "ceiling.csv": found.bounds,
        "levels.csv": list(chain.from_iterable(levels)),
    }
    files = [name for name, rows in lists.items() if rows]
    for name in files:
        results.write_csv(part.whole / name, lists[name])
    results.write_csv(part.whole / "paired.csv", found.pairs, results.PAIRED_COLUMNS)
    arrays = {
        f"{done.job.scenario.name}/{done.job.name}/{start}/{name}": array
        for done in found.played
        for start, recording in done.recordings.items()
        for name, array in recording.items()
    }
    results.write_arrays(part.whole / "trajectories.npz", arrays, part.run)
    return [*files, "paired.csv", "trajectories.npz"]


def description(
    config: Config, found: ComparisonResult, timing: dict[str, float]
) -> dict[str, Any]:
    """Content of run.json without the digests."""
    counts = {done.job.scenario: len(done.episodes.success) for done in found.played}
    return results.provenance() | {
        "seed": config.seed,
        "episodes": config.episodes or max(counts.values()),
        "keep": max(min(config.kept(one), config.count(one)) for one in counts),
        "initial_conditions": {scenario.name: count for scenario, count in counts.items()},
        "scenarios": {scenario.name: scenario.to_plain() for scenario in counts},
        "versioned": {scenario.name: results.versioned(scenario) for scenario in counts},
        "policies": {name: list(own) for name, own in by_scenario(found.played).items()},
        "labels": {one.job.label: one.job.policy for one in found.played if one.job.label},
        "merges_above_bound": found.excess,
        "timing": timing,
    }


def write_summary(path: Path, found: ComparisonResult, about: Mapping[str, Any]) -> None:
    """Write a JSON summary for ``--json``.

    Columns are those of results.csv and paired.csv, null if not applicable.
    """
    scenarios = {
        ranking.scenario: {
            "initial_conditions": ranking.count,
            "best": ranking.best if ranking.is_contest else None,
            "tied": list(ranking.tied),
            "references": list(ranking.references),
            "policies": {
                row["policy"]: _plain(row, results.RESULT_COLUMNS[2:])
                for row in found.rows
                if row["scenario"] == ranking.scenario
            },
        }
        for ranking in found.rankings
    }
    pairs = [_plain(row, results.PAIRED_COLUMNS) for row in found.pairs]
    content = {"answer": answer(found.rankings), "scenarios": scenarios, "paired": pairs, **about}
    results.write_json(path, content)


def _plain(row: Row, columns: Sequence[str]) -> Row:
    """Cells as numbers and strings, null if empty."""
    cells = {column: results.plain(row[column]) for column in columns}
    return {column: None if cell == "" else cell for column, cell in cells.items()}


def _draw(
    part: RunCheckpoint, found: ComparisonResult, config: Config, console: Console
) -> list[str]:
    """Draw all figures; returns the names of their files."""
    pictures, endings = list(_pictures(found, config)), ("png", "pdf") if config.pdf else ("png",)
    work = partial(_draw_one, folder=part.whole, run=part.run, endings=endings)
    # on this machine, since the files are needed here
    drawn = parallel_map(work, pictures, Workers(jobs=config.jobs))
    with console.status("drawing …"), closing(drawn):
        list(drawn)
    return [f"{title}.{ending}" for title, _ in pictures for ending in endings]


def _draw_one(picture: Picture, *, folder: Path, run: str, endings: Sequence[str]) -> None:
    from ..figures import style

    title, make = picture
    figure = make()
    for ending in endings:
        style.save(figure, folder / f"{title}.{ending}", run)


def _pictures(found: ComparisonResult, config: Config) -> Iterator[Picture]:
    from ..figures import figures, path_figures

    for one in config.sweeps():
        yield one.name, partial(figures.level_figure, one, sweep.rows_of(one, found.rows))
    yield "success", partial(figures.success_figure, found.rows)
    yield "times", partial(figures.time_figure, found.rows)
    scenarios = list(dict.fromkeys(done.job.scenario for done in found.played))
    for quantity in ("obstacles", "robots"):
        for number, group in enumerate(figures.sweeps(scenarios, quantity)):
            name = f"against-{quantity}" + (f"-{number + 1}" if number else "")
            yield name, partial(figures.sweep_figure, found.rows, group, quantity)
    for scenario in scenarios:
        first = {
            done.job.name: done.recordings[0]
            for done in found.played
            if done.job.scenario == scenario and 0 in done.recordings
        }
        if first and scenario.dim == 2:
            draw = partial(path_figures.trajectories_figure, scenario, first)
            yield f"trajectories-{scenario.name}", draw
