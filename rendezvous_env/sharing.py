"""How several threads do the blocks of one kernel call: counters that compiled code works on.

The kernel that everybody runs takes the blocks one after another, so that none waits for a thread
that wakes late. It is compiled code that tells of new work and waits for its end, because a thread
that returned to Python would need the interpreter lock, and be put to sleep for it:

    share, done = begin(share), 0
    block = take(share)
    while block < share.blocks:
        ...
        done += 1
        block = take(share)
    return end(share, done)
"""

from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from .jit import inlined_kernel

COUNTERS = 24
"""Length of ``Share.counters``; those in use stand in cache lines of their own."""

DONE = 8
"""Index of the counter of blocks done."""
_NEXT, _ASLEEP = 0, 16


Part = tuple[int, NDArray[np.int64], NDArray[np.int64], int, int]
"""The fields of a Share: plain tuples cross the border to compiled code faster than named ones."""


class Share(NamedTuple):
    """One thread's part in a job."""

    blocks: int
    """How many there are to do."""
    counters: NDArray[np.int64]
    """(COUNTERS,), zeros at first: the next block, blocks done, whether the caller sleeps."""
    bell: NDArray[np.int64]
    """(1,), grows with every job of the pool."""
    heard: int
    """What the bell is at in this job, for a helper; −1 for the caller, who rings it."""
    patience: int
    """How often a thread looks whether there is news before it sleeps; 0 with no others."""


@inlined_kernel
def begin(share):
    """The share as named fields; the caller tells waiting helpers that there is work."""
    share = Share(*share)
    if share.heard < 0 and share.patience > 0:
        fetch_add(share.bell, 0, 1)
    return share


@inlined_kernel
def take(share):
    """Index of the next block that nobody has taken; ``share.blocks`` or more if none is left."""
    return fetch_add(share.counters, _NEXT, 1)


@inlined_kernel
def end(share, done):
    """Report blocks done, and wait: the caller for the others, a helper for the next job.

    Returns:
        Whether all blocks are done; if not, helpers report their ends in Python, too.
    """
    total = fetch_add(share.counters, DONE, done) + done
    if share.heard < 0:
        looks = 0
        while total < share.blocks and looks < share.patience:
            total = fetch(share.counters, DONE)
            looks += 1
        if total < share.blocks:
            fetch_add(share.counters, _ASLEEP, 1)
    elif done > 0:  # else it woke too late to be of use, and would be again
        looks = 0
        while (
            looks < share.patience
            and fetch(share.bell, 0) == share.heard
            and fetch(share.counters, _ASLEEP) == 0
        ):
            looks += 1
    return total >= share.blocks


def fetch(array, k):
    """Entry k, read from memory at this moment."""
    return array[k]


def fetch_add(array, k, value):
    """Add to entry k in one indivisible step; what it was before."""
    before = array[k]
    array[k] += value
    return before


def _load(_, array, k):
    def generate(context, builder, signature, arguments):
        return builder.load_atomic(_place(context, builder, signature, arguments), "acquire", 8)

    return types.int64(array, types.int64), generate


def _add(_, array, k, value):
    def generate(context, builder, signature, arguments):
        place = _place(context, builder, signature, arguments)
        return builder.atomic_rmw("add", place, arguments[2], "acq_rel")

    return types.int64(array, types.int64, types.int64), generate


def _place(context, builder, signature, arguments):
    """Pointer to the entry of an array of int64 that the first two arguments name."""
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.gep(array.data, [arguments[1]])


_load_entry: Any = intrinsic(_load)
_add_to_entry: Any = intrinsic(_add)


@overload(fetch)
def _compiled_fetch(array, k):
    return lambda array, k: _load_entry(array, k)


@overload(fetch_add)
def _compiled_fetch_add(array, k, value):
    return lambda array, k, value: _add_to_entry(array, k, value)
