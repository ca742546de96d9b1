"""Play what is left of a comparison, cut into tasks that do not depend on each other."""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock
from rendezvous_env.baselines import policy as registry
from rendezvous_env.baselines.learned import checkpoints
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from rendezvous_env.scenario.scenario import Scenario

from .. import policies
from ..recording import Recording
from ..resume import Part, program
from ..tasks import each
from . import statistics
from .evaluation import Episodes, play
from .settings import Config, Job

BLOCK = 128
"""Most starts of a task. The same for any number of workers: matrices of another size may be
multiplied in another order, and rounded otherwise."""
TOGETHER = 8
"""Starts that are computed side by side, by other code than a few."""
_MANY = 32
"""Tasks for which other processes are begun at once. With fewer this one plays until it sees that
they take long, and where kernels are not compiled yet the first task takes as long as many."""


@dataclass(frozen=True)
class Played:
    """What came of a job."""

    job: Job
    """The job."""
    episodes: Episodes
    """Measured, one entry for each start."""
    recordings: dict[int, Recording]
    """By start: the first ones, and the first on which the policy failed."""


Cell = tuple[Episodes, dict[int, Recording]]
"""What comes of a task."""


@dataclass(frozen=True)
class Task:
    """A block of the starts of a job."""

    number: int
    """Of the job."""
    job: Job
    """The job."""
    first: int
    """Number of the first start."""
    count: int
    """How many there are."""
    seed: int
    """Of the first start."""
    keep: int
    """How many of them to record."""

    @property
    def name(self) -> str:
        """Of its cell."""
        return f"job-{self.number:04d}-{self.first:06d}"


def play_job(
    job: Job, *, episodes: int, seed: int, keep: int = 0, steps: int | None = None
) -> Played:
    """Play one job; the arguments are those of ``evaluation.play``."""
    scenario, name = job.scenario, job.policy
    make = partial(policies.make, name, scenario)
    margin = policies.promised_margin(name, make())
    settings: dict[str, Any] = {"margin": margin, "steps": steps}
    done, recordings = play(scenario, make, episodes=episodes, seed=seed, keep=keep, **settings)
    return Played(job, done, dict(enumerate(recordings)))


def summary(played: Played) -> dict[str, Any]:
    """The row of results.csv that belongs to a job."""
    scenario, name = played.job.scenario, played.job.policy
    limit = scenario.max_steps * scenario.tau
    return statistics.summarise(scenario.name, name, played.episodes, limit)


def plan_of(jobs: Sequence[Job], config: Config) -> dict[str, Any]:
    """All that the numbers of a comparison depend on, as plain data."""
    scenarios = list(dict.fromkeys(job.scenario for job in jobs))
    return {
        **program(),
        **{name: getattr(config, name) for name in ("seed", "episodes", "keep", "ceiling")},
        "scenarios": [scenario.to_plain() for scenario in scenarios],
        "policies": [
            [job.policy for job in jobs if job.scenario == scenario] for scenario in scenarios
        ],
        "weights": {name: _weights(name) for name in sorted({job.policy for job in jobs})},
    }


def _weights(policy: str) -> str | None:
    """Digest of a learned policy's checkpoint, or of the file that holds a policy: an exported
    network, or the source of a scripted one.

    None for one that was typed in and stands in no file.
    """
    learned = policies.learned_path(policy)
    if learned is not None and not learned.is_file():
        return str(checkpoints.describe(checkpoints.find(learned))["sha256"])
    path = learned or policies.source_file(policy)
    return None if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


# ---- tasks --------------------------------------------------------------------------------------


def tasks_of(jobs: Sequence[Job], config: Config) -> Iterator[Task]:
    """The tasks of a comparison, in the order of its jobs."""
    for number, job in enumerate(jobs):
        starts = config.starts(job.scenario)
        for first in range(0, starts, BLOCK):
            count, kept = min(BLOCK, starts - first), max(0, config.kept(job.scenario) - first)
            yield Task(number, job, first, count, config.seed + first, min(kept, count))


def play_task(task: Task) -> tuple[Cell, float]:
    """What came of a task, and how long it took to make its kernels ready, s."""
    began = time.perf_counter()
    make_ready(task.job, min(task.count, TOGETHER))
    seconds = time.perf_counter() - began
    done = play_job(task.job, episodes=task.count, seed=task.seed, keep=task.keep)
    return (done.episodes, done.recordings | _first_failure(task, done.episodes)), seconds


def _first_failure(task: Task, episodes: Episodes) -> dict[int, Recording]:
    """A recording of the first start on which the policy failed, unless one is kept already."""
    failed = np.flatnonzero(~episodes.good)
    if task.first or not task.keep or not failed.size or failed[0] < task.keep:
        return {}
    start = int(failed[0])
    again = play_job(task.job, episodes=1, seed=task.seed + start, keep=1)
    # played alone, a network may round otherwise: only what is told of the start is shown
    same = again.episodes.time[0] == episodes.time[start]
    return {start: again.recordings[0]} if same and not again.episodes.good[0] else {}


@cache
def make_ready(job: Job, starts: int) -> None:
    """Play two steps, so that the kernels of a job are loaded, or compiled by one process while the
    others that need the like wait for it.
    """
    with FileLock(_lock_of(_kernels_of(job.scenario, starts))):
        play_job(job, episodes=starts, seed=0, steps=2)


def _kernels_of(scenario: Scenario, starts: int) -> tuple[Any, ...]:
    """Scenarios for which this is the same are stepped by the same kernels, or by few others."""
    layout = scenario.observation_layout
    return (
        scenario.robot_model,
        scenario.dim,
        type(scenario.obstacles).__name__,
        scenario.sensing.exact,
        layout.neighbour_slots == scenario.n_robots - 1,
        starts < TOGETHER,
    )


def _one_of_each_first(tasks: Sequence[Task]) -> list[Task]:
    """The same tasks, begun with one for each kind of kernels: workers that start together then
    compile different ones, and none waits for another.
    """
    seen: set[tuple[Any, ...]] = set()
    first: list[Task] = []
    rest: list[Task] = []
    for task in tasks:
        kernels = _kernels_of(task.job.scenario, task.count)
        (rest if kernels in seen else first).append(task)
        seen.add(kernels)
    return first + rest


def _lock_of(kernels: tuple[Any, ...]) -> Path:
    """The lock of a kind of kernels, in a folder of this user's own."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"rendezvous-env-locks-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder / f"{hashlib.sha256(repr(kernels).encode()).hexdigest()[:16]}.lock"


def _stays(task: Task) -> bool:
    """Whether only this process knows the policy: it was entered from outside."""
    with suppress(KeyError):
        return registry.kind_of(task.job.policy) == "own"
    return False


def play_all(
    jobs: Sequence[Job], config: Config, part: Part, console: Console
) -> tuple[list[Played], float]:
    """Play all tasks that are not finished, under a progress bar.

    Returns:
        What came of all jobs, and the time for which workers made kernels ready, s, for each of
        them.
    """
    tasks = list(tasks_of(jobs, config))
    found: dict[Task, Cell | None] = {task: part.load(task.name) for task in tasks}
    left = _one_of_each_first([task for task in tasks if found[task] is None])
    ready = 0.0
    results = each(play_task, left, config.workers, _stays, long=len(left) >= _MANY)
    with progress(console) as shown, closing(results):
        total = sum(task.count for task in tasks)
        done = total - sum(task.count for task in left)
        bar = shown.add_task("playing", total=total, completed=done)
        for number, (cell, seconds) in results:
            task, ready = left[number], ready + seconds
            part.save(task.name, cell)
            found[task] = cell
            name = f"{task.job.scenario.name} · {task.job.policy}".ljust(40)
            shown.update(bar, advance=task.count, description=name)
        shown.update(bar, description="played".ljust(40))
    return list(_joined(jobs, found)), ready / config.workers.count


def _joined(jobs: Sequence[Job], found: dict[Task, Cell | None]) -> Iterator[Played]:
    """What came of each job, of the cells of its tasks."""
    parts: list[list[Cell]] = [[] for _ in jobs]
    for task, cell in found.items():
        assert cell is not None
        parts[task.number].append(cell)
    for job, blocks in zip(jobs, parts, strict=True):
        episodes = Episodes.joined([episodes for episodes, _ in blocks])
        # blocks are in the order of their starts
        kept = [
            (number * BLOCK + start, one)
            for number, (_, recordings) in enumerate(blocks)
            for start, one in recordings.items()
        ]
        yield Played(job, episodes, dict(kept))


def progress(console: Console) -> Progress:
    """A progress bar for starts."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    return Progress(*columns, TimeElapsedColumn(), console=console)
