"""Every figure of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from ..resume import Part
from ..tasks import Workers, each
from .playing import Played
from .settings import Config
from .sweep import rows_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Picture = tuple[str, Callable[[], "Figure"]]
"""The name of a figure, and what draws it."""


def draw(
    part: Part,
    rows: Sequence[dict[str, Any]],
    played: Sequence[Played],
    config: Config,
    console: Console,
) -> list[str]:
    """Draw all figures; the names of their files."""
    endings = ("png", "pdf") if config.pdf else ("png",)
    work = partial(_draw, folder=part.folder, run=part.run, endings=endings)
    pictures = list(_pictures(rows, played, config))
    # on this machine, wherever was played: its files are wanted here
    drawn = each(work, pictures, Workers(config.jobs))
    with console.status("drawing …"), closing(drawn):
        files = dict(drawn)
    return [name for number in sorted(files) for name in files[number]]


def _draw(picture: Picture, *, folder: Path, run: str, endings: Sequence[str]) -> list[str]:
    """Draw one figure; the names of its files."""
    from ..figures import style

    title, make = picture
    figure, names = make(), [f"{title}.{ending}" for ending in endings]
    for name in names:
        style.save(figure, folder / name, run)
    return names


def _pictures(
    rows: Sequence[dict[str, Any]], played: Sequence[Played], config: Config
) -> Iterator[Picture]:
    from ..figures import figures, path_figures

    for sweep in config.sweeps():
        own = rows_of(sweep, rows)
        yield (
            sweep.name,
            partial(figures.level_figure, sweep.base, sweep.field, sweep.labels, own),
        )
    yield "success", partial(figures.success_figure, rows)
    yield "times", partial(figures.time_figure, rows)
    scenarios = list(dict.fromkeys(done.job.scenario for done in played))
    for quantity in ("obstacles", "robots"):
        for number, group in enumerate(figures.sweeps(scenarios, quantity)):
            name = f"against-{quantity}" + (f"-{number + 1}" if number else "")
            yield name, partial(figures.sweep_figure, rows, group, quantity)
    for scenario in scenarios:
        first = {
            done.job.policy: done.recordings[0]
            for done in played
            if done.job.scenario == scenario and 0 in done.recordings
        }
        if first and scenario.dim == 2 and scenario.obstacles:
            draw_paths = partial(path_figures.trajectories_figure, scenario, first)
            yield f"trajectories-{scenario.name}", draw_paths
