"""SIMD over robots for the kernels of safety filters.

A kernel processes LANES robots at a time: it sums rows and copies memory into lanes, computes in
one branch-free loop, and copies results out. All lanes are computed, also unused ones, so the
result for a robot does not depend on the number of robots.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import compiled, inner_kernel
from ..engine.memory import read, read_row, write
from ..engine.threads import Slice
from ..physics.neighbour_rows import net_bearing_of
from ..physics.vectors import combine, exactly, load_pair, norm

LANES = 32 if compiled() else 1  # robots processed at a time
_ROWS = 31
_1, _2, _3, _BESIDE = (np.uint64(number) for number in (1, 2, 3, LANES))
"""Unsigned, so that the compiler has no negative index to handle."""
Numbers = NDArray[np.float64]


class Lanes(NamedTuple):
    """Robots in lanes: vectors (3, LANES), z = 0 in the plane, and numbers (LANES,)."""

    f: Numbers  # net bearings, m/s
    choice: Numbers  # that is held
    heading: Numbers
    sent: Numbers  # velocities of actions, m/s
    towards: Numbers  # f/‖f‖; of the heading filter the x axis where f is zero
    wanted: Numbers  # desired velocities, m/s
    strength: Numbers  # ‖f‖, m/s
    scale: Numbers  # s of velocities, without unit
    margin: Numbers  # ε_i of the cap around f
    rest: Numbers  # √(1 − ε_i²)
    desired: Numbers  # length of the choice
    carried: Numbers  # length of the heading before the step, 1 or 0
    owed: Numbers  # guaranteed decrease of V, m²/s
    degree: Numbers  # D, m/s
    level: Numbers  # A, m²/s
    deposit: Numbers  # G, m²/s
    accepted: Numbers  # whether the choice is executed, 1 or 0
    alignment: Numbers
    lyapunov_rate: Numbers


def room_for(rows: int, dim: int) -> tuple[Numbers, NDArray[np.float32]]:
    """Memory of a kernel: (31, LANES) for ``lanes_of``, (rows, LANES·d) for ``weigh_rows``."""
    return np.zeros((_ROWS, LANES)), np.zeros((rows, LANES * dim), np.float32)


def by_robot(part: Slice, arrays: Sequence[NDArray[Any]]) -> tuple[tuple[int, int], Any]:
    """Range of robots of a slice, b·n + i for robot i of environment b, and flat views of arrays.

    Arrays (B, n, ...), any unit, become (B·n, ...) without a copy.
    """
    n = arrays[0].shape[1]
    return (part[0] * n, part[1] * n), tuple([a.reshape(-1, *a.shape[2:]) for a in arrays])


@inner_kernel
def end_of_run(turning, first, stop):
    """End of the robots from ``first`` on, before ``stop``, that all turn or do not; (N,) bool."""
    for i in range(first + 1, stop):
        if turning[i] != turning[first]:
            return i
    return stop


@inner_kernel(inline="text")
def lanes_of(work):
    """Lanes with the given rows, (31, LANES), in any unit: vectors are v = rows 3k to 3k + 2."""
    vectors = work[0:3], work[3:6], work[6:9], work[9:12], work[12:15], work[15:18]
    numbers = work[18], work[19], work[20], work[21], work[22], work[23], work[24], work[25]
    rest = work[26], work[27], work[28], work[29], work[30]
    return Lanes(*vectors, *numbers, *rest)


# Slices first: for ``values[first + lane]`` the compiler would not know that the index is not
# negative, and the loop would not become SIMD.


@inner_kernel(inline="code")
def take_in(axes, values, first, stop, lanes):
    """Copy vectors (N, d), any unit, of robots first ≤ i < stop into lanes (3, LANES)."""
    taken = values[first:stop]
    if taken.shape[1] == len(axes):  # always true; the compiler then copies all at once
        for lane in range(len(taken)):
            for k in range(len(axes)):
                lanes[k, lane] = taken[lane, k]


@inner_kernel(inline="code")
def give_out(axes, lanes, first, stop, values):
    """Copy vectors, any unit, from lanes (3, LANES) to robots first ≤ i < stop, (N, d)."""
    given = values[first:stop]
    if given.shape[1] == len(axes):
        for lane in range(len(given)):
            for k in range(len(axes)):
                given[lane, k] = lanes[k, lane]


@inner_kernel(inline="code")
def tell(lanes, first, stop, values):
    """Copy numbers, any unit, from lanes (LANES,) to robots first ≤ i < stop, (N,).

    For a bool target, whether they are nonzero.
    """
    told = values[first:stop]
    for lane in range(len(told)):
        told[lane] = lanes[lane]


@inner_kernel(slp=True)
def sum_rows(axes, observations, neighbour_slots, f):
    """f_i = Σ_j a_ij g_ij of robots, from rows (N, rows, d), m/s, N ≤ LANES, into f (3, LANES)."""
    for lane in range(len(observations)):
        rows = observations[lane]
        if len(axes) == 2:
            x, y = 0.0, 0.0
            for k in range(neighbour_slots):
                row = load_pair(rows[k])
                x, y = x + row[0], y + row[1]
            f[0, lane], f[1, lane] = x, y
        else:
            write(net_bearing_of(rows, neighbour_slots), f, lane)


@inner_kernel
def weigh_rows(axes, observations, neighbour_slots, room, f, degree):
    """As ``sum_rows``, and D_i = Σ_j a_ij into degree (LANES,), by way of rows side by side."""
    rows, d = room[:neighbour_slots], len(axes)
    if d == 2:
        pairs, beside = observations.view(np.float64), room.view(np.float64)
        _copy_pairs(pairs.reshape(-1), observations.shape[1], len(rows), beside.reshape(-1))
    else:
        for lane in range(len(observations)):
            for k in range(len(rows)):
                for part in range(d):
                    rows[k, lane * d + part] = observations[lane, k, part]
    f[:] = 0.0
    degree[:] = 0.0
    for k in range(len(rows)):
        for lane in range(LANES):
            row = exactly(read_row(rows[k], lane, axes))
            write(combine(1.0, read(f, lane, axes), 1.0, row), f, lane)
            degree[lane] += norm(row)


@inner_kernel(inline="code")
def keep_sums(lanes, first, stop, sums):
    """Copy f, m/s, of robots in the plane from lanes to ``sums``, (2, N), and D to a third row."""
    tell(lanes.f[0], first, stop, sums[0])
    tell(lanes.f[1], first, stop, sums[1])
    if len(sums) == 3:
        tell(lanes.degree, first, stop, sums[2])


@inner_kernel(inline="code")
def recall_sums(sums, first, stop, lanes):
    """Inverse of ``keep_sums``."""
    x, y = sums[0][first:stop], sums[1][first:stop]
    for lane in range(len(x)):
        lanes.f[0, lane], lanes.f[1, lane] = x[lane], y[lane]
    if len(sums) == 3:
        degree = sums[2][first:stop]
        for lane in range(len(degree)):
            lanes.degree[lane] = degree[lane]


@inner_kernel
def _copy_pairs(pairs, stride, count, beside):
    """Copy the first ``count`` of ``stride`` rows of robots, flat, to row k of lane l, k LANES + l.

    Both numbers of a row at once, and four rows, of which the last may repeat some.
    """
    for lane in range(len(pairs) // stride):
        if count < 4:
            for k in range(count):
                beside[np.uint64(k * LANES + lane)] = pairs[np.uint64(lane * stride + k)]
            continue
        for k in range(0, count, 4):
            row = min(k, count - 4)
            i, to = np.uint64(lane * stride + row), np.uint64(row * LANES + lane)
            one, two, three, four = pairs[i], pairs[i + _1], pairs[i + _2], pairs[i + _3]
            beside[to], beside[to + _BESIDE] = one, two
            beside[to + _2 * _BESIDE], beside[to + _3 * _BESIDE] = three, four


@inner_kernel(inline="code")
def report(axes, lanes, first, stop, actions, alignment, lyapunov_rate):
    """Write velocities (N, d), m/s, and |hᵀf|/‖f‖ and −2 (hᵀf)², (N,), of first ≤ i < stop."""
    give_out(axes, lanes.sent, first, stop, actions)
    tell(lanes.alignment, first, stop, alignment)
    tell(lanes.lyapunov_rate, first, stop, lyapunov_rate)
