"""Memory layout of B environments, and accessors for kernels.

Environments are stored in *blocks* of L lanes, so that the innermost loop over them vectorises. L
is 32 (``LaneBlock``), or 1 for few or large environments (``ScalarBlock``). Environment b is lane b
% L of block b // L. Two arrays hold nearly all of the state, and each of their rows is a list of
fields of L numbers:

    robots[block, i, field·L + lane]         position (d), frame (d²), memory (k) of robot i
    environments[block, field·L + lane]      the fields below

L is a compile-time constant, so LLVM can rule out aliasing between fields of one row.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import by_type, inner_kernel

RUNNING, RENDEZVOUS, TIME_OUT, AWAITING_RESET = range(4)
"""Status of an environment. AWAITING_RESET: reset in this step, in which it does not move."""

FREE, MOVED, MERGED, PACKED = 0.0, 1.0, 2.0, 3.0
"""Proximity events of an environment in this step: none possible; possible, so it was moved by
exact geometry; robots merged; all bodies are in one packed cluster."""

EPISODE_FIELDS = (
    "status",  # RUNNING, RENDEZVOUS, TIME_OUT or AWAITING_RESET
    "steps",  # in this episode
    "active",  # number of active (not merged) robots
    "contacts",  # in this episode, one per robot and step
    "path_length",  # sum over robots in this episode, m
    "initial_lyapunov",  # initial V of the episode, m²/s
    "lyapunov",  # current V, m²/s; derived from positions and weights
    "min_clearance",  # minimum distance to an obstacle in this episode, m
    "clearance",  # minimum over robots at the last observation, m
    "square_closest",  # minimum square distance of neighbours at the last observation, m²
)
"""Persistent fields of an environment; float64 for computation over lanes."""
(
    STATUS,
    STEPS,
    ACTIVE,
    CONTACTS,
    PATH_LENGTH,
    INITIAL_LYAPUNOV,
    LYAPUNOV,
    MIN_CLEARANCE,
    CLEARANCE,
    SQUARE_CLOSEST,
) = range(10)

PROXIMITY, STEP_LENGTH, STEP_CONTACTS, CLOSENESS, SENSED_LYAPUNOV = range(10, 15)
"""Fields of one step: FREE to PACKED; path length of all robots, m; robots in contact; closeness
to obstacles, see ``rewards.team_reward``; V as sensed, m²/s."""
REWARD, BEFORE_MERGE, AFTER_MERGE, MERGE_RISE, MERGE_EXCESS, ELAPSED, WALKED, FINAL = range(15, 23)
"""Rows of ``StepOutput.scores``."""
N_FIELDS = 23

_ZERO = np.float32(0.0)
Floats = NDArray[np.float64]


class LaneBlock(NamedTuple):
    """Block of 32 environments."""

    lanes: int = 32


class ScalarBlock(NamedTuple):
    """Block of one environment."""

    lanes: int = 1


@by_type("width", lambda kind: kind().lanes)
def lane_count(width):
    """L, environments per block: a compile-time constant."""


class Robot(NamedTuple):
    """Robot model of a scenario; loops over its index tuples are unrolled."""

    model: Any  # its constants; their type selects the equations (``robots.motion``)
    inputs: tuple[int, ...]  # (0, …, a − 1), indices of action components
    axes: tuple[int, ...]  # (0, 1) or (0, 1, 2)
    entries: tuple[int, ...]  # (0, …, d² − 1), indices of frame entries
    memories: tuple[int, ...]  # (0, …, k − 1), indices of the model's memory
    limits: Any = None
    """Constants of each robot, (n, constants), see ``motion.constants_of_robot``; None if all
    robots have those of ``model``."""


def _of_one(kind: type) -> Any:
    parts = ", ".join(f"obstacles.{name}[b]" for name in getattr(kind, "_fields", ()))
    return eval(f"lambda obstacles, b: kind({parts})", {"kind": kind, "__name__": __name__})


@by_type("obstacles", _of_one)
def obstacles_of(obstacles, b):
    """Obstacles of one environment, from those of all with a leading axis."""


@inner_kernel(inline="code")
def load_fields(row, field, lane, lanes, parts):
    """Load consecutive fields of one lane of a row as a tuple, as long as ``parts``."""
    k, s = field * lanes + lane, lanes
    if len(parts) == 0:
        return ()
    if len(parts) == 1:
        return (row[k],)
    if len(parts) == 2:
        return row[k], row[k + s]
    if len(parts) == 3:
        return row[k], row[k + s], row[k + 2 * s]
    if len(parts) == 4:
        return row[k], row[k + s], row[k + 2 * s], row[k + 3 * s]
    first = row[k], row[k + s], row[k + 2 * s], row[k + 3 * s], row[k + 4 * s]
    if len(parts) == 5:
        return first
    return (*first, row[k + 5 * s], row[k + 6 * s], row[k + 7 * s], row[k + 8 * s])


@inner_kernel(inline="code")
def store_fields(values, row, field, lane, lanes):
    """Store a tuple in consecutive fields of one lane of a row."""
    k, s = field * lanes + lane, lanes
    if len(values) == 2:
        row[k], row[k + s] = values[0], values[1]
    elif len(values) == 3:
        row[k], row[k + s], row[k + 2 * s] = values[0], values[1], values[2]
    elif len(values) > 0:
        for field in range(len(values)):
            row[k + field * s] = values[field]


@inner_kernel(inline="code")
def load_point(row, field, lane, lanes, d):
    """Position or displacement of one lane as a triple, z = 0 in 2-D."""
    k = field * lanes + lane
    return row[k], row[k + lanes], row[k + 2 * lanes] if d == 3 else 0.0


@inner_kernel
def load_positions(robots, lane, lanes, out):
    """Copy the positions of one lane of robots, (n, fields·L), to ``out``, (n, d)."""
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[i, k] = robots[i, k * lanes + lane]


@inner_kernel
def store_positions(values, robots, lane, lanes):
    """Copy positions (n, d) to one lane of robots, (n, fields·L)."""
    for i in range(values.shape[0]):
        for k in range(values.shape[1]):
            robots[i, k * lanes + lane] = values[i, k]


@inner_kernel(inline="code")
def is_near(environment, lane, lanes, reach):
    """True if the environment runs and a contact is possible in its next step.

    ``reach`` is the square distance of neighbours, m², and the clearance, m, below which a contact
    is possible. Distances are those of the last observation.
    """
    near = environment[SQUARE_CLOSEST * lanes + lane] < reach[0]
    near |= environment[CLEARANCE * lanes + lane] < reach[1]
    return near & (environment[STATUS * lanes + lane] == RUNNING)


@inner_kernel(inline="code")
def sensed_step(environment, lane, lanes, moves):
    """Step number at which an environment is sensed.

    While it moves, ``moves``, the current step is not counted yet.
    """
    running = environment[STATUS * lanes + lane] == RUNNING
    return int(environment[STEPS * lanes + lane]) + (1 if moves & running else 0)


@inner_kernel(inline="code")
def read(buffer, lane, parts):
    """Numbers of one lane of a buffer, (numbers, L), as a tuple, as long as ``parts``."""
    if len(parts) == 0:
        return ()
    if len(parts) == 1:
        return (buffer[0, lane],)
    if len(parts) == 2:
        return buffer[0, lane], buffer[1, lane]
    if len(parts) == 3:
        return buffer[0, lane], buffer[1, lane], buffer[2, lane]
    first = buffer[0, lane], buffer[1, lane], buffer[2, lane], buffer[3, lane]
    if len(parts) == 4:
        return first
    if len(parts) == 5:
        return (*first, buffer[4, lane])
    second = buffer[4, lane], buffer[5, lane], buffer[6, lane], buffer[7, lane]
    return (*first, *second, buffer[8, lane])


@inner_kernel(inline="code")
def write(values, buffer, lane):
    """Store a tuple of numbers in one lane of a buffer, (numbers, L)."""
    if len(values) == 2:
        buffer[0, lane], buffer[1, lane] = values[0], values[1]
    elif len(values) == 3:
        buffer[0, lane], buffer[1, lane], buffer[2, lane] = values
    elif len(values) > 0:
        for k in range(len(values)):
            buffer[k, lane] = values[k]


@inner_kernel(inline="code")
def read_row(row, lane, axes):
    """One lane of a row of observations, (L·d,), a pair or triple of float32."""
    if len(axes) == 2:
        return row[2 * lane], row[2 * lane + 1]
    return row[3 * lane], row[3 * lane + 1], row[3 * lane + 2]


@inner_kernel(inline="code")
def write_row(values, row, lane):
    """Store a pair or triple in one lane of a row of observations, (L·d,).

    Negative zeros become positive.
    """
    # one index: with two, the compiler does not vectorise a strided store
    d = len(values)
    row[d * lane], row[d * lane + 1] = values[0] + _ZERO, values[1] + _ZERO
    if len(values) == 3:
        row[d * lane + 2] = values[2] + _ZERO
