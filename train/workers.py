"""Tasks that do not depend on each other: one after the other, on all cores, or on a cluster."""

from __future__ import annotations

import importlib.util
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from rendezvous_env.engine.pool.threads import available_cores

from . import cluster
from .checks import check_least, check_most
from .errors import UserError

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
            raise UserError(f"--address is {self.address}; only --on ray has one")
        if self.on == "ray" and importlib.util.find_spec("ray") is None:
            raise UserError("--on ray needs Ray; pip install 'rendezvous-env[ray]'")

    @property
    def count(self) -> int:
        """How many work at once on this machine."""
        return self.jobs or available_cores()


def each(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: Workers,
    here: Callable[[Task], bool] = lambda task: False,
    *,
    long: bool = False,
) -> Iterator[tuple[int, Result]]:
    """Do all tasks; what each gives does not depend on who does it, nor on when.

    Workers are processes: most of a step is Python's, and holds its lock. A worker that is lost (a
    kill, or no memory) costs what was in the air, which is done again. The workers end when the
    iterator is closed, which a caller that may be interrupted sees to itself.

    Args:
        work: what to do with a task; both travel to other processes, as the result does.
        tasks: any.
        workers: who does them.
        here: whether a task must be done in this process.
        long: whether to start workers at once, since a single task takes long or there are many;
            else they start when the first tasks have taken some seconds.

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
    if left:
        elsewhere = _on_cluster if workers.on == "ray" else _on_cores
        with closing(elsewhere(work, left, workers)) as results:
            yield from results


def _on_cluster(work: Any, left: dict[int, Any], workers: Workers) -> Iterator[tuple[int, Any]]:
    """Results from a Ray cluster."""
    yield from cluster.spread(
        work,
        list(left.items()),
        tries=_TRIES,
        jobs=workers.jobs,
        address=workers.address,
        cores=workers.count,
    )


def _on_cores(work: Any, left: dict[int, Any], workers: Workers) -> Iterator[tuple[int, Any]]:
    """Results from other processes of this machine, which are begun anew if one is lost."""
    from joblib.externals.loky.process_executor import BrokenProcessPool

    lost = 0
    while left:
        try:
            with closing(_spread(work, list(left.items()), workers)) as found:
                for number, result in found:
                    lost = 0
                    del left[number]
                    yield number, result
        except BrokenProcessPool as error:
            lost += 1
            if lost == _TRIES:
                raise UserError(
                    f"workers ended {_TRIES} times before any task was done ({error}); memory may "
                    f"be short: try fewer than --jobs {workers.count}"
                ) from error


def _numbered(work: Callable[[Task], Result], number: int, task: Task) -> tuple[int, Result]:
    return number, work(task)


def _spread(work: Any, tasks: list[tuple[int, Any]], workers: Workers) -> Iterator[Any]:
    """Results from other processes of this machine, as they come."""
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky import get_reusable_executor

    calls = [delayed(_numbered)(work, number, task) for number, task in tasks]
    count = min(workers.count, len(calls))
    # Ctrl-C is told to all processes of a terminal; this one sees to the others
    with (
        _deaf(),
        parallel_config(
            "loky",
            inner_max_num_threads=1,
            max_nbytes=None,
            initializer=_end_with,
            initargs=(os.getpid(),),
        ),
    ):
        found = Parallel(count, return_as="generator_unordered", batch_size=1)(calls)
    # a worker that compiles much takes more and more memory, and joblib starts another one
    warnings.filterwarnings("ignore", message="A worker stopped while some jobs")
    try:
        for one in found:  # noqa: UP028 - would close it before the warning is off
            yield one
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that not all results were asked for
            found.close()
        get_reusable_executor(reuse=True).shutdown(
            kill_workers=True
        )  # they would wait for more to do


@contextmanager
def _deaf() -> Iterator[None]:
    """Threads and processes begun within never hear of Ctrl-C; this thread does, a little later."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with(parent: int) -> None:
    """Let this worker end as soon as the process is gone that it works for."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
