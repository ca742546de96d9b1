"""Threads for kernels that release the interpreter lock: each does one slice of the batch.

Python's signals reach the caller's thread alone. So it is other threads that do the slices, while
the caller waits: what Ctrl-C interrupts is that wait, and a step is one for all teams or for none.
"""

import os
import threading
import time
from collections.abc import Callable
from functools import cache
from itertools import count
from queue import SimpleQueue
from typing import Any

from ..compilation import compiled

Part = tuple[int, int, int]
"""One thread's part of the work: its first block, the one after its last, and its own index."""


def share(run_kernel: Callable[[Part], Any], blocks: int, most: int) -> None:
    """Let a kernel, called with each thread's part, do so many blocks on up to ``most`` threads;
    one is the caller's own.

    Raises:
        BaseException: what the kernel raised, or what interrupted the caller (Ctrl-C). No thread
            works on any block then, and unless a kernel has failed all are done or none.
    """
    if most == 1 or not compiled():
        run_kernel((0, blocks, 0))
        return
    cuts = [blocks * k // most for k in range(most + 1)]
    job = _Job(run_kernel, list(zip(cuts, cuts[1:], range(most), strict=False)))
    _ensure_workers(most)
    try:
        for _ in range(most):
            _jobs.put(job)
        job.all_done.acquire()
    except BaseException:
        job.settle()
        raise
    if job.errors:
        raise job.errors[0]


class _Job:
    """One call of ``share``."""

    def __init__(self, run_kernel: Callable[[Part], Any], parts: list[Part]) -> None:
        self._run_kernel: Callable[[Part], Any] | None = run_kernel
        self._parts = parts
        self._next, self._ended = count(), count(1)  # to take the next number is indivisible
        self._beginning = threading.Lock()
        self._begun = self._called_off = self._over = False
        self.all_done = threading.Lock()
        self.all_done.acquire()
        self.errors: list[BaseException] = []

    def help(self) -> None:
        """Do parts that nobody has taken yet, unless the job was called off before it began."""
        with self._beginning:
            self._begun = not self._called_off or self._begun
        while self._begun and (k := next(self._next)) < len(self._parts):
            try:
                assert self._run_kernel is not None
                self._run_kernel(self._parts[k])
            except BaseException as error:
                self.errors.append(error)
            if next(self._ended) == len(self._parts):
                self._run_kernel = None  # a thread that wakes late keeps no arrays alive
                self._over = True
                self.all_done.release()

    def settle(self) -> None:
        """Call the job off, or wait for its end if it has begun; interrupts are put off."""
        while True:
            try:
                self._called_off = True
                while self._beginning.locked():  # from here on nobody begins it
                    time.sleep(0)
                while self._begun and not self._over:
                    time.sleep(1e-4)
                return
            except KeyboardInterrupt:  # the first one leaves soon
                continue


_jobs: SimpleQueue[_Job] = SimpleQueue()
_workers: list[threading.Thread] = []
_workers_lock = threading.Lock()


def _ensure_workers(wanted: int) -> None:
    with _workers_lock:
        while len(_workers) < wanted:
            worker = threading.Thread(target=_serve, args=(_jobs,), name="rendezvous", daemon=True)
            worker.start()
            _workers.append(worker)


def _serve(jobs: SimpleQueue[_Job]) -> None:
    while True:
        jobs.get().help()


def _forget_workers() -> None:
    """A forked child has none of its parent's threads."""
    global _jobs, _workers_lock
    _jobs, _workers_lock = SimpleQueue(), threading.Lock()
    _workers.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_workers)


def most_threads(asked: int | None) -> int:
    """As many threads as were asked for, or one for each core."""
    return available_cores() if asked is None else asked


def available_cores() -> int:
    """Cores that this process may run on, within its container's quota of processor time and within
    NUMBA_NUM_THREADS, the share of a process that is one of many.
    """
    share = os.environ.get("NUMBA_NUM_THREADS", "")
    return min(_cores(), int(share)) if share.isdecimal() and int(share) else _cores()


@cache
def _cores() -> int:
    from joblib import cpu_count  # imported when it is asked for: it takes a while

    return cpu_count()
