"""One step of many teams: propose → contact → merge → turn → sense → conclude, block by block."""

import numpy as np

from ..compilation import kernel, unfolded_kernel
from .advance import advance_block
from .conclude import conclude_block
from .memory import LYAPUNOV, AtHand, Constants, Lanes, Results, Teams, lane_count
from .pool.sharing import Share, each_block
from .propose import bring_frames_up, load_actions, propose_block, turn_block
from .sense import sense_block
from .sense_obstacles import load_balls

_EXPONENT = np.uint32(0x7F800000)
"""The exponent bits of a float32."""


@kernel
def step_blocks(
    share,
    moves,
    blocks,
    layout,
    constants,
    robot,
    sensor,
    teams,
    links,
    obstacles,
    actions,
    results,
    all_lanes,
    hands,
):
    """One step of the blocks that this thread takes; finished teams stand still and earn nothing.

    Args:
        share: this thread's part, see sharing.py.
        moves: whether time passes; if not, the teams are only observed as they are, and frames and
            V are brought up to date.
        blocks: indices of the blocks to do.
        layout: of the memory.
        constants: the fields of Constants.
        robot: its model.
        sensor: one that is not exact, or None.
        teams: the fields of Teams.
        links: of a kind of ``link_kinds``.
        obstacles: Balls or Shapes with a leading axis B; None without obstacles.
        actions: (B, n·a) finite float32, of all teams.
        results: the fields of Results.
        all_lanes: the fields of Lanes, each with a leading axis for the threads.
        hands: the fields of AtHand, likewise.

    Returns:
        Whether all blocks are done, see ``each_block``.
    """
    # plain tuples cross the border from Python twice as fast as named ones
    thread = Share(*share).thread
    return each_block(
        share,
        _step_block,
        (
            moves,
            blocks,
            layout,
            Constants(*constants),
            robot,
            sensor,
            Teams(*teams),
            links,
            obstacles,
            actions,
            Results(*results),
            _lanes_of(Lanes(*all_lanes), thread),
            _hand_of(AtHand(*hands), thread),
        ),
    )


@unfolded_kernel
def _step_block(taken, arguments):
    """Propose → contact → merge → turn → sense → conclude."""
    (
        moves,
        blocks,
        layout,
        constants,
        robot,
        sensor,
        teams,
        links,
        obstacles,
        actions,
        results,
        buffers,
        hand,
    ) = arguments
    block, lanes = blocks[taken], lane_count(layout.width)
    # loops over what the user gets end with the last team; those over lanes do all, to be SIMD
    count = min(lanes, len(actions) - block * lanes)
    load_balls(block, count, layout, obstacles, buffers)
    if moves:
        load_actions(block, count, layout, teams, actions, buffers)
        propose_block(block, count, layout, robot, teams, buffers)
        advance_block(
            block,
            count,
            layout,
            constants,
            robot,
            teams,
            links,
            obstacles,
            results,
            buffers,
            hand,
        )
        turn_block(block, count, layout, constants, robot, robot.memories, teams, results, buffers)
    else:
        bring_frames_up(block, count, layout, robot, robot.memories, teams)
    sense_block(
        block,
        count,
        layout,
        constants,
        robot,
        sensor,
        moves,
        teams,
        links,
        obstacles,
        results,
        buffers,
        hand,
    )
    if moves:
        conclude_block(block, count, layout, constants, teams, results, buffers)
    else:
        # each pair was seen once, and V counts each edge twice
        for lane in range(lanes):
            teams.statistics[block, LYAPUNOV * lanes + lane] = 2.0 * buffers.pair[lane]


@unfolded_kernel
def _lanes_of(all_lanes, thread):
    """One thread's working memory for a block."""
    return Lanes(
        all_lanes.action[thread],
        all_lanes.taken[thread],
        all_lanes.displacement[thread],
        all_lanes.tally[thread],
        all_lanes.took_part[thread],
        all_lanes.pair[thread],
        all_lanes.rows[thread],
        all_lanes.whole_rows[thread],
        all_lanes.balls[thread],
        all_lanes.disc[thread],
    )


@unfolded_kernel
def _hand_of(hands, thread):
    """One thread's working memory for a team."""
    return AtHand(
        hands.positions[thread],
        hands.displacements[thread],
        hands.here[thread],
        hands.lengths[thread],
        hands.resting[thread],
        hands.first[thread],
        hands.second[thread],
        hands.weights[thread],
        hands.moments[thread],
        hands.counts[thread],
        hands.normals[thread],
        hands.silhouette[thread],
        hands.report[thread],
    )


@kernel
def first_not_finite(values):
    """Index of the first number whose exponent bits are all set (infinite or NaN), or −1."""
    # a maximum has no branch and becomes SIMD; the place is looked for only if there is one
    bits = values.view(np.uint32)
    largest = np.uint32(0)
    for k in range(bits.shape[0]):
        largest = max(largest, bits[k] & _EXPONENT)
    if largest < _EXPONENT:
        return -1
    k = 0
    while bits[k] & _EXPONENT < _EXPONENT:
        k += 1
    return k
