"""Every figure of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.console import Console

from rendezvous_env.scenario.scenario import Scenario

from ..recording import Recording
from ..resume import Part
from ..tasks import Workers, each
from .playing import Played
from .settings import Config
from .sweep import Sweep, rows_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Picture(NamedTuple):
    """A figure that is still to be drawn."""

    name: str
    draw: Callable[..., Figure]
    arguments: tuple[Any, ...]


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
    pictures = [*_of_levels(config.sweeps(), rows), *_pictures(rows, played)]
    # on this machine, wherever was played: its files are wanted here
    drawn = each(work, pictures, Workers(config.jobs))
    with console.status("drawing …"), closing(drawn):
        files = dict(drawn)
    return [name for number in sorted(files) for name in files[number]]


def _draw(picture: Picture, *, folder: Path, run: str, endings: Sequence[str]) -> list[str]:
    """Draw one figure; the names of its files."""
    from ..figures import style

    figure = picture.draw(*picture.arguments)
    names = [f"{picture.name}.{ending}" for ending in endings]
    for name in names:
        style.save(figure, folder / name, run)
    return names


def _of_levels(sweeps: Sequence[Sweep], rows: Sequence[dict[str, Any]]) -> Iterator[Picture]:
    """A figure for each field of a sensor and scenario."""
    from ..figures.figures import level_figure

    for sweep in sweeps:
        own = rows_of(sweep, rows)
        yield Picture(sweep.name, level_figure, (sweep.base, sweep.field, sweep.labels, own))


def _pictures(rows: Sequence[dict[str, Any]], played: Sequence[Played]) -> Iterator[Picture]:
    """Every figure of a comparison on scenarios as they are."""
    from ..figures import figures, path_figures

    yield Picture("success", figures.success_figure, (rows,))
    yield Picture("times", figures.time_figure, (rows,))
    scenarios = list(dict.fromkeys(done.job.scenario for done in played))
    for quantity in ("obstacles", "robots"):
        for number, group in enumerate(figures.sweeps(scenarios, quantity)):
            name = f"against-{quantity}" + (f"-{number + 1}" if number else "")
            yield Picture(name, figures.sweep_figure, (rows, group, quantity))
    for scenario, recordings in _first_starts(played).items():
        if scenario.dim == 2 and scenario.obstacles:
            given = scenario, recordings
            yield Picture(f"trajectories-{scenario.name}", path_figures.trajectories_figure, given)


def _first_starts(played: Sequence[Played]) -> dict[Scenario, dict[str, Recording]]:
    """Recordings of the first start, by scenario and policy."""
    first: dict[Scenario, dict[str, Recording]] = {}
    for done in played:
        if 0 in done.recordings:
            first.setdefault(done.job.scenario, {})[done.job.policy] = done.recordings[0]
    return first
