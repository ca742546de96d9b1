"""How several threads do the blocks of one kernel call: counters that compiled code works on.

The kernel that everybody runs takes the blocks one after another, so that none waits for a thread
that wakes late. It is compiled code that tells of new work and waits for its end, because a thread
that returned to Python would need the interpreter lock, and be put to sleep for it:

    @kernel
    def step_blocks(share, positions, …):
        return each_block(share, _step_block, (positions, …))
"""

import platform
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from ...compilation import inlined_entry, kernel, unfolded_kernel

_LINE = 8
"""Counters in use stand in cache lines of their own."""
DONE = 0
"""Index of the counter of blocks done."""
_ASLEEP, _NEXT = _LINE, 2 * _LINE

_HINTS: dict[str, tuple[str, tuple[int, ...]]] = {
    "x86_64": ("llvm.x86.sse2.pause", ()),
    "amd64": ("llvm.x86.sse2.pause", ()),
    "aarch64": ("llvm.aarch64.hint", (1,)),
    "arm64": ("llvm.aarch64.hint", (1,)),
}
_HINT = _HINTS.get(platform.machine().lower())
"""The processor's own instruction for ``pause``: LLVM's name of it, and its arguments."""

Part = tuple[int, NDArray[np.int64], NDArray[np.int64], int, int, int]
"""The fields of a Share: plain tuples cross the border to compiled code faster than named ones."""


class Share(NamedTuple):
    """One thread's part in a job."""

    blocks: int
    """How many there are to do."""
    counters: NDArray[np.int64]
    """Zeros at first, see ``new_counters``: blocks done, whether the caller sleeps, blocks taken of
    every thread's range."""
    epoch: NDArray[np.int64]
    """(1,), grows with every job of the pool."""
    joined: int
    """The epoch of this job, for a helper; −1 for the caller, who begins it."""
    thread: int
    """Which of the threads this is; the caller is 0."""
    spin_limit: int
    """How often a thread looks whether there is news before it sleeps; 0 with no others."""


def new_counters(threads: int) -> NDArray[np.int64]:
    """Counters of one job of so many threads."""
    return np.zeros(_LINE * (2 + threads), dtype=np.int64)


def example_part() -> Part:
    """A part in a job without blocks: what a kernel is compiled for."""
    return 0, new_counters(1), np.zeros(1, np.int64), -1, 0, 0


@unfolded_kernel
def each_block(share, work, arguments):
    """Do the blocks that this thread takes: ``work(block, arguments)`` for each.

    Args:
        share: the fields of a Share.
        work: an unfolded kernel.
        arguments: a tuple.

    Returns:
        Whether all blocks are done; if not, helpers report their ends in Python, too.
    """
    share, done = Share(*share), 0
    _begin(share)
    block = _take(share)
    while block < share.blocks:
        work(block, arguments)
        done += 1
        block = _take(share)
    return _end(share, done)


@inlined_entry
def _begin(share):
    """The caller tells waiting helpers that there is work."""
    if share.joined < 0 and share.spin_limit > 0:
        fetch_add(share.epoch, 0, 1)


@inlined_entry
def _take(share):
    """Index of the next block that nobody has taken; ``share.blocks`` or more if none is left.

    Every thread begins with a range of its own, the same in every call, whose teams it may still
    have in its cache; then it takes what is left of the others'.
    """
    threads = share.counters.shape[0] // _LINE - 2
    for k in range(threads):
        thread = (share.thread + k) % threads
        first = share.blocks * thread // threads
        last = share.blocks * (thread + 1) // threads
        if first + fetch(share.counters, _NEXT + _LINE * thread) < last:
            block = first + fetch_add(share.counters, _NEXT + _LINE * thread, 1)
            if block < last:
                return block
    return share.blocks


@inlined_entry
def _end(share, done):
    """Report blocks done, and wait: the caller for the others, a helper for the next job; whether
    all are done.
    """
    total = fetch_add(share.counters, DONE, done) + done
    if share.joined < 0:
        looks = 0
        while total < share.blocks and looks < share.spin_limit:
            pause()
            total = fetch(share.counters, DONE)
            looks += 1
        if total < share.blocks:
            fetch_add(share.counters, _ASLEEP, 1)
    elif done > 0:  # else it woke too late to be of use, and would be again
        looks = 0
        while (
            looks < share.spin_limit
            and fetch(share.epoch, 0) == share.joined
            and fetch(share.counters, _ASLEEP) == 0
        ):
            pause()
            looks += 1
    return total >= share.blocks


@kernel
def look_in_vain(counters, looks):
    """Look so often whether there is news, as ``_end`` does; to measure how long that takes."""
    k = 0
    while k < looks and fetch(counters, 0) == 0:
        pause()
        k += 1
    return k


def fetch(array, k):
    """Entry k, read from memory at this moment."""
    return array[k]


def fetch_add(array, k, value):
    """Add to entry k in one indivisible step; what it was before."""
    before = array[k]
    array[k] += value
    return before


def pause():
    """Tell the processor that this thread waits, which leaves more to the other one of its core."""


def _load(_, array, k):
    def generate(context, builder, signature, arguments):
        return builder.load_atomic(_place(context, builder, signature, arguments), "acquire", 8)

    return types.int64(array, types.int64), generate


def _add(_, array, k, value):
    def generate(context, builder, signature, arguments):
        place = _place(context, builder, signature, arguments)
        return builder.atomic_rmw("add", place, arguments[2], "acq_rel")

    return types.int64(array, types.int64, types.int64), generate


def _pause(_):
    def generate(context, builder, signature, arguments):
        if _HINT is not None:
            name, numbers = _HINT
            kinds = [ir.IntType(32)] * len(numbers)
            hint = ir.FunctionType(ir.VoidType(), kinds)
            function = builder.module.declare_intrinsic(name, (), hint)
            builder.call(function, [kind(x) for kind, x in zip(kinds, numbers, strict=True)])
        return context.get_dummy_value()

    return types.void(), generate


def _place(context, builder, signature, arguments):
    """Pointer to the entry of an array of int64 that the first two arguments name."""
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.gep(array.data, [arguments[1]])


_load_entry: Any = intrinsic(_load)
_add_to_entry: Any = intrinsic(_add)
_rest: Any = intrinsic(_pause)


@overload(fetch)
def _compiled_fetch(array, k):
    return lambda array, k: _load_entry(array, k)


@overload(fetch_add)
def _compiled_fetch_add(array, k, value):
    return lambda array, k, value: _add_to_entry(array, k, value)


@overload(pause)
def _compiled_pause():
    return lambda: _rest()
