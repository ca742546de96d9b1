"""A small thread pool for kernels that release the interpreter lock.

The caller works too and takes blocks like everybody else, so a worker that wakes late, because
another process keeps its core busy, never holds up the rest. A sleeping thread takes tens of
microseconds to wake, so the caller looks for the last ends for a moment before it sleeps.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from functools import lru_cache
from queue import SimpleQueue

import numpy as np
from numpy.typing import NDArray

from ...compilation import compiled
from .cores import available_cores
from .sharing import DONE, Part, look_in_vain, new_counters

__all__ = ["available_cores", "most_threads", "part_of_all", "share"]

_AWAKE = 1.5e-4
"""How long compiled code looks for news before its thread goes to sleep, s."""


class _Job:
    """One call of ``share``, as the helpers see it."""

    def __init__(self, run_kernel: Callable[[Part], bool]) -> None:
        self.run_kernel: Callable[[Part], bool] | None = run_kernel
        self.ends: SimpleQueue[BaseException | None] = SimpleQueue()
        self._begun: list[None] = []
        self._over: list[None] = []

    def help_with(self, part: Part) -> None:
        """Take a part in it, if that is still wanted."""
        end: BaseException | None = None
        self._begun.append(None)  # before it asks, so that ``at_rest`` misses nobody
        if (run_kernel := self.run_kernel) is not None:
            try:
                run_kernel(part)
            except BaseException as error:
                end = error
        self._over.append(None)
        self.ends.put(end)

    def at_rest(self) -> bool:
        """Whether every helper that has begun has come to its end."""
        over = len(self._over)  # first, since it is the one that catches up
        return over == len(self._begun)


_jobs: SimpleQueue[tuple[_Job, Part]] = SimpleQueue()
_workers: list[threading.Thread] = []
_workers_lock = threading.Lock()
_epoch: NDArray[np.int64] = np.zeros(1, dtype=np.int64)


def most_threads(asked: int | None) -> int:
    """As many threads as were asked for, or one for each core."""
    return available_cores() if asked is None else asked


def part_of_all(blocks: int) -> Part:
    """The part of a thread that does all blocks alone."""
    return blocks, new_counters(1), _epoch, -1, 0, 0


def share(run_kernel: Callable[[Part], bool], blocks: int, most: int) -> None:
    """Let a kernel do many blocks, which up to ``most`` threads take one after another.

    Between two calls that follow close on each other the threads stay awake, for at most 0.15 ms.

    Args:
        run_kernel: calls a kernel with the part that it is given, and returns what it does; the
            kernel takes its blocks as sharing.py says.
        blocks: how many.
        most: threads, the caller's among them.

    Raises:
        BaseException: what the kernel raised, or what interrupted it (Ctrl-C). All blocks are done
            then, unless it was a kernel that failed, and no thread works on any.
    """
    if most == 1 or not compiled():
        run_kernel(part_of_all(blocks))
        return
    counters = new_counters(most)
    _ensure_workers(most - 1)
    job, joined, spins = _Job(run_kernel), int(_epoch[0]) + 1, _spin_limit()
    part = (blocks, counters, _epoch, -1, 0, spins)
    try:
        for thread in range(1, most):
            _jobs.put((job, (blocks, counters, _epoch, joined, thread, spins)))
        all_done = run_kernel(part)
        while not all_done:
            if (end := job.ends.get()) is not None:
                raise end
            all_done = int(counters[DONE]) >= blocks
    except BaseException:
        _settle(job, part)
        raise
    finally:
        job.run_kernel = None  # a helper that wakes only now must not keep its arrays alive


def _settle(job: _Job, part: Part) -> None:
    """Come to the end of a job that was interrupted, or in which a kernel has failed.

    To run the kernel once more does the blocks that nobody has taken yet, and waits for the others.
    """
    run_kernel = job.run_kernel
    settled = False
    while run_kernel is not None and not settled:
        try:
            alone = job.at_rest()  # then nobody else will do a block
            settled = run_kernel(part) or alone
        except KeyboardInterrupt:  # the first one leaves soon
            continue
        except BaseException:
            break
    job.run_kernel = None
    while not job.at_rest():
        time.sleep(_AWAKE)


@lru_cache
def _spin_limit() -> int:
    """How often a waiting thread looks for news in the time that it stays awake."""
    tries, counters = 1000, new_counters(1)
    look_in_vain(counters, 1)  # compiled by now
    took = []
    for _ in range(5):
        start = time.perf_counter()
        look_in_vain(counters, tries)
        took.append(time.perf_counter() - start)
    return int(tries * _AWAKE / min(took)) + 1


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
