"""A small thread pool for kernels that release the interpreter lock.

The caller works too and takes blocks like everybody else, so a worker that wakes late, because
another process keeps its core busy, never holds up the rest. A sleeping thread takes tens of
microseconds to wake, so the caller looks for the last ends for a moment before it sleeps.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from queue import SimpleQueue

import numpy as np
from numpy.typing import NDArray

from ..compilation import compiled
from .sharing import DONE, Part, new_counters

_LOOKS = 250_000
"""How often compiled code looks for news before its thread goes to sleep; about 0.1 ms."""


class _Job:
    """One call of ``share``, as the helpers see it."""

    def __init__(self, run_kernel: Callable[[Part], bool]) -> None:
        self.run_kernel: Callable[[Part], bool] | None = run_kernel
        self.ends: SimpleQueue[BaseException | None] = SimpleQueue()

    def help_with(self, part: Part) -> None:
        """Take a part in it, if that is still wanted."""
        end: BaseException | None = None
        if (run_kernel := self.run_kernel) is not None:
            try:
                run_kernel(part)
            except BaseException as error:
                end = error
        self.ends.put(end)


_jobs: SimpleQueue[tuple[_Job, Part]] = SimpleQueue()
_workers: list[threading.Thread] = []
_workers_lock = threading.Lock()
_bell: NDArray[np.int64] = np.zeros(1, dtype=np.int64)


def available_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share(run_kernel: Callable[[Part], bool], blocks: int, most: int) -> None:
    """Let a kernel do many blocks, which up to ``most`` threads take one after another.

    Between two calls that follow close on each other the threads stay awake, for at most 0.1 ms.

    Args:
        run_kernel: calls a kernel with the part that it is given, and returns what it does; the
            kernel takes its blocks as sharing.py says.
        blocks: how many.
        most: threads, the caller's among them.

    Raises:
        BaseException: what the kernel raised.
    """
    counters = new_counters(most)
    if most == 1 or not compiled():
        run_kernel((blocks, counters, _bell, -1, 0, 0))
        return
    _ensure_workers(most - 1)
    job, heard = _Job(run_kernel), int(_bell[0]) + 1
    for thread in range(1, most):
        _jobs.put((job, (blocks, counters, _bell, heard, thread, _LOOKS)))
    try:
        all_done = run_kernel((blocks, counters, _bell, -1, 0, _LOOKS))
        while not all_done:
            if (end := job.ends.get()) is not None:
                raise end
            all_done = int(counters[DONE]) >= blocks
    finally:
        job.run_kernel = None  # a helper that wakes only now must not keep its arrays alive


def _ensure_workers(count: int) -> None:
    if len(_workers) >= count:
        return
    with _workers_lock:
        while len(_workers) < count:
            worker = threading.Thread(target=_serve, args=(_jobs,), name="rendezvous", daemon=True)
            worker.start()
            _workers.append(worker)


def _serve(jobs: SimpleQueue[tuple[_Job, Part]]) -> None:
    while True:
        job, part = jobs.get()
        job.help_with(part)


def _forget_workers() -> None:
    """A forked child has none of its parent's threads."""
    global _jobs, _workers_lock
    _jobs, _workers_lock = SimpleQueue(), threading.Lock()
    _workers.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_workers)
