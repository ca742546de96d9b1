"""What the kernels work on: constants, state and working memory as tuples of named arrays.

Teams are computed side by side, in the *lanes* of a block, so that the innermost loop over them
becomes SIMD. The last axis of every array of a block is that of its lanes:

    positions[block, i, k, lane]    statistics.steps[lane]    tally.reward[lane]

A block has L = 32 lanes (``ManyTeams``), or one where there are too few teams, or too large ones,
for that to pay (``OneTeam``). Both are the same code; L is known while it is compiled. So are the
lengths of the arrays, since ``step.step_blocks`` begins by asking whether they are as they must be:
behind that question rows cannot overlap, and loops over them become SIMD without further checks.

The annotation of an array says its axes, by which ``memory_layout.allocate`` makes it.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import by_type, inner_kernel

RUNNING, RENDEZVOUS, TIME_OUT, AWAITING_RESET = range(4)
"""Status of a team. AWAITING_RESET: reset in this very step, in which it does not move."""

FREE, MOVED, MERGED, PACKED = 0.0, 1.0, 2.0, 3.0
"""Whether anything could meet in the team in this step: nothing; something, so that it was moved by
exact geometry; robots have merged; all bodies lie in one packed cluster."""

_ZERO = np.float32(0.0)
Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Statistics(NamedTuple):
    """What is kept of the episodes of a block's teams, (L,) each; whole numbers as float64, because
    reward and end are computed over lanes.
    """

    status: Floats  # RUNNING, RENDEZVOUS, TIME_OUT or AWAITING_RESET
    steps: Floats  # Done in this episode
    active: Floats  # Robots that exist on their own
    contacts: Floats  # In this episode, one for each robot and step
    path_length: Floats  # Way of all robots together in this episode, m
    initial_lyapunov: Floats  # V at the start of the episode, m²/s
    lyapunov: Floats  # V now, m²/s; follows from positions and weights
    min_clearance: Floats  # Least distance to an obstacle in this episode, m
    clearance: Floats  # Of the robot nearest to an obstacle as of the last observation, m
    square_closest: Floats  # Least square distance of two neighbours as of the last observation, m²


STATISTICS = Statistics._fields


@inner_kernel(inline="text")
def statistics_of(teams, block):
    """The Statistics of a block (an index)."""
    r = teams.statistics[block]
    return Statistics(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9])


@inner_kernel(inline="text")
def step_seen(statistics, lane, moves):
    """Number of the step that a team is sensed in: while it moves it has not counted it yet."""
    return int(statistics.steps[lane]) + (1 if moves & (statistics.status[lane] == RUNNING) else 0)


class Tally(NamedTuple):
    """What happens to the teams of a block in a step, (L,) each."""

    proximity: Floats  # FREE, MOVED, MERGED or PACKED
    way: Floats  # Of all robots together, m
    contacts: Floats  # Robots in contact with an obstacle
    closeness: Floats  # How close the robots are to obstacles, see ``rewards.team_reward``
    reward: Floats  # From here on the rows of ``StepOutput.scores``
    lyapunov_before_merge: Floats
    lyapunov_after_merge: Floats
    merge_rise: Floats
    merge_excess: Floats
    elapsed: Floats
    walked: Floats
    lyapunov: Floats


SCORED = Tally._fields.index("reward")
"""Row of a tally from which on it is given out."""


@inner_kernel(inline="text")
def tally_of(r):
    """The Tally whose rows r are, (12, L)."""
    return Tally(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11])


class ManyTeams(NamedTuple):
    """A block holds 32 teams side by side."""

    lanes: int = 32


class OneTeam(NamedTuple):
    """A block holds one team."""

    lanes: int = 1


@by_type("width", lambda kind: kind().lanes)
def lane_count(width):
    """L, teams of a block: a constant of the compiled code."""


@inner_kernel(inline="code")
def in_lanes(buffer, layout):
    """Whether a buffer, (numbers, L), is as wide as a block. It is; a loop over lanes, optimised by
    itself before it becomes part of others, asks so as to know how far apart the rows lie.
    """
    return buffer.shape[1] == lane_count(layout.width)


class Layout(NamedTuple):
    """How the numbers of a team lie in a block."""

    width: ManyTeams | OneTeam  # Teams of a block
    axes: tuple[int, ...]  # (0, 1) or (0, 1, 2): loops over it unroll
    entries: tuple[int, ...]  # (0, …, d² − 1), the numbers of a frame
    packs: bool | None
    """None where every pair has a row of its own in the observation, or rows are packed already."""


class Robot(NamedTuple):
    """The robot model of a team."""

    model: Any  # Its constants; their type names its equations (``robots.motion``)
    inputs: tuple[int, ...]  # (0, …, a − 1), the numbers of an action
    memories: tuple[int, ...]  # (0, …, k − 1), the numbers that the model keeps


class Constants(NamedTuple):
    """What else the kernels need to know of a scenario, of the same types for all."""

    duration: float
    merge_radius: float
    speed_limit: float
    max_steps: int
    contact_mode: int
    obstacle_range: float
    neighbour_slots: int
    rows: int
    reward_weights: tuple[float, ...]
    all_earn: bool  # Whether merged-away robots earn the team reward, too
    body_radius: float  # Of the discs in which robots stand in one another's sight, and way, m
    packs: bool  # Whether bodies stop where they would touch, instead of merging
    merges_through: bool  # Whether robots merge where an obstacle hides them from each other


class Setup(NamedTuple):
    """What all steps of a batch have in common."""

    layout: Layout
    constants: Constants
    robot: Robot


class Block(NamedTuple):
    """Which teams a stage does."""

    index: int  # type: ignore[assignment]  # a method of tuples, which nobody misses
    first: int  # Its first team
    count: int  # type: ignore[assignment]
    """Its teams. Loops over lanes do those of no team too, to be SIMD."""


class Place(NamedTuple):
    """Where a team is."""

    block: int
    lane: int
    team: int


class Teams(NamedTuple):
    """State of B teams: team b is lane b % L of block b // L."""

    positions: Annotated[Floats, "blocks n d L"]
    """m; a merged-away robot's entry stays where it merged."""
    frames: Annotated[Floats, "blocks n d² L"]  # Local → global, row by row
    memory: Annotated[Floats, "blocks n k L"]
    """What the robot model keeps: nothing, angles in rad, a velocity in m/s."""
    merged_into: Annotated[Whole, "B n"]
    """The robot that each one is now part of; itself while it is active."""
    statistics: Annotated[Floats, "blocks statistics L"]  # The rows of Statistics
    discs: Annotated[Floats, "blocks discs 3 L"]
    """Obstacles that are discs in the plane: centre and radius, m; a radius of NaN is no disc."""


class BatchState(NamedTuple):
    """All that a step changes."""

    teams: Teams
    links: Any  # Of a kind of ``graphs.edges``
    changes: Any
    """How arcs follow the moment, ``edges.Changes``; None where only merges change links."""
    obstacles: Any  # ObstacleSet with a leading axis B; None without obstacles


class BlockScratch(NamedTuple):
    """Working memory of one thread for a block."""

    action: Annotated[Floats, "n a L"]  # In the robots' own frames
    displacement: Annotated[Floats, "n d+1 L"]
    """The displacement of each robot, and the length of its way, m."""
    tally: Annotated[Floats, "tally L"]  # The rows of Tally
    took_part: Annotated[Flags, "L n"]  # Which robots of a team that has merged existed before
    pair: Annotated[Floats, "d+3 L"]  # The rows of Pair
    rows: Annotated[NDArray[np.float32], "n rows L·d"]
    """Observations, those of neighbours first; the d numbers of a lane side by side."""
    disc: Annotated[Floats, "3 2 L"]  # What one robot sees of one disc, see SeenDisc
    keys: Annotated[NDArray[np.uint64], "2 L"]
    """Of the streams of sensing: of the episode, and of the step."""
    words: Annotated[NDArray[np.uint32], "3 4 L"]
    """What is drawn for two rows, see ``sense_by_chance``."""


class Pair(NamedTuple):
    """Two robots in every lane, and what has been found of all pairs so far."""

    offset: Floats  # (d, L), p_j − p_i, m
    factor: Floats  # (L,), of a_ij g_ij, 1/s
    half_lyapunov: Floats  # (L,), Σ a_ij ‖p_j − p_i‖, m²/s
    square_closest: Floats  # (L,), least ‖p_j − p_i‖² of neighbours, m²


@inner_kernel(inline="text")
def pair_of(rows, axes):
    """The Pair whose rows these are, (d + 3, L): the offset stands first."""
    d = len(axes)
    return Pair(rows, rows[d], rows[d + 1], rows[d + 2])


class SeenDisc(NamedTuple):
    """What one robot in every lane sees of one disc."""

    left: Floats
    """(2, L), bearing of the counter-clockwise edge in the global frame, zero if it is not seen."""
    right: Floats  # (2, L), of the clockwise edge
    nearest: Floats  # (L,), distance to the nearest disc so far, m
    reach: Floats  # (L,), range of sight, m; −inf for a robot that has merged away


class TeamScratch(NamedTuple):
    """Working memory of one thread for one team."""

    positions: Annotated[Floats, "n d"]
    displacements: Annotated[Floats, "n d"]
    here: Annotated[Floats, "n d"]  # Places at a merge, m; or net bearings, global frame, m/s
    lengths: Annotated[Floats, "n"]
    resting: Annotated[Flags, "n"]
    first: Annotated[Whole, "E"]  # Its links, see ``edges.EdgeList``
    second: Annotated[Whole, "E"]
    weights: Annotated[Floats, "E"]
    moments: Annotated[Floats, "E"]  # When the robots of a link meet, as a share of the step
    counts: Annotated[Whole, "n"]  # Neighbour rows written so far
    normals: Annotated[Floats, "2M 3"]  # Of the obstacles touched
    silhouette: Annotated[Floats, "S d"]  # Bearings of one obstacle
    report: Annotated[Floats, "4"]  # Of ``merge_swept``
    chains: Annotated[Whole, "M 2"]  # Of ``reachability``


class Scratch(NamedTuple):
    """Working memory of one thread."""

    block: BlockScratch
    team: TeamScratch


def _of_kind(kind: type) -> Any:
    if kind is type(None):
        return None
    return lambda obstacles, team: kind(
        obstacles.kinds[team],
        obstacles.corners[team],
        obstacles.shapes[team],
        obstacles.skins[team],
    )


@by_type("obstacles", _of_kind)
def obstacles_of(obstacles, team):
    """The obstacles of one team, from those of all with a leading axis; None without any."""


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
    first = buffer[0, lane], buffer[1, lane], buffer[2, lane], buffer[3, lane]
    if len(parts) == 4:
        return first
    second = buffer[4, lane], buffer[5, lane], buffer[6, lane], buffer[7, lane]
    return (*first, *second, buffer[8, lane])


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
def read_row(row, lane, axes):
    """One lane of a row of observations, (L·d,), a pair or triple of float32."""
    if len(axes) == 2:
        return row[2 * lane], row[2 * lane + 1]
    return row[3 * lane], row[3 * lane + 1], row[3 * lane + 2]


@inner_kernel(inline="code")
def write_row(values, row, lane):
    """Put a pair or triple into one lane of a row of observations, (L·d,), without the negative
    zero.
    """
    # by one index: with two, the compiler gives up the SIMD of a store that leaves gaps
    d = len(values)
    row[d * lane], row[d * lane + 1] = values[0] + _ZERO, values[1] + _ZERO
    if len(values) == 3:
        row[d * lane + 2] = values[2] + _ZERO


@inner_kernel(inline="code")
def first_row(constants, rows):
    """Place of the first row that shows no neighbour among the rows of a block."""
    return rows.shape[1] - constants.rows + constants.neighbour_slots


@inner_kernel
def load_team(blocks, block, lane, out):
    """Copy the numbers (n, d) of one team from blocks, (blocks, n, d, L)."""
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[i, k] = blocks[block, i, k, lane]


@inner_kernel
def store_team(values, blocks, block, lane):
    """Copy the numbers (n, d) of one team to blocks, (blocks, n, d, L)."""
    for i in range(values.shape[0]):
        for k in range(values.shape[1]):
            blocks[block, i, k, lane] = values[i, k]
