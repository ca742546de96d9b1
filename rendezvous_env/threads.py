"""A small thread pool for kernels that release the interpreter lock.

The caller works too and takes slices like everybody else, so a worker that wakes late, because
another process keeps its core busy, never holds up the rest. A sleeping thread takes tens of
microseconds to wake, so the caller looks for the last ends for a moment before it sleeps.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator
from queue import Empty, SimpleQueue

_PATIENCE = 2e-4
"""s that a caller looks for the ends of slices before it goes to sleep."""


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

    def wait(self) -> list[BaseException | None]:
        """Ends of all slices."""
        give_up = time.perf_counter() + _PATIENCE
        ends: list[BaseException | None] = []
        while len(ends) < self.count:
            try:
                ends.append(self.ends.get_nowait())
            except Empty:
                if time.perf_counter() > give_up:
                    ends.append(self.ends.get())
                else:
                    time.sleep(0)  # lets a worker report
        return ends


_jobs: SimpleQueue[_Job] = SimpleQueue()
_workers: list[threading.Thread] = []
_workers_lock = threading.Lock()


def available_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run(task: Callable[[int], None], count: int, width: int | None = None) -> None:
    """Call ``task(0)`` … ``task(count - 1)`` on several threads, the caller's among them.

    Args:
        task: what to do with a slice.
        count: of slices, handed out in order to whoever is free.
        width: of threads at most; None is one for each slice.

    Raises:
        BaseException: what a task raised, after all slices have ended.
    """
    helpers = min(count, width or count) - 1
    if helpers == 0:
        for number in range(count):
            task(number)
        return
    _ensure_workers(helpers)
    job = _Job(task, count)
    for _ in range(helpers):
        _jobs.put(job)
    job.work()
    for end in job.wait():
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
