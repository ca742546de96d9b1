"""What the kernels work on: constants, state, results and working memory as tuples of arrays.

A *block* holds teams side by side, in lanes: entry ``k · L + lane`` of a buffer is the k-th number
of the team in that lane, so that the innermost loop over the teams of a block becomes SIMD. L is 32
(``ManyTeams``), or 1 where there are too few teams, or too large ones, for that to pay
(``OneTeam``). Both are the same code; which one it is, is known while it is compiled.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import chosen_by_type, inlined_kernel

RUNNING, RENDEZVOUS, TIME_OUT, AWAITING_RESET = range(4)
"""Status of a team. AWAITING_RESET: reset in this very step, in which it does not move."""

STATISTICS = (
    "status",  # RUNNING, RENDEZVOUS, TIME_OUT or AWAITING_RESET
    "steps",  # done in this episode
    "active",  # robots that exist on their own
    "contacts",  # in this episode, one for each robot and step
    "path_length",  # way of all robots together in this episode, m
    "initial_lyapunov",  # V at the start of the episode, m²/s
    "lyapunov",  # V now, m²/s; follows from positions and weights
    "min_clearance",  # least distance to an obstacle in this episode, m
    "square_closest",  # least square distance of two neighbours as of the last observation, m²
)
"""What is kept of a team's episode, in the order of ``Teams.statistics``; whole numbers stand in
it as float64, exact up to 2⁵³, because reward and end are computed over lanes."""
(
    STATUS,
    STEPS,
    ACTIVE,
    CONTACTS,
    PATH_LENGTH,
    INITIAL_LYAPUNOV,
    LYAPUNOV,
    MIN_CLEARANCE,
    SQUARE_CLOSEST,
) = range(len(STATISTICS))

SCORES = 8
REWARD, LYAPUNOV_BEFORE_MERGE, LYAPUNOV_AFTER_MERGE, MERGE_RISE, MERGE_EXCESS, *_ = range(SCORES)
ELAPSED, WALKED, LYAPUNOV_NOW = range(MERGE_EXCESS + 1, SCORES)
"""Rows of ``Results.scores``: the team reward; V just before the first and after the last merge
of the step (V at its end if there was none); the largest rise of V at a merge, and above the bound
of theory 5; time and length of all paths since the start of the episode, s and m; V at the end of
the step. The last three are told in every step, and to read them out of the statistics would take
longer than the step of small teams."""

PROXIMITY, WAY, TOUCHES, CLOSENESS, SCORED = range(5)
"""Rows of ``Lanes.tally``: see ``FREE``; the ways of all robots together, m; robots in contact
with an obstacle; how close they are to obstacles; and from the last on what becomes the rows of
``Results.scores``."""
FREE, MOVED, MERGED = 0.0, 1.0, 2.0
"""Whether anything could meet in the team in this step: nothing; something, so that it was moved by
exact geometry; robots have merged."""


class ManyTeams(NamedTuple):
    """A block holds 32 teams side by side."""

    lanes: int = 32


class OneTeam(NamedTuple):
    """A block holds one team."""

    lanes: int = 1


def lane_count(width: Any) -> int:
    """L, teams of a block."""
    return int(width.lanes)


@chosen_by_type(lane_count)
def _constant_lane_count(width):
    count = width.instance_class().lanes  # a constant of the compiled code
    return lambda width: count


class Layout(NamedTuple):
    """How the numbers of a team lie in a block."""

    width: ManyTeams | OneTeam
    """Teams of a block."""
    axes: tuple[int, ...]
    """(0, 1) or (0, 1, 2): loops over it unroll."""
    entries: tuple[int, ...]
    """(0, …, d² − 1), the numbers of a frame."""


class Robot(NamedTuple):
    """The robot model of a team."""

    model: Any
    """Its constants; their type names its equations (``equations.motion``)."""
    inputs: tuple[int, ...]
    """(0, …, a − 1), the numbers of an action."""
    memories: tuple[int, ...]
    """(0, …, k − 1), the numbers that the model keeps."""


class Constants(NamedTuple):
    """What else the kernels need to know of a scenario: the same types for all of them, so that
    stages that need no more are compiled once.
    """

    duration: float
    merge_radius: float
    speed_limit: float
    max_steps: int
    contact_mode: int
    obstacle_range: float
    neighbour_slots: int
    rows: int
    reward_weights: tuple[float, float, float, float, float]
    all_earn: bool
    """Whether merged-away robots earn the team reward, too."""


class Teams(NamedTuple):
    """State of B teams in lane blocks: team b is lane b % L of block b // L, and the last block is
    filled up with lanes that belong to no team.
    """

    positions: NDArray[np.float64]
    """(blocks, n, d·L), m; a merged-away robot's entry stays where it merged."""
    frames: NDArray[np.float64]
    """(blocks, n, d²·L), local → global, row by row."""
    memory: NDArray[np.float64]
    """(blocks, n, k·L), what the robot model keeps: nothing, angles in rad, a velocity in m/s."""
    merged_into: NDArray[np.int64]
    """(B, n), the robot that each one is now part of; itself while it is active."""
    statistics: NDArray[np.float64]
    """(blocks, entries·L), the entries of STATISTICS."""


class Results(NamedTuple):
    """Where a step writes what it gives out. Before, nobody is in contact, and everybody active."""

    observations: NDArray[np.float32]
    """(B, n·rows·d)."""
    whole_rows: NDArray[Any]
    """The same memory, as ``Lanes.whole_rows``."""
    scores: NDArray[np.float64]
    """(8, B), rows REWARD … LYAPUNOV_NOW."""
    contact: NDArray[np.bool_]
    """(B, n), whether the robot touched an obstacle in this step."""
    clearance: NDArray[np.float64]
    """(B, n), distance to the nearest obstacle, m; inf without obstacles."""
    active: NDArray[np.bool_]
    """(B, n), whether the robot still exists on its own."""
    status: NDArray[np.int64]
    """(B,), RUNNING, RENDEZVOUS or TIME_OUT."""
    robot_rewards: NDArray[np.float64]
    """(B, n), the team reward of robots that take part in the step, else 0."""
    contacts: NDArray[np.int64]
    """(B,), in the episode so far."""
    crowded: NDArray[np.int64]
    """(B,), a robot with more neighbours than the observation has rows; −1 if there is none. The
    same memory in every step: it is looked at once."""


class Lanes(NamedTuple):
    """Working memory of one thread: the block at hand."""

    action: NDArray[np.float64]
    """(n, a·L), in the robots' own frames."""
    taken: NDArray[np.float64]
    """(n·a, L), the same memory."""
    displacement: NDArray[np.float64]
    """(n, (d + 1)·L), m, and the length of the way."""
    tally: NDArray[np.float64]
    """(rows·L,), what happens to the teams in this step; see PROXIMITY."""
    took_part: NDArray[np.bool_]
    """(L, n), which robots of a team that has merged existed before."""
    pair: NDArray[np.float64]
    """((4 + d)·L,): Σ a_ij ‖p_j − p_i‖, half of V, least square distance; then the pair at hand."""
    rows: NDArray[np.float32]
    """(n·(neighbour rows + others), d·L), observations; the d numbers of a lane side by side."""
    whole_rows: NDArray[Any]
    """The same memory: both numbers of a row of the plane as one float64; in space, ``rows``."""
    balls: NDArray[np.float64]
    """(M, (d + 2)·L), obstacles: centre and radius of the bounding ball, and the radius of a disc
    in the plane, m; NaN is none."""
    disc: NDArray[np.float64]
    """(8·L,), what one robot sees of one disc."""


class AtHand(NamedTuple):
    """Working memory of one thread: one team, and what is found out about it."""

    positions: NDArray[np.float64]
    """(n, d), m."""
    displacements: NDArray[np.float64]
    """(n, d), m."""
    here: NDArray[np.float64]
    """(n, d), m, places at the moment of a merge; or net bearings in the global frame, m/s."""
    lengths: NDArray[np.float64]
    """(n,), m."""
    resting: NDArray[np.bool_]
    """(n,)."""
    first: NDArray[np.int64]
    """(E,), its links, see ``link_kinds.ListedLinks``."""
    second: NDArray[np.int64]
    """(E,)."""
    weights: NDArray[np.float64]
    """(E,), m/s."""
    moments: NDArray[np.float64]
    """(E,), when the robots of a link meet, as a share of the step."""
    counts: NDArray[np.int64]
    """(n,), neighbour rows written so far."""
    normals: NDArray[np.float64]
    """(2M, 3), of the obstacles touched."""
    silhouette: NDArray[np.float64]
    """(S, d), bearings of one obstacle."""
    report: NDArray[np.float64]
    """(4,), of ``merge_swept``."""


@inlined_kernel
def read(buffer, lane, width, parts):
    """The numbers of one lane, a tuple as long as ``parts``.

    Args:
        buffer: (len(parts)·L,).
        lane: which one.
        width: teams of a block.
        parts: 0, 1, …
    """
    step = lane_count(width)
    if len(parts) == 0:
        return ()
    if len(parts) == 1:
        return (buffer[lane],)
    if len(parts) == 2:
        return buffer[lane], buffer[step + lane]
    if len(parts) == 3:
        return buffer[lane], buffer[step + lane], buffer[2 * step + lane]
    if len(parts) == 4:
        return (
            buffer[lane],
            buffer[step + lane],
            buffer[2 * step + lane],
            buffer[3 * step + lane],
        )
    return (
        buffer[lane],
        buffer[step + lane],
        buffer[2 * step + lane],
        buffer[3 * step + lane],
        buffer[4 * step + lane],
        buffer[5 * step + lane],
        buffer[6 * step + lane],
        buffer[7 * step + lane],
        buffer[8 * step + lane],
    )


@inlined_kernel
def write(values, buffer, first, lane, width):
    """Put a tuple of numbers into one lane of a buffer, as its numbers from ``first`` on."""
    step = lane_count(width)
    place = first * step + lane
    if len(values) == 2:
        buffer[place], buffer[place + step] = values[0], values[1]
    elif len(values) == 3:
        buffer[place], buffer[place + step], buffer[place + 2 * step] = values
    elif len(values) > 0:
        for k in range(len(values)):
            buffer[place + k * step] = values[k]
