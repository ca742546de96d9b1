"""Robots side by side: what filters work out of their rows becomes SIMD in the lanes of a buffer.

A filter's kernel takes LANES robots at a time: rows are summed and memory is copied into lanes, one
loop over them does the arithmetic, with choices in place of branches, and what has come of it is
copied out. All lanes are computed, those of no robot too, by the same code: so what becomes of a
robot does not hang on how many others there are.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from ..compilation import OVERLOADED, compiled, entry_point, inner_kernel
from ..engine.memory import read_row
from ..engine.threads import Calls, Part
from ..physics.neighbour_rows import net_bearing_of
from ..physics.vectors import combine, exactly, load_pair, norm

LANES = 32 if compiled() else 1  # robots that are worked on at a time
PLANE, SPACE = (0.0, 0.0), (0.0, 0.0, 0.0)
"""Vectors as long as those that a loop over lanes is compiled for."""
_ROWS = 18
Numbers = NDArray[np.float64]


class Lanes(NamedTuple):
    """Robots in lanes: vectors (3, LANES), z = 0 in the plane, and numbers (LANES,)."""

    f: Numbers  # net bearings, m/s
    choice: Numbers  # that is held
    heading: Numbers
    sent: Numbers  # velocities of actions, m/s
    degree: Numbers  # D, m/s
    level: Numbers  # A, m²/s
    deposit: Numbers  # G, m²/s
    accepted: Numbers  # whether the choice is carried out, 1 or 0
    alignment: Numbers
    lyapunov_rate: Numbers


_entry_points: dict[tuple[Any, type, np.dtype[Any]], Callable[..., Any]] = {}


def in_lanes(kernel: Any, teams: Part, constants: Any, *arrays: NDArray[Any]) -> Calls:
    """The call of a kernel for the robots of some teams: it is given the teams, constants, arrays
    (B, n, ...), any unit, the first of which is observations, and memory for ``lanes_of`` and rows.
    """
    arguments = teams, constants, arrays, np.zeros((_ROWS + 2 * arrays[0].shape[2], LANES))
    kind = kernel, type(constants), arrays[0].dtype  # all other types follow from these
    if (run := _entry_points.get(kind)) is None:
        run = _entry_points[kind] = entry_point(kernel, arguments)
    return [partial(run, *arguments)]


def by_robot(arrays: Sequence[NDArray[Any]]) -> tuple[NDArray[Any], ...]:
    """Arrays (B, n, ...), any unit, as (B·n, ...): b·n + i for robot i of team b; not copied."""
    return tuple([a.reshape(-1, *a.shape[2:]) for a in arrays])


@overload(by_robot, jit_options=OVERLOADED, strict=False)
def _by_robot(arrays: Any) -> Any:
    one = "arrays[{0}].reshape((-1,) + arrays[{0}].shape[2:])".format
    return eval(f"lambda arrays: ({', '.join(map(one, range(len(arrays))))},)")


@inner_kernel(inline="text")
def lanes_of(work):
    """The Lanes whose rows these are."""
    vectors = work[0:3], work[3:6], work[6:9], work[9:12]
    return Lanes(*vectors, work[12], work[13], work[14], work[15], work[16], work[17])


# Robots are cut out of arrays first: of ``values[first + lane]`` the compiler cannot know that the
# index is not negative, and the loop would not become SIMD.


@inner_kernel(inline="code")
def take_in(values, first, stop, lanes):
    """Copy vectors (N, d), any unit, of robots first ≤ i < stop into lanes (3, LANES)."""
    taken = values[first:stop]
    if taken.shape[1] == 2:  # behind this question the compiler copies both at once
        for lane in range(len(taken)):
            lanes[0, lane], lanes[1, lane] = taken[lane, 0], taken[lane, 1]
    else:
        for lane in range(len(taken)):
            for k in range(taken.shape[1]):
                lanes[k, lane] = taken[lane, k]


@inner_kernel(inline="code")
def give_out(lanes, first, stop, values):
    """Copy vectors, any unit, from lanes (3, LANES) to robots first ≤ i < stop, (N, d)."""
    given = values[first:stop]
    if given.shape[1] == 2:
        for lane in range(len(given)):
            given[lane, 0], given[lane, 1] = lanes[0, lane], lanes[1, lane]
    else:
        for lane in range(len(given)):
            for k in range(given.shape[1]):
                given[lane, k] = lanes[k, lane]


@inner_kernel(inline="code")
def tell(lanes, first, stop, values):
    """Copy numbers, any unit, from lanes (LANES,) to robots first ≤ i < stop, (N,); where those are
    bool, whether they are ≠ 0.
    """
    told = values[first:stop]
    for lane in range(len(told)):
        told[lane] = lanes[lane]


@inner_kernel(inline="code")
def vector_of(space, lanes, lane):
    """The vector v = (x, y, …) of one lane, of any unit, a pair in the PLANE, a triple in SPACE."""
    if len(space) == 2:
        return lanes[0, lane], lanes[1, lane]
    return lanes[0, lane], lanes[1, lane], lanes[2, lane]


@inner_kernel(inline="code")
def put(vector, lanes, lane):
    """Write a pair or triple v = (x, y, …) of any unit to one lane."""
    lanes[0, lane], lanes[1, lane] = vector[0], vector[1]
    if len(vector) == 3:
        lanes[2, lane] = vector[2]


@inner_kernel(inline="code")
def read(observations, held, first, stop, robot, weighs, work):
    """Read what robots first ≤ i < stop hold, (N, k), and see in rows (N, rows, d), m/s: f_i =
    Σ_j a_ij g_ij, and D_i = Σ_j a_ij if ``weighs``. ``robot`` is a Robot.
    """
    if observations.shape[2] == 2:
        read_rows(PLANE, observations, first, stop, robot.neighbour_slots, weighs, work)
    else:
        read_rows(SPACE, observations, first, stop, robot.neighbour_slots, weighs, work)
    take_in(held, first, stop, lanes_of(work).choice)


@inner_kernel(slp=True)
def _sum_in_plane(observations, neighbour_slots, f):
    """f_i = Σ_j a_ij g_ij, as ``net_bearing_of``, from rows (N, rows, 2), m/s, into f (2, N)."""
    for lane in range(len(observations)):
        rows = observations[lane]
        x, y = 0.0, 0.0
        for k in range(neighbour_slots):
            row = load_pair(rows[k])
            x, y = x + row[0], y + row[1]
        f[0, lane], f[1, lane] = x, y


@inner_kernel(inline="code")
def read_rows(space, observations, first, stop, neighbour_slots, weighs, work):
    """Of robots first ≤ i < stop, from their rows (N, rows, d), m/s: f_i, and D_i if ``weighs``."""
    if work.shape[1] != LANES:  # it is; so the compiler knows how far apart rows are
        return
    lanes = lanes_of(work)
    if weighs:
        room = work[_ROWS:].reshape(-1).view(np.float32)[: neighbour_slots * LANES * len(space)]
        rows = room.reshape(neighbour_slots, LANES * len(space))
        _weigh_rows(space, observations[first:stop], rows, lanes)
    else:
        if len(space) == 2:
            _sum_in_plane(observations[first:stop], neighbour_slots, lanes.f)
        else:
            for lane in range(min(LANES, stop - first)):
                put(net_bearing_of(observations[first + lane], neighbour_slots), lanes.f, lane)
        lanes.degree[:] = 0.0


@inner_kernel(inline="code")
def _weigh_rows(space, observations, rows, lanes):
    """f_i and D_i by way of neighbour rows (K, LANES·d) side by side, where roots are quicker."""
    if len(space) == 2:  # both numbers of a row in one piece
        _bring(observations.view(np.float64), rows.view(np.float64), 1)
    else:
        _bring(observations, rows, 3)
    lanes.f[:] = 0.0
    lanes.degree[:] = 0.0
    for k in range(len(rows)):
        for lane in range(LANES):
            row = exactly(read_row(rows[k], lane, space))
            put(combine(1.0, vector_of(space, lanes.f, lane), 1.0, row), lanes.f, lane)
            lanes.degree[lane] += norm(row)


@inner_kernel(inline="code")
def _bring(observations, rows, parts):
    """Copy rows (N, K, parts) into those of lanes, (K, LANES·parts)."""
    for lane in range(len(observations)):
        for k in range(len(rows)):
            for part in range(parts):
                rows[k, lane * parts + part] = observations[lane, k, part]


@inner_kernel(inline="code")
def report(lanes, first, stop, actions, alignment, lyapunov_rate):
    """Give out velocities (N, d), m/s, and |hᵀf|/‖f‖ and −2 (hᵀf)², (N,), of first ≤ i < stop."""
    give_out(lanes.sent, first, stop, actions)
    tell(lanes.alignment, first, stop, alignment)
    tell(lanes.lyapunov_rate, first, stop, lyapunov_rate)
