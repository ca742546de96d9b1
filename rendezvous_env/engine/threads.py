"""Threads for kernels that release the interpreter lock: each does one slice of the batch.

Python's signals reach the caller's thread alone, between two of its own instructions. So the caller
does a slice itself only where that is calls of kernels, all made within one instruction; else it
waits. A step that Ctrl-C interrupts is one for all teams or for none.
"""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import count
from operator import call
from queue import SimpleQueue
from types import BuiltinFunctionType
from typing import Any

import numpy as np

from ..compilation import compiled, is_kernel, kernel

Part = tuple[int, int, int]
"""One thread's part of the work: its first block, the one after its last, and its own index."""
Calls = Sequence[Callable[[], Any]]
"""What there is to call for a part, in order."""

_PATIENCE = 200_000
"""Turns, some 60 µs, for which the caller watches the others before it sleeps: to be woken takes
half as long, and nobody else would use its core."""
_MOST_SIGNALS = 20  # that raise something else than KeyboardInterrupt, while a job is seen through


def share(calls_of: Callable[[Part], Calls], blocks: int, most: int, ahead: float = 0.0) -> None:
    """Let up to ``most`` threads, one of them the caller's, do so many blocks: each makes the calls
    for its part, which ``calls_of`` says and does not begin. The caller's part is larger by a share
    that it does while the others wake up.

    Raises:
        BaseException: what a call raised, or what interrupted the caller (Ctrl-C). No thread works
            on any block then, and unless a call has failed all are done or none. Of several signals
            that raise shortly after one another a later one may leave before the others have ended.
    """
    if most == 1 or not compiled():
        for one in calls_of((0, blocks, 0)):
            one()
        return
    ends = [round(blocks * (ahead + (1.0 - ahead) * k / most)) for k in range(1, most + 1)]
    cuts = [0, *ends]
    job = _Job(calls_of, list(zip(cuts, cuts[1:], range(most), strict=False)))
    _ensure_workers(most)
    try:
        for _ in range(most - 1):
            _jobs.put(job)
        job.take_part()
    except BaseException:
        job.settle()
        raise
    finally:
        job.let_go()
    if job.errors:
        raise job.errors[0]


class _Job:
    """One call of ``share``; its first part is the caller's, if nothing can interrupt that."""

    def __init__(self, calls_of: Callable[[Part], Calls], parts: list[Part]) -> None:
        self._calls_of: Callable[[Part], Calls] | None = calls_of
        self._first, self._left = parts[0], deque(parts[1:])
        self._to_hand_over = iter(parts[:1])
        self._count = len(parts)
        self._ended: list[None] = []
        self._own: list[Callable[[], Any]] = []
        self._made: list[Any] = []  # what the caller's own calls have returned
        self._beginning = threading.Lock()
        self._begun = self._called_off = False
        self._over = np.zeros(1, np.int64)
        self._done: SimpleQueue[None] = SimpleQueue()
        self.errors: list[BaseException] = []

    def help(self) -> None:
        """Do parts that nobody has taken yet, unless the job was called off before it began."""
        with self._beginning:
            self._begun = not self._called_off or self._begun
        while self._begun and self._left:
            try:
                part = self._left.popleft()
            except IndexError:  # another thread was faster
                return
            try:
                assert self._calls_of is not None
                for one in self._calls_of(part):
                    one()
            except BaseException as error:
                self.errors.append(error)
            self._ended.append(None)
            if self._all_ended:
                self._over[0] = 1
                self._done.put(None)

    def take_part(self) -> None:
        """Do the caller's part, or leave it to the others, and wait for them."""
        assert self._calls_of is not None
        own: list[Callable[[], Any]] = [*self._calls_of(self._first)]
        own.append(partial(self._ended.append, None))
        if all(map(_is_uninterrupted, own)):
            self._own = own
        self._see_to_own_part()
        if not self._all_ended:
            if self._own:
                _watch(self._over, np.zeros(1, np.int64), _PATIENCE)
            self._done.get()

    def _see_to_own_part(self) -> None:
        """Each line does all that it can or nothing, and once only, however often it is tried."""
        if self._own:
            self._made.extend(map(call, self._own[len(self._made) :]))
        else:
            self._left.extend(self._to_hand_over)
            _jobs.put(self)

    @property
    def _all_ended(self) -> bool:
        return len(self._ended) == self._count

    def settle(self) -> None:
        """Call the job off, or see it through if it has begun; interrupts are put off."""
        for tries in count():
            try:
                self._called_off = not self._made
                while self._beginning.locked():  # from here on nobody begins it
                    time.sleep(0)
                if self._begun or self._made:
                    self._see_to_own_part()
                    while not self._all_ended:
                        time.sleep(1e-4)
                return
            except KeyboardInterrupt:  # the first one leaves soon
                continue
            except Exception:  # a signal's; or one of the caller's own calls fails, ever again
                if tries > _MOST_SIGNALS and len(self._made) < len(self._own):
                    self._own, self._made = [partial(self._ended.append, None)], []

    def let_go(self) -> None:
        """Keep no arrays alive, though a thread that wakes late still has the job."""
        self._calls_of, self._own = None, []


def _is_uninterrupted(one: Any) -> bool:
    """Whether Python executes no instruction of its own while this is called."""
    return isinstance(one, partial) and (
        isinstance(one.func, BuiltinFunctionType) or is_kernel(one.func)
    )


@kernel
def _watch(over, turns, most):
    """Wait until it is over, for so many turns at most; they are counted in an array, which might
    be the same one, so that the compiler looks each time.
    """
    while over[0] == 0 and turns[0] < most:
        turns[0] += 1


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
