"""Every figure of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

from rich.console import Console

from rendezvous_env.experiment.scenario import Scenario

from ..recording import Recording
from . import level_tables
from .out_folder import Part
from .plan import Config
from .playing import Played

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(
    part: Part,
    rows: Sequence[dict[str, Any]],
    played: Sequence[Played],
    config: Config,
    console: Console,
) -> list[str]:
    """Draw all figures; the names of their files."""
    from ..pictures import style

    files = []
    found = chain(level_tables.figures(config.sweeps(), rows), _figures(rows, played))
    with console.status("drawing …"):
        for name, figure in found:
            for ending in ("png", "pdf") if config.pdf else ("png",):
                files.append(f"{name}.{ending}")
                style.save(figure, part.folder / files[-1], part.run)
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
