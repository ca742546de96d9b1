"""Play a comparison in independent tasks."""

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from operator import attrgetter, methodcaller
from typing import Any

import numpy as np
from rendezvous_env.baselines.learned import checkpoints
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.simulator import Simulator

from .. import policies
from ..checks import UserError
from ..console import Console
from ..recording import Recording
from ..results import entry
from ..resume import Part, program
from ..tasks import Workers, each
from . import statistics
from .evaluation import Episodes, play
from .settings import Config, Job

BLOCK = 128
"""Most starts of a task. The same for any number of workers: matrices of another size may be
multiplied in another order, and rounded otherwise."""
TOGETHER = 8
"""Starts that are computed side by side, by other code than a few."""
_MANY = 32
"""Tasks from which on other processes start at once. With fewer this one plays until it sees that
they take long; where kernels are not compiled yet, the first task takes as long as many."""


@dataclass(frozen=True)
class Played:
    """The results of a job, or of a block of its starts."""

    job: Job
    episodes: Episodes
    recordings: dict[int, Recording]
    """By start: the first ones, and the first on which the policy failed."""
    ready: float = 0.0
    """How long it took to make the kernels ready, s."""


def by_scenario(played: Sequence[Played]) -> dict[str, dict[str, Episodes]]:
    """Episodes by names of scenario and policy."""
    found: dict[str, dict[str, Episodes]] = {}
    for done in played:
        found.setdefault(done.job.scenario.name, {})[done.job.policy] = done.episodes
    return found


def play_job(
    job: Job, *, episodes: int, seed: int, keep: int = 0, steps: int | None = None
) -> Played:
    """Play one job; the arguments are those of ``evaluation.play``. What a policy raises has a note
    whose it is.
    """
    make = partial(policies.make, job.policy, job.scenario)
    try:
        margin = policies.promised_margin(job.policy, make())
        done, recordings = play(
            job.scenario, make, margin=margin, episodes=episodes, seed=seed, keep=keep, steps=steps
        )
    except Exception as error:
        error.add_note(f"policy {job.policy!r} on scenario {job.scenario.name!r}")
        raise
    return Played(job, done, dict(enumerate(recordings)))


def summary(played: Played) -> dict[str, Any]:
    """The row of results.csv that belongs to a job."""
    return statistics.summarise(played.job.scenario, played.job.policy, played.episodes)


def plan_of(jobs: Sequence[Job], config: Config) -> dict[str, Any]:
    """All that the numbers of a comparison depend on, as plain data."""
    scenarios = list(dict.fromkeys(job.scenario for job in jobs))
    return {
        **program(),
        **{name: getattr(config, name) for name in ("seed", "episodes", "keep", "ceiling")},
        "scenarios": [scenario.to_plain() for scenario in scenarios],
        "registered functions": [policies.registered(scenario) for scenario in scenarios],
        "policies": [
            [job.policy for job in jobs if job.scenario == scenario] for scenario in scenarios
        ],
        "weights": {
            name: _weights(name, [job.scenario for job in jobs if job.policy == name])
            for name in sorted({job.policy for job in jobs})
        },
    }


def _weights(policy: str, scenarios: Sequence[Scenario]) -> str | None:
    """Digests of a learned policy's checkpoints, one for each robot model that has its own, or of
    the file of a policy: an exported network, or the source of a scripted one; None without one.
    """
    places = {policies.learned_path(policy, scenario) for scenario in scenarios}
    learned = sorted(place for place in places if place is not None)
    if learned and not learned[0].is_file():
        found = [checkpoints.describe(checkpoints.find(place))["sha256"] for place in learned]
        return " ".join(map(str, found))
    if learned:
        return str(entry(learned[0])["sha256"])
    return policies.source_digest(policy)


@dataclass(frozen=True)
class Task:
    """A part of a comparison that any process can do."""

    name: str  # of the file in OUT.part that keeps its result
    label: str  # for the progress bar, once it is done
    scenario: Scenario
    count: int  # of starts
    work: Callable[[], Any]  # pickled, as its result
    stays: bool = False  # whether only this process can do it


def blocks_of(number: int, job: Job, config: Config) -> list[Task]:
    """A job, cut into blocks of its starts; ``number`` is its place among all jobs."""
    starts, kept = config.starts(job.scenario), config.kept(job.scenario)
    # what was registered from outside is known to this process alone
    has_file = ":" in job.policy and not job.policy.startswith("__main__:")
    stays = policies.kind_of(job.policy) == "own" and not has_file
    stays |= bool(policies.registered(job.scenario))
    weights = _weights(job.policy, [job.scenario]) if ":" in job.policy else None
    return [
        Task(
            name=f"job-{number:04d}-{first:06d}",
            label=f"{job.scenario.name} · {job.policy}",
            scenario=job.scenario,
            count=(count := min(BLOCK, starts - first)),
            work=partial(
                play_block, job, first, count, config.seed, min(count, kept - first), weights
            ),
            stays=stays,
        )
        for first in range(0, starts, BLOCK)
    ]


def play_block(
    job: Job, first: int, count: int, seed: int, keep: int, weights: str | None
) -> Played:
    """Play ``count`` starts of a job, from number ``first`` on; ``seed`` is that of start 0.

    The first ``keep`` are recorded and, of the first block, the first failure beyond these. A
    UserError if the policy's ``_weights`` are not the given ones any more.
    """
    began = time.perf_counter()
    make_ready(job, min(count, TOGETHER))
    ready = time.perf_counter() - began
    done = play_job(job, episodes=count, seed=seed + first, keep=max(0, keep))
    kept = {first + start: one for start, one in done.recordings.items()}
    failed = np.flatnonzero(~done.episodes.good)
    if first == 0 and keep > 0 and failed.size and failed[0] >= keep:
        start = int(failed[0])
        again = play_job(job, episodes=1, seed=seed + start, keep=1)
        # played alone, a network may round otherwise: a replay that differs is not shown
        if again.episodes.time[0] == done.episodes.time[start] and not again.episodes.good[0]:
            kept[start] = again.recordings[0]
    if weights is not None and _weights(job.policy, [job.scenario]) != weights:
        raise UserError(
            f"policy {job.policy!r}: was changed since the comparison began, as a run that still "
            "trains or a file that is edited; compare a copy of it"
        )
    return Played(job, done.episodes, kept, ready)


@cache
def make_ready(job: Job, starts: int) -> None:
    """Play two steps, so that the kernels of a job are loaded, or compiled; those of contacts and
    merges too, which two steps may not need.
    """
    play_job(job, episodes=starts, seed=0, steps=2)
    Simulator(job.scenario, starts).compile()


def joined(blocks: Sequence[Played]) -> Played:
    """The results of a job, of all its blocks in order."""
    recordings = {start: one for block in blocks for start, one in block.recordings.items()}
    return Played(blocks[0].job, Episodes.joined([one.episodes for one in blocks]), recordings)


def play_all(
    tasks: Sequence[Task], workers: Workers, part: Part, console: Console
) -> tuple[dict[str, Any], float]:
    """Do all tasks that are not finished, under a progress bar; results by the names of tasks, and
    how long each worker made kernels ready, s.
    """

    def do(left: Sequence[Task]) -> Generator[tuple[int, Any], None, None]:
        long = len(left) >= _MANY
        return each(methodcaller("work"), left, workers, attrgetter("stays"), long=long)

    found, ready = {}, 0.0
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        bar = progress.add_task("playing", total=sum(task.count for task in tasks))
        for task, result, now in part.finish(_one_of_each_first(tasks), do):
            found[task.name] = result
            ready += result.ready if now and isinstance(result, Played) else 0.0
            progress.update(bar, advance=task.count, description=task.label.ljust(40))
        progress.update(bar, description="played".ljust(40))
    return found, ready / workers.worker_count


def _one_of_each_first(tasks: Sequence[Task]) -> list[Task]:
    """The tasks, those first that need different kernels: workers that start together then do not
    compile the same ones. All tasks count, finished ones too, as their kernels lie on disk.
    """
    first: dict[tuple[Any, ...], str] = {}
    for task in tasks:
        layout, scenario = task.scenario.observation_layout, task.scenario
        kernels = (
            scenario.robot_model,
            scenario.dim,
            type(scenario.obstacles).__name__,
            scenario.sensing.exact,
            layout.neighbour_slots == scenario.n_robots - 1,
            task.count < TOGETHER,
        )
        first.setdefault(kernels, task.name)
    return sorted(tasks, key=lambda task: task.name not in first.values())
