"""Threads for kernels that release the interpreter lock: each does one slice of the batch.

Python's signals reach the caller's thread alone, between two of its own instructions. So the caller
does a slice itself only where that is calls of kernels, all made within one instruction; else it
waits. A step that Ctrl-C interrupts is one for all teams or for none.
"""

import ctypes
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache, partial
from operator import call
from queue import SimpleQueue
from types import BuiltinFunctionType
from typing import Any

import numpy as np

from ..compilation import compiled, entry_point, is_kernel, kernel

Part = tuple[int, int, int]
"""One thread's part of the work: its first block, the one after its last, and its own index."""
Calls = Sequence[Callable[[], Any]]
"""What there is to call for a part, in order."""

_PATIENCE = 200_000
"""Turns, some 60 µs, for which the caller watches the others before it sleeps: to be woken takes
half as long, and nobody else would use its core."""
_FOR_EVER = 2**62
_POLITENESS = 6_000
"""Turns, some 2 µs, in which a helper that has ended lets go of the interpreter's lock: to find it
taken and be woken takes ten times as long."""


def share(calls_of: Callable[[Part], Calls], blocks: int, most: int, ahead: float = 0.0) -> None:
    """Let up to ``most`` threads, one of them the caller's, do so many blocks: each makes the calls
    for its part, which ``calls_of`` says and does not begin. The caller's part is larger by a share
    that it does while the others wake up.

    Raises:
        BaseException: what a call raised, or what interrupted the caller (Ctrl-C). No thread works
            on any block then, and unless a call has failed all are done or none.
    """
    # a helper that shares waits for the others, and they might for it
    if most == 1 or not compiled() or threading.current_thread() in _workers:
        for one in calls_of((0, blocks, 0)):
            one()
        return
    ends = [round(blocks * (ahead + (1.0 - ahead) * k / most)) for k in range(1, most + 1)]
    parts = zip([0, *ends], ends, range(most), strict=False)
    job = _Job([[*calls_of(part)] for part in parts])
    see_through = job.calls_to_see_it_through()
    _ensure_workers(most - 1)
    try:
        for _ in range(most - 1):
            _jobs.put(job)
        job.take_part()
    except BaseException:
        deque(see_through, 0)  # from what is raised to here, and within, no signal is heard
        raise
    if job.errors:
        raise job.errors[0]


class _Job:
    """One call of ``share``, whose parts are lists of calls; the first is the caller's, if nothing
    can interrupt that.
    """

    def __init__(self, parts: list[list[Callable[[], Any]]]) -> None:
        self._ended = np.zeros(len(parts), np.int64)  # 1 for each part that has
        self._uninterrupted = all(map(_is_uninterrupted, parts[0]))
        self._own, *others = map(iter, parts)  # what has been called is let go
        self._left = deque(enumerate(others, 1))
        self._to_hand_over = iter([(0, self._own)])
        self._over: SimpleQueue[None] = SimpleQueue()
        self.core, self.caller = _own_core(), threading.get_native_id()
        self.errors: list[BaseException] = []

    def help(self) -> None:
        """Do parts that nobody has taken yet."""
        while self._left:
            try:
                number, calls = self._left.popleft()
            except IndexError:  # another thread was faster
                return
            try:
                for one in calls:
                    one()
            except BaseException as error:
                self.errors.append(error)
            self._ended[number] = 1  # the caller sees it, and wants the interpreter's lock at once
            self._over.put(None)

    def take_part(self) -> None:
        """Do the caller's part, or leave it to the others, and wait for them."""
        patience = 0
        if self._uninterrupted:
            deque(map(call, self._own), 0)
            self._ended[0], patience = 1, _PATIENCE
        else:
            _ensure_workers(len(self._ended))
            self.core = _NO_CORE  # it is free while the caller waits
            self._left.extend(self._to_hand_over)
            _jobs.put(self)
        watch, turns = _compiled_watch(), np.zeros(1, np.int64)
        while not watch(self._ended, turns, patience):
            self._over.get()  # a part has ended

    def calls_to_see_it_through(self) -> Iterator[Any]:
        """Hands over what the caller has left, and waits for all: each by a call in which Python
        executes no instruction of its own, when the iterator is asked.
        """
        watch = _compiled_watch()
        hand_over, put = partial(self._left.extend, self._to_hand_over), partial(_jobs.put, self)
        wait = partial(watch, self._ended, np.zeros(1, np.int64), _FOR_EVER)
        return map(call, (hand_over, put, wait))


def _is_uninterrupted(one: Any) -> bool:
    """Whether Python executes no instruction of its own while this is called."""
    return isinstance(one, partial) and (
        isinstance(one.func, BuiltinFunctionType) or is_kernel(one.func)
    )


@kernel
def _watch(ended, turns, most):
    """Wait for all to be 1, for so many turns at most, and then politely; whether they are. Turns
    are counted in an array, which might be the same one, so that the compiler looks each time.
    """
    k = 0
    while k < len(ended) and (ended[k] == 1 or turns[0] < most):
        if ended[k] == 1:
            k += 1
        else:
            turns[0] += 1
    if k == len(ended) and turns[0] > 0:
        enough = turns[0] + _POLITENESS
        while turns[0] < enough:
            turns[0] += ended[0]
    return k == len(ended)


@cache
def _compiled_watch() -> Callable[..., Any]:
    return entry_point(_watch, (np.zeros(1, np.int64), np.zeros(1, np.int64), 0))


_jobs: SimpleQueue[_Job] = SimpleQueue()
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


def _serve(jobs: SimpleQueue[_Job]) -> None:
    left = _NO_CORE
    while True:
        job = jobs.get()
        if (core := job.core) != left:
            _keep_off(core, job.caller)
            left = core
        job.help()


def _keep_off(core: int, caller: int) -> None:
    """Let this thread run wherever its caller may, a thread's native number, but for the caller's
    core. The system would often wake it there, to take turns with the caller while the next core is
    idle, which is slower than one thread.
    """
    with suppress(OSError):  # a sandbox may forbid it
        allowed = os.sched_getaffinity(caller)
        os.sched_setaffinity(0, allowed - {core} or allowed)


def _teller_of_core() -> Callable[[], int]:
    """What tells which core this thread is on; _NO_CORE where threads cannot choose."""
    if not hasattr(os, "sched_setaffinity"):
        return lambda: _NO_CORE
    tell: Callable[[], int] = getattr(ctypes.PyDLL(None), "sched_getcpu", lambda: _NO_CORE)
    return tell


_NO_CORE = -1
_own_core = _teller_of_core()


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
