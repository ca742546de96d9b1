"""What can be reached in the scenarios of a comparison: played, kept, and shown."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing

from rich.console import Console

from .. import results
from ..unfinished import Part
from ..workers import each
from . import ceiling, cells, tables
from .ceiling import Run, Task
from .plan import Config, Job
from .playing import progress


def play_ceilings(part: Part, jobs: Sequence[Job], config: Config, console: Console) -> list[str]:
    """Estimate what can be reached in each scenario with obstacles; a table and ceiling.csv.

    Returns:
        Names of the files.
    """
    scenarios = dict.fromkeys(job.scenario for job in jobs if ceiling.applies(job.scenario))
    tasks = [
        task
        for scenario in scenarios
        for task in ceiling.tasks_of(
            scenario, config.ceiling, episodes=config.starts(scenario), seed=config.seed
        )
    ]
    names = {task: f"ceiling-{task.scenario.name}-{task.run:04d}" for task in tasks}
    found = {task: cells.load_run(part, name) for task, name in names.items()}
    left = [task for task in tasks if found[task] is None]
    runs = each(ceiling.play_run, left, config.workers)
    with progress(console) as shown, closing(runs):
        done = len(tasks) - len(left)
        bar = shown.add_task("best of many", total=len(tasks), completed=done)
        for number, run in runs:
            found[left[number]] = run
            cells.save_run(part, names[left[number]], run)
            name = f"{left[number].scenario.name} · best of {config.ceiling}".ljust(40)
            shown.update(bar, advance=1, description=name)
    rows = [ceiling.joined(_of(found, scenario.name)).row(scenario) for scenario in scenarios]
    results.write_csv(part.folder / "ceiling.csv", ceiling.COLUMNS, rows)
    console.print(tables.ceiling_table(rows))
    return ["ceiling.csv"]


def _of(found: dict[Task, Run | None], scenario: str) -> dict[Task, Run]:
    """The runs on one scenario."""
    return {
        task: run
        for task, run in found.items()
        if run is not None and task.scenario.name == scenario
    }
