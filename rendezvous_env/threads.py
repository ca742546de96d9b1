"""A small thread pool for kernels that release the interpreter lock.

The caller works too and takes slices like everybody else, so a worker that wakes late, because
another process keeps its core busy, never holds up the rest.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator
from queue import SimpleQueue


class _Job:
    """One call of ``run``: slices are handed out by a counter, ends are reported through a
    queue.
    """

    def __init__(self, task: Callable[[int], None], count: int) -> None:
        self.task = task
        self.count = count
        self.numbers: Iterator[int] = itertools.count()
        self.ends: SimpleQueue[BaseException | None] = SimpleQueue()

    def work(self) -> int:
        """Do slices until none is left; how many this thread did."""
        done = 0
        while (number := next(self.numbers)) < self.count:
            end: BaseException | None = None
            try:
                self.task(number)
            except BaseException as error:
                end = error
            self.ends.put(end)
            done += 1
        return done


_jobs: SimpleQueue[_Job] = SimpleQueue()
_workers: list[threading.Thread] = []
_workers_lock = threading.Lock()


def available_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run(task: Callable[[int], None], count: int) -> None:
    """Call ``task(0)`` … ``task(count - 1)`` on as many threads, the caller's among them.

    Raises:
        BaseException: what a task raised, after all slices have ended.
    """
    if count == 1:
        task(0)
        return
    _ensure_workers(count - 1)
    job = _Job(task, count)
    for _ in range(count - 1):
        _jobs.put(job)
    job.work()
    ends = [job.ends.get() for _ in range(count)]
    for end in ends:
        if end is not None:
            raise end


def _ensure_workers(count: int) -> None:
    if len(_workers) >= count:
        return
    with _workers_lock:
        while len(_workers) < count:
            worker = threading.Thread(target=_serve, args=(_jobs,), name="rendezvous", daemon=True)
            worker.start()
            _workers.append(worker)


def _serve(jobs: SimpleQueue[_Job]) -> None:
    while True:
        jobs.get().work()


def _forget_workers() -> None:
    """A forked child has none of its parent's threads."""
    global _jobs, _workers_lock
    _jobs, _workers_lock = SimpleQueue(), threading.Lock()
    _workers.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_workers)
