"""One step of many teams: propose → contact → merge → turn → sense → conclude, block by block."""

import numpy as np

from ...compilation import inner_kernel, kernel
from ...outcome import StepOutput
from ..memory import (
    STATISTICS,
    BatchState,
    Block,
    BlockScratch,
    Constants,
    Scratch,
    Setup,
    Tally,
    Teams,
    TeamScratch,
    lane_count,
    pair_of,
    statistics_of,
)
from .advance import advance_block
from .conclude import conclude_block
from .propose import load_actions, propose_block, turn_block, update_frames
from .sense import sense_block

_EXPONENT = np.uint32(0x7F800000)  # The exponent bits of a float32
_N_STATISTICS, _N_TALLY = len(STATISTICS), len(Tally._fields)


@kernel
def step_blocks(part, moves, blocks, setup, sensor, state, actions, output, scratch):
    """One step of the blocks of a thread's part; finished teams stand still and earn nothing. If
    nothing ``moves``, teams are only observed, and frames and V brought up to date.

    Blocks are indices; setup is layout, the fields of Constants, and robot; sensor is one that is
    not exact, or None; state, output and scratch are the fields of BatchState (Teams as a tuple),
    StepOutput, BlockScratch and TeamScratch; actions are (B, n, a) finite float32, of all teams.
    """
    # plain tuples cross the border from Python twice as fast as named ones
    setup = Setup(setup[0], Constants(*setup[1]), setup[2])
    state = BatchState(Teams(*state[0]), state[1], state[2], state[3])
    output = StepOutput(*output)
    scratch = Scratch(BlockScratch(*scratch[0]), TeamScratch(*scratch[1]))
    if _is_laid_out(setup, state.teams, scratch.block):
        for k in range(part[0], part[1]):
            _step_block(blocks[k], moves, setup, sensor, state, actions, output, scratch)


@inner_kernel(inline="text")
def _is_laid_out(setup, teams, scratch):
    """Whether arrays are as long as they must be. They are; behind this question the compiler
    knows it too, see ``memory``.
    """
    lanes, d = lane_count(setup.layout.width), len(setup.layout.axes)
    return (
        _ends(teams.positions, d, lanes)
        and _ends(teams.frames, len(setup.layout.entries), lanes)
        and _ends(teams.memory, len(setup.robot.memories), lanes)
        and _ends(teams.statistics, _N_STATISTICS, lanes)
        and _ends(teams.discs, 3, lanes)
        and _ends(scratch.action, len(setup.robot.inputs), lanes)
        and _ends(scratch.displacement, d + 1, lanes)
        and _ends(scratch.tally, _N_TALLY, lanes)
        and _ends(scratch.pair, d + 3, lanes)
        and _ends(scratch.rows, scratch.rows.shape[1], lanes * d)
        and scratch.disc.shape == (3, 2, lanes)
        and _ends(scratch.keys, 2, lanes)
        and _ends(scratch.words, 4, lanes)
    )


@inner_kernel(inline="code")
def _ends(array, rows, columns):
    """Whether an array is as long as this in its last two axes."""
    return array.shape[array.ndim - 2] == rows and array.shape[array.ndim - 1] == columns


@inner_kernel(inline="text")
def _step_block(index, moves, setup, sensor, state, actions, output, scratch):
    """Propose → contact → merge → turn → sense → conclude."""
    lanes, teams, robot = lane_count(setup.layout.width), state.teams, setup.robot
    first = index * lanes
    block = Block(index, first, min(lanes, len(actions) - first))
    if moves:
        load_actions(block, teams, actions, scratch.block.action)
        propose_block(block, setup, teams, scratch.block)
        advance_block(block, setup, state, output, scratch)
        turn_block(block, setup, robot.memories, teams, output.contact, scratch.block)
    else:
        update_frames(block, setup, robot.memories, teams)
    sense_block(block, setup, sensor, moves, state, output, scratch)
    if moves:
        conclude_block(block, setup, teams, output, scratch.block)
    else:
        # each pair was seen once, and V counts each edge twice
        found = pair_of(scratch.block.pair, setup.layout.axes)
        lyapunov = statistics_of(teams, index).lyapunov
        for lane in range(lanes):
            lyapunov[lane] = 2.0 * found.half_lyapunov[lane]


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
