"""What the kernels work on: constants, state and working memory as tuples of named arrays.

Teams are computed side by side, in the *lanes* of a block, so that the innermost loop over them
becomes SIMD. The last axis of every array of a block is that of its lanes:

    positions[block, i, k, lane]    statistics.steps[lane]    tally.reward[lane]

A block has L = 32 lanes (``ManyTeams``), or one where there are too few teams, or too large ones,
for that to pay (``OneTeam``). Both are the same code; L is known while it is compiled. So that the
compiler knows the lengths of the arrays too, ``step.step_blocks`` begins by asking whether they are
as they must be: behind that question rows of one array lie a known distance apart, cannot overlap,
and loops over them need no further checks to become SIMD.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import chosen_by_type, inner_kernel

RUNNING, RENDEZVOUS, TIME_OUT, AWAITING_RESET = range(4)
"""Status of a team. AWAITING_RESET: reset in this very step, in which it does not move."""

FREE, MOVED, MERGED, PACKED = 0.0, 1.0, 2.0, 3.0
"""Whether anything could meet in the team in this step: nothing; something, so that it was moved by
exact geometry; robots have merged; all bodies lie in one packed cluster."""


class Statistics(NamedTuple):
    """What is kept of the episodes of a block's teams, (L,) each. Whole numbers are float64, exact
    up to 2⁵³, because reward and end are computed over lanes.
    """

    status: NDArray[np.float64]
    """RUNNING, RENDEZVOUS, TIME_OUT or AWAITING_RESET."""
    steps: NDArray[np.float64]
    """Done in this episode."""
    active: NDArray[np.float64]
    """Robots that exist on their own."""
    contacts: NDArray[np.float64]
    """In this episode, one for each robot and step."""
    path_length: NDArray[np.float64]
    """Way of all robots together in this episode, m."""
    initial_lyapunov: NDArray[np.float64]
    """V at the start of the episode, m²/s."""
    lyapunov: NDArray[np.float64]
    """V now, m²/s; follows from positions and weights."""
    min_clearance: NDArray[np.float64]
    """Least distance to an obstacle in this episode, m."""
    square_closest: NDArray[np.float64]
    """Least square distance of two neighbours as of the last observation, m²."""


STATISTICS = Statistics._fields


@inner_kernel(inline="text")
def statistics_of(teams, block):
    """The Statistics of a block (an index)."""
    rows = teams.statistics[block]
    return Statistics(
        rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6], rows[7], rows[8]
    )


class Tally(NamedTuple):
    """What happens to the teams of a block in a step, (L,) each."""

    proximity: NDArray[np.float64]
    """FREE, MOVED, MERGED or PACKED."""
    way: NDArray[np.float64]
    """Of all robots together, m."""
    contacts: NDArray[np.float64]
    """Robots in contact with an obstacle."""
    closeness: NDArray[np.float64]
    """How close the robots are to obstacles, see ``rewards.team_reward``."""
    reward: NDArray[np.float64]
    """From here on the rows of ``StepOutput.scores``."""
    lyapunov_before_merge: NDArray[np.float64]
    lyapunov_after_merge: NDArray[np.float64]
    merge_rise: NDArray[np.float64]
    merge_excess: NDArray[np.float64]
    elapsed: NDArray[np.float64]
    walked: NDArray[np.float64]
    lyapunov: NDArray[np.float64]


SCORED = Tally._fields.index("reward")
"""Row of a tally from which on it is given out."""


@inner_kernel(inline="text")
def tally_of(rows):
    """The Tally whose rows these are, (12, L)."""
    return Tally(
        rows[0],
        rows[1],
        rows[2],
        rows[3],
        rows[4],
        rows[5],
        rows[6],
        rows[7],
        rows[8],
        rows[9],
        rows[10],
        rows[11],
    )


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


@inner_kernel(inline="code")
def in_lanes(buffer, layout):
    """Whether a buffer, (numbers, L), is as wide as a block. It is; a loop over lanes asks because
    it is optimised by itself before it becomes part of others, and would be unrolled there instead
    of becoming SIMD, as long as nothing says how far apart the rows lie.
    """
    return buffer.shape[1] == lane_count(layout.width)


class Layout(NamedTuple):
    """How the numbers of a team lie in a block."""

    width: ManyTeams | OneTeam
    """Teams of a block."""
    axes: tuple[int, ...]
    """(0, 1) or (0, 1, 2): loops over it unroll."""
    entries: tuple[int, ...]
    """(0, …, d² − 1), the numbers of a frame."""
    packs: bool | None
    """None where every pair has a row of its own in the observation, or rows are packed already."""


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
    reward_weights: tuple[float, ...]
    all_earn: bool
    """Whether merged-away robots earn the team reward, too."""
    body_radius: float
    """Of the discs in which robots stand in one another's sight, and way, m."""
    packs: bool
    """Whether bodies stop where they would touch, instead of merging."""


class Setup(NamedTuple):
    """What all steps of a batch have in common."""

    layout: Layout
    constants: Constants
    robot: Robot


class Block(NamedTuple):
    """Which teams a stage does."""

    index: int  # type: ignore[assignment]  # a method of tuples, which nobody misses
    first: int
    """Its first team."""
    count: int  # type: ignore[assignment]
    """Its teams; lanes from there on belong to no team. Loops over what the user gets end with the
    last team; those over lanes do all, to be SIMD."""


class Place(NamedTuple):
    """Where a team is."""

    block: int
    lane: int
    team: int


class Teams(NamedTuple):
    """State of B teams: team b is lane b % L of block b // L."""

    positions: NDArray[np.float64]
    """(blocks, n, d, L), m; a merged-away robot's entry stays where it merged."""
    frames: NDArray[np.float64]
    """(blocks, n, d², L), local → global, row by row."""
    memory: NDArray[np.float64]
    """(blocks, n, k, L), what the robot model keeps: nothing, angles in rad, a velocity in m/s."""
    merged_into: NDArray[np.int64]
    """(B, n), the robot that each one is now part of; itself while it is active."""
    statistics: NDArray[np.float64]
    """(blocks, entries, L), the rows of Statistics."""


class BatchState(NamedTuple):
    """All that a step changes."""

    teams: Teams
    links: Any
    """Of a kind of ``graphs.edges``."""
    changes: Any
    """How arcs follow the moment, ``edges.Changes``; None where only merges change links."""
    obstacles: Any
    """ObstacleSet with a leading axis B; None without obstacles."""


class BlockScratch(NamedTuple):
    """Working memory of one thread for a block; in Python with a leading axis for the threads."""

    action: NDArray[np.float64]
    """(n, a, L), in the robots' own frames."""
    displacement: NDArray[np.float64]
    """(n, d + 1, L), m: the displacement of each robot, and the length of its way."""
    tally: NDArray[np.float64]
    """(12, L), the rows of Tally."""
    took_part: NDArray[np.bool_]
    """(L, n), which robots of a team that has merged existed before."""
    pair: NDArray[np.float64]
    """(d + 4, L), the rows of Pair."""
    rows: NDArray[np.float32]
    """(n, neighbour rows + others, L·d), observations; the d numbers of a lane side by side."""
    whole_rows: NDArray[Any]
    """(n · rows, L · parts), the same memory: both numbers of a row of the plane as one float64; in
    space d float32."""
    centres: NDArray[np.float64]
    """(M, d, L), of the bounding balls of obstacles, m."""
    bounds: NDArray[np.float64]
    """(M, L), radii of the bounding balls, m; NaN is none."""
    radii: NDArray[np.float64]
    """(M, L), radii of discs in the plane, m; NaN is none."""
    disc: NDArray[np.float64]
    """(3, 2, L), what one robot sees of one disc, see SeenDisc."""
    keys: NDArray[np.uint64]
    """(2, L), of the streams of sensing: of the episode, and of the step."""
    words: NDArray[np.uint32]
    """(3, 4, L), what is drawn for two rows, see ``sense_by_chance``."""


class Pair(NamedTuple):
    """Two robots in every lane, and what has been found of all pairs so far."""

    offset: NDArray[np.float64]
    """(d, L), p_j − p_i, m."""
    factor_ij: NDArray[np.float64]
    """(L,), of a_ij g_ij, 1/s."""
    factor_ji: NDArray[np.float64]
    """(L,), of a_ij g_ji."""
    half_lyapunov: NDArray[np.float64]
    """(L,), Σ a_ij ‖p_j − p_i‖, m²/s."""
    square_closest: NDArray[np.float64]
    """(L,), least ‖p_j − p_i‖² of neighbours, m²."""


@inner_kernel(inline="text")
def pair_of(rows, axes):
    """The Pair whose rows these are, (d + 4, L): the offset stands first."""
    d = len(axes)
    return Pair(rows, rows[d], rows[d + 1], rows[d + 2], rows[d + 3])


class SeenDisc(NamedTuple):
    """What one robot in every lane sees of one disc."""

    left: NDArray[np.float64]
    """(2, L), bearing of the counter-clockwise edge in the global frame, zero if it is not seen."""
    right: NDArray[np.float64]
    """(2, L), of the clockwise edge."""
    nearest: NDArray[np.float64]
    """(L,), distance to the nearest disc so far, m."""
    reach: NDArray[np.float64]
    """(L,), from how near the robot sees, m; −inf for one that has merged away."""


class TeamScratch(NamedTuple):
    """Working memory of one thread for one team; in Python with a leading axis for the threads."""

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
    """(E,), its links, see ``edges.EdgeList``."""
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


class Scratch(NamedTuple):
    """Working memory of one thread."""

    block: BlockScratch
    team: TeamScratch


@inner_kernel(inline="code")
def read(buffer, lane, parts):
    """The numbers of one lane of a buffer, (numbers, L), as a tuple as long as ``parts``."""
    if len(parts) == 0:
        return ()
    if len(parts) == 1:
        return (buffer[0, lane],)
    if len(parts) == 2:
        return buffer[0, lane], buffer[1, lane]
    if len(parts) == 3:
        return buffer[0, lane], buffer[1, lane], buffer[2, lane]
    if len(parts) == 4:
        return buffer[0, lane], buffer[1, lane], buffer[2, lane], buffer[3, lane]
    return (
        buffer[0, lane],
        buffer[1, lane],
        buffer[2, lane],
        buffer[3, lane],
        buffer[4, lane],
        buffer[5, lane],
        buffer[6, lane],
        buffer[7, lane],
        buffer[8, lane],
    )


@inner_kernel(inline="code")
def write(values, buffer, lane):
    """Put a tuple of numbers into one lane of a buffer, (numbers, L)."""
    if len(values) == 2:
        buffer[0, lane], buffer[1, lane] = values[0], values[1]
    elif len(values) == 3:
        buffer[0, lane], buffer[1, lane], buffer[2, lane] = values
    elif len(values) > 0:
        for k in range(len(values)):
            buffer[k, lane] = values[k]


@inner_kernel(inline="code")
def write_row(values, row, lane):
    """Put a pair or triple into one lane of a row of observations, (L·d,)."""
    # by one index: with two, the compiler gives up the SIMD of a store that leaves gaps
    if len(values) == 2:
        row[2 * lane], row[2 * lane + 1] = values
    else:
        row[3 * lane], row[3 * lane + 1], row[3 * lane + 2] = values
