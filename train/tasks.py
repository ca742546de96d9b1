"""Independent tasks: one after the other, on all cores (joblib), or on a Ray cluster."""

from __future__ import annotations

import os
import queue
import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import as_completed
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

from tyro.conf import arg

from rendezvous_env.engine.threads import available_cores

from . import cluster
from .checks import UserError, check_installed, check_least, check_most

Task = TypeVar("Task")
Result = TypeVar("Result")
Place = Literal["here", "ray"]

_ALONE = 2.0
"""s for which this process works by itself; only what takes longer is worth starting others."""
_TRIES = 3
"""Times in a row that workers may be lost without a task being done."""
_MOST = 2**12


@dataclass(frozen=True)
class Workers:
    """Who does the tasks.

    Raises:
        UserError: for a number that cannot be, or a cluster that cannot be asked.
    """

    jobs: int | None = None
    """How many work at once; None is one on each core, or all that the cluster has."""
    on: Place = "here"
    """This machine, or a Ray cluster."""
    address: str | None = None
    """Of the cluster; None starts one on this machine."""

    def __post_init__(self) -> None:
        check_least(self, jobs=1)
        check_most(self, jobs=_MOST)
        if self.on == "here" and self.address is not None:
            raise UserError(f"--address is {self.address}; only --backend ray has one")
        if self.on == "ray":
            check_installed("--backend ray", "ray", "ray")

    @property
    def count(self) -> int:
        """How many work at once on this machine."""
        return self.jobs or available_cores()


@dataclass(frozen=True, kw_only=True)
class WorkerFlags:
    """Flags of commands whose tasks workers do."""

    jobs: int | None = None
    """How many processes work at once: one on each core if nothing is said, or all that a cluster
    has. Results are the same, bit for bit, whatever their number."""
    on: Annotated[Place, arg(name="backend", aliases=("--on",))] = "here"
    """Where they work: on this machine, or on a Ray cluster."""
    address: str | None = None
    """The address of the Ray cluster; without one a cluster starts on this machine."""

    @property
    def workers(self) -> Workers:
        """Who does the tasks."""
        return Workers(self.jobs, self.on, self.address)


def each(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: Workers,
    here: Callable[[Task], bool] = lambda task: False,
    *,
    long: bool = False,
) -> Generator[tuple[int, Result], None, None]:
    """Do all tasks; what each gives does not depend on who does it, nor on when.

    Workers are processes: most of a step is Python's, and holds its lock. One that is lost (a kill,
    or no memory) costs what was in the air, which is done again. They end when the iterator is
    closed, which a caller that may be interrupted sees to itself.

    Args:
        work: what to do with a task; both travel to other processes, as the result does.
        tasks: any.
        workers: who does them.
        here: whether a task must be done in this process.
        long: whether to start workers at once; else when the first tasks have taken some seconds.

    Yields:
        Number of a task and what it gave, in the order in which they end.

    Raises:
        UserError: if workers are lost again and again, or there is no such cluster.
        Exception: what a task raised.
    """
    left = dict(enumerate(tasks))
    alone = workers.on == "here" and workers.count == 1
    began = time.monotonic()
    for number, task in enumerate(tasks):
        at_first = workers.on == "here" and not long and time.monotonic() - began < _ALONE
        if alone or at_first or here(task):
            yield number, work(left.pop(number))
    if not left:
        return
    if workers.on == "ray":
        found = cluster.spread(
            work,
            list(left.items()),
            tries=_TRIES,
            jobs=workers.jobs,
            address=workers.address,
            cores=workers.count,
        )
    else:
        found = _on_cores(work, left, workers.count)
    with closing(found):
        yield from found


def _on_cores(
    work: Callable[[Task], Result], left: dict[int, Task], count: int
) -> Generator[tuple[int, Result], None, None]:
    """Results from other processes of this machine, which are begun anew if one is lost."""
    from joblib.externals.loky.process_executor import BrokenProcessPool

    lost = 0
    while left:
        executor = _executor(min(count, len(left)))
        try:
            numbers = {executor.submit(work, task): number for number, task in left.items()}
            for done in as_completed(numbers):
                result, number, lost = done.result(), numbers.pop(done), 0
                del left[number]
                yield number, result
        except BrokenProcessPool as error:
            lost += 1
            if lost == _TRIES:
                raise UserError(
                    f"workers ended {_TRIES} times before any task was done ({error}); memory may "
                    f"be short: try fewer than --jobs {count}"
                ) from error
        finally:
            _end(executor)


def _executor(count: int) -> Any:
    """So many worker processes, each of one thread, which end with this one and hear no Ctrl-C: a
    terminal tells it to all processes, and this one sees to the others.
    """
    from joblib.externals.loky.process_executor import ProcessPoolExecutor

    # a worker that compiles much takes more and more memory, and joblib starts another one
    warnings.filterwarnings("ignore", message="A worker stopped while some jobs")
    executor = ProcessPoolExecutor(
        count, initializer=_end_with, initargs=(os.getpid(),), env=cluster.ALONE
    )
    mask = signal.pthread_sigmask
    before = mask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        executor._ensure_executor_running()  # processes and threads inherit the mask
    finally:
        mask(signal.SIG_SETMASK, before)
    return executor


def _end(executor: Any) -> None:
    """Kill the workers, whatever they are at, and forget the tasks that nobody has begun.

    Its thread would else look for these tasks after it has thrown them away: a KeyError.
    """
    with suppress(queue.Empty):
        while True:
            executor._work_ids.get_nowait()
    executor.shutdown(kill_workers=True)


def _end_with(parent: int) -> None:
    """Let this worker end as soon as the process is gone that it works for."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
