"""Independent tasks of a comparison."""

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
from ..resume import RunCheckpoint, program
from ..tasks import Workers, parallel_map
from . import statistics
from .evaluation import Episodes, play
from .settings import Config, Job

BLOCK = 128
"""Maximum number of initial conditions per task, independent of the number of workers.

Rounding of matrix products may depend on their size."""
TOGETHER = 8
"""Batch size that uses the SIMD code path."""
_MANY = 32
"""Number of tasks from which worker processes start at once.

With fewer, this process starts alone, since compiling may dominate the first task."""


@dataclass(frozen=True)
class Played:
    """Results of a job, or of a block of its initial conditions."""

    job: Job
    episodes: Episodes
    recordings: dict[int, Recording]
    """Recordings by number: the first episodes, and the first failure."""
    ready: float = 0.0
    """Time for compiling or loading kernels, s."""


def by_scenario(played: Sequence[Played]) -> dict[str, dict[str, Episodes]]:
    """Episodes by names of scenario and policy."""
    found: dict[str, dict[str, Episodes]] = {}
    for done in played:
        found.setdefault(done.job.scenario.name, {})[done.job.name] = done.episodes
    return found


def play_job(
    job: Job, *, episodes: int, seed: int, keep: int = 0, steps: int | None = None
) -> Played:
    """Run one job; arguments as ``evaluation.play``. Errors of a policy name it in a note."""
    make = partial(policies.make, job.policy, job.scenario)
    try:
        first = make()
        done, recordings = play(
            job.scenario,
            make,
            margin=policies.promised_margin(job.policy, first),
            promised=policies.promised_time(job.policy, first, job.scenario),
            episodes=episodes,
            seed=seed,
            keep=keep,
            steps=steps,
        )
    except Exception as error:
        error.add_note(f"policy {job.policy!r} on scenario {job.scenario.name!r}")
        raise
    return Played(job, done, dict(enumerate(recordings)))


def summary(played: Played) -> dict[str, Any]:
    """Row of results.csv of a job."""
    return statistics.summarise(played.job.scenario, played.job.name, played.episodes)


def plan_of(jobs: Sequence[Job], config: Config) -> dict[str, Any]:
    """Everything that determines the results of a comparison, as plain data."""
    scenarios = list(dict.fromkeys(job.scenario for job in jobs))
    return {
        **program(),
        **{name: getattr(config, name) for name in ("seed", "episodes", "keep", "ceiling")},
        "scenarios": [scenario.to_plain() for scenario in scenarios],
        "registered functions": [policies.registered(scenario) for scenario in scenarios],
        "policies": [
            [job.name for job in jobs if job.scenario == scenario] for scenario in scenarios
        ],
        "weights": {
            policy: _weights(policy, [job.scenario for job in jobs if job.policy == policy])
            for policy in sorted({job.policy for job in jobs})
        },
    }


def _weights(policy: str, scenarios: Sequence[Scenario]) -> str | None:
    """Digests of a policy's files; None if it has none.

    They are the checkpoints of a learned policy by robot model, an exported network, or the source
    of a scripted policy.
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
    """Part of a comparison that can run in any process."""

    name: str  # of the file in OUT.part with its result
    label: str  # for the progress bar when it is done
    scenario: Scenario
    count: int  # number of initial conditions
    work: Callable[[], Any]  # pickled, as its result
    stays: bool = False  # whether it must run in this process


def blocks_of(number: int, job: Job, config: Config) -> list[Task]:
    """Tasks of a job, one per block of initial conditions; ``number`` is the job's index."""
    starts, kept = config.count(job.scenario), config.kept(job.scenario)
    # external registrations exist in this process only
    has_file = ":" in job.policy and not job.policy.startswith("__main__:")
    stays = policies.kind_of(job.policy) == "own" and not has_file
    stays |= bool(policies.registered(job.scenario))
    weights = _weights(job.policy, [job.scenario]) if ":" in job.policy else None
    return [
        Task(
            name=f"job-{number:04d}-{first:06d}",
            label=f"{job.scenario.name} · {job.name}",
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
    """Run ``count`` initial conditions of a job from index ``first``; index 0 has ``seed``.

    The first ``keep`` are recorded and, in the first block, the first failure after these.

    Raises:
        UserError: if the policy's ``_weights`` have changed.
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
        # a network may round differently with one environment; a differing replay is discarded
        if again.episodes.time[0] == done.episodes.time[start] and not again.episodes.good[0]:
            kept[start] = again.recordings[0]
    if weights is not None and _weights(job.policy, [job.scenario]) != weights:
        raise UserError(
            f"policy {job.policy!r}: has changed since the comparison began, for example by "
            "running training or an edit; compare a copy"
        )
    return Played(job, done.episodes, kept, ready)


@cache
def make_ready(job: Job, starts: int) -> None:
    """Compile or load all kernels of a job, those of contacts and merges included."""
    play_job(job, episodes=starts, seed=0, steps=2)
    Simulator(job.scenario, starts).compile()


def joined(blocks: Sequence[Played]) -> Played:
    """Results of a job from its blocks, in order."""
    recordings = {start: one for block in blocks for start, one in block.recordings.items()}
    return Played(blocks[0].job, Episodes.joined([one.episodes for one in blocks]), recordings)


def play_all(
    tasks: Sequence[Task], workers: Workers, part: RunCheckpoint, console: Console
) -> tuple[dict[str, Any], float]:
    """Run all unfinished tasks with a progress bar.

    Returns:
        Results by task name, and the compile time of each worker, s.
    """

    def do(left: Sequence[Task]) -> Generator[tuple[int, Any], None, None]:
        long = len(left) >= _MANY
        return parallel_map(methodcaller("work"), left, workers, attrgetter("stays"), long=long)

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
    """Tasks ordered so that the first ones need different kernels.

    Workers that start together then do not compile the same kernels. Finished tasks count, since
    their kernels are cached.
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
