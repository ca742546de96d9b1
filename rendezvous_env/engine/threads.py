"""Threads for kernels that release the interpreter lock: each runs one slice of the blocks.

Python runs signal handlers in the main thread, between two of its own instructions. The caller
therefore runs a slice only if that is calls of compiled code, made within one instruction.
Otherwise the workers run all slices. So an interrupted job (Ctrl-C) is complete or was never
started.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from itertools import chain
from operator import call
from queue import SimpleQueue
from types import BuiltinFunctionType
from typing import Any

import numpy as np

from ..compilation import compiled, entry_point, is_kernel, kernel

Slice = tuple[int, int, int]
"""Part of a batch: first index, end index, and slice number."""
Calls = Sequence[Callable[[], Any]]
"""Calls that make up the work of a slice, in order."""

_WAIT_SPINS = 200_000
"""Iterations, about 60 µs, for which the caller polls the workers before it sleeps."""
_GIL_YIELD_SPINS = 6_000
"""Iterations, about 2 µs, for which the caller, when finished, leaves the interpreter lock to a
worker that has just finished. A worker that finds the lock taken sleeps, and delays the next
job."""
_FOREVER = 2**62


def share(
    calls_of: Callable[[Slice], Calls], blocks: int, num_threads: int, head_start: float = 0.0
) -> None:
    """Run the calls of all blocks in ``num_threads`` threads, including the caller's.

    Args:
        calls_of: maps a slice of the blocks to its calls, without making them.
        blocks: number of blocks.
        num_threads: number of slices.
        head_start: share of the blocks by which the first slice, the caller's, is larger.

    Raises:
        BaseException: an error of a call, or of a signal handler in the caller. No thread is then
            working on a block. Unless a call failed, either all calls are done or none.
    """
    # a worker that shares its slice would deadlock with the others
    if num_threads == 1 or not compiled() or threading.current_thread() in _workers:
        for one in calls_of((0, blocks, 0)):
            one()
        return
    fractions = [head_start + (1.0 - head_start) * k / num_threads for k in range(num_threads + 1)]
    ends = [0, *(round(blocks * fraction) for fraction in fractions[1:])]
    slices = zip(ends, ends[1:], range(num_threads), strict=False)
    own, *others = (list(calls_of(part)) for part in slices)
    if not all(map(_is_compiled_call, own)):
        own, others = [], [own, *others]
    _run(own, others)


def _run(own: list[Callable[[], Any]], others: list[list[Callable[[], Any]]]) -> None:
    """Make the caller's calls, and those of other slices in workers."""
    ended, wake = np.zeros(len(others), np.int64), SimpleQueue()  # type: ignore[var-annotated]
    errors: list[BaseException] = []
    reports = [(ended[k : k + 1], wake, errors) for k in range(len(others))]
    todo: list[Callable[[], Any]]
    todo = [*(partial(_jobs.put, job) for job in zip(others, reports, strict=True)), *own]
    wait, spins = _compiled_wait(), _WAIT_SPINS if own else 0
    turns = np.zeros(1, np.int64)
    left: Iterator[Any] = map(call, todo)
    finish = partial(wait, ended, np.zeros(1, np.int64), _FOREVER)
    rest = chain(left, map(call, [finish]))
    _ensure_workers(len(others))
    try:
        deque(left, 0)  # one instruction
        while not wait(ended, turns, spins):
            wake.get()
    except BaseException:
        deque(rest, 0)  # no other handler runs up to and within this line
        raise
    if errors:
        raise errors[0]


def _is_compiled_call(one: Any) -> bool:
    """True if Python executes no instruction of its own during a call."""
    return isinstance(one, partial) and (
        isinstance(one.func, BuiltinFunctionType) or is_kernel(one.func)
    )


@kernel
def _wait(ended, turns, most):
    """Poll until all of ``ended`` are 1, at most ``most`` times; returns whether they are.

    Iterations are counted in an array that might alias ``ended``, so that the compiler reads
    ``ended`` from memory each time.
    """
    k = 0
    while k < len(ended) and (ended[k] == 1 or turns[0] < most):
        if ended[k] == 1:
            k += 1
        else:
            turns[0] += 1
    if k == len(ended) and turns[0] > 0:
        enough = turns[0] + _GIL_YIELD_SPINS
        while turns[0] < enough:
            turns[0] += ended[0]
    return k == len(ended)


@cache
def _compiled_wait() -> Callable[..., Any]:
    return entry_point(_wait, (np.zeros(1, np.int64), np.zeros(1, np.int64), 0))


_jobs: SimpleQueue[Any] = SimpleQueue()
"""Pairs of a slice's calls and its report: a flag, a queue that wakes the caller, and errors."""
_workers: list[threading.Thread] = []
_workers_lock = threading.Lock()


def _ensure_workers(wanted: int) -> None:
    if len(_workers) >= wanted:  # as in most steps
        return
    with _workers_lock:
        while len(_workers) < wanted:
            worker = threading.Thread(target=_serve, args=(_jobs,), name="rendezvous", daemon=True)
            worker.start()
            _workers.append(worker)


def _serve(jobs: SimpleQueue[Any]) -> None:
    while True:
        _work(*jobs.get())


def _work(calls: list[Callable[[], Any]], report: Any) -> None:
    ended, wake, errors = report
    try:
        while calls:  # release finished calls
            calls.pop(0)()
    except BaseException as error:
        errors.append(error)
    calls.clear()
    ended[0] = 1  # the caller polls this, and then needs the interpreter lock
    wake.put(None)


def _forget_workers() -> None:
    """Reset the pool in a forked child, which has no threads of its parent."""
    global _jobs, _workers_lock
    _jobs, _workers_lock = SimpleQueue(), threading.Lock()
    _workers.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_workers)


def max_threads(num_threads: int | None) -> int:
    """Given number of threads; None is one per core."""
    return available_cores() if num_threads is None else num_threads


def available_cores() -> int:
    """Number of cores of this process.

    It is limited by its affinity mask, its container's CPU quota, and NUMBA_NUM_THREADS.
    """
    share = os.environ.get("NUMBA_NUM_THREADS", "")
    return min(_cores(), int(share)) if share.isdecimal() and int(share) else _cores()


@cache
def _cores() -> int:
    from joblib import cpu_count  # imported here, since it is slow to import

    return cpu_count()
