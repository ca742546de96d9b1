"""The step of many teams at once, block by block: act, move, turn, observe, conclude.

The arithmetic that every robot needs runs over the lanes of a block (``lanes.py``). The few teams
in which something can meet in this step, two neighbours or a robot and an obstacle, are moved one
by one by exact geometry instead.
"""

import math

import numpy as np

from ..compilation import inlined_kernel, kernel
from ..equations.contact import IGNORE, move_curved, move_straight
from ..equations.kinematics import arc_displacement, body_frame
from ..equations.merging import merge_swept
from .concluding import conclude_block
from .lanes import LANES, add_displacements, mark_near_ball, mark_near_pairs, velocity_displacements
from .observing import load_obstacles, observe_block
from .scratch import NEAR, SCORED, TOUCHES, WAY, make_scratch
from .sharing import Share, begin, end, take
from .teams import (
    ACTIVE,
    LYAPUNOV,
    LYAPUNOV_BEFORE_MERGE,
    RUNNING,
    SQUARE_CLOSEST,
    STATUS,
    Physics,
    Results,
    Teams,
    read_positions,
    read_weights,
    write_frame,
    write_positions,
    write_weights,
)

_EXPONENT = np.uint32(0x7F800000)
"""The exponent bits of a float32."""


@kernel
def step_blocks(share, physics, axes, span, teams, actions, results):
    """One step of the blocks that this thread takes; finished teams stand still and earn nothing.

    Args:
        share: this thread's part, see sharing.py.
        physics: the fields of Physics.
        axes: (0, 1) or (0, 1, 2).
        span: () for all lanes of a block, (0,) where no block has more than FEW teams.
        teams: the fields of Teams.
        actions: (B, n, a) finite float32, of all teams.
        results: the fields of Results.

    Returns:
        Whether all blocks are done, see ``sharing.end``.
    """
    # plain tuples cross the border from Python twice as fast as named ones
    physics, teams = Physics(*physics), Teams(*teams)
    n, action_size = actions.shape[1:]
    scratch = make_scratch(n, len(axes), action_size, physics.rows, teams.obstacles.shape[1])
    return _step_taken(share, physics, axes, span, teams, actions, Results(*results), scratch)


@inlined_kernel
def _step_taken(share, physics, axes, span, teams, actions, results, scratch):
    share, done = Share(*share), 0
    begin(share)
    block = take(share)
    while block < share.blocks:
        lanes = min(LANES, len(actions) - block * LANES)
        load_obstacles(block, lanes, len(axes), teams, scratch)
        _load_actions(block, lanes, teams, actions, scratch)
        _propose(block, lanes, physics, axes, span, teams, scratch)
        _advance(block, lanes, physics, axes, span, teams, results, scratch)
        if physics.n_angles > 0:
            _turn(block, lanes, physics, teams, scratch)
        observe_block(block, lanes, physics, axes, span, teams, results, scratch)
        conclude_block(block, lanes, physics, span, teams, results, scratch)
        done += 1
        block = take(share)
    return end(share, done)


@kernel
def observe_blocks(blocks, physics, axes, teams, results):
    """Observe these blocks as they are, and bring frames and V up to date; tuples as
    ``step_blocks``.
    """
    physics, teams = Physics(*physics), Teams(*teams)
    n = teams.merged_into.shape[1]
    scratch = make_scratch(n, len(axes), 1, physics.rows, teams.obstacles.shape[1])
    _observe_these(blocks, physics, axes, teams, Results(*results), scratch)


@inlined_kernel
def _observe_these(blocks, physics, axes, teams, results, scratch):
    for block in blocks:
        lanes = min(LANES, len(teams.merged_into) - block * LANES)
        load_obstacles(block, lanes, len(axes), teams, scratch)
        if physics.n_angles > 0:
            _write_body_frames(block, lanes, physics, len(axes), teams)
        observe_block(block, lanes, physics, axes, (), teams, results, scratch)
        for lane in range(lanes):
            teams.book[block, LYAPUNOV * LANES + lane] = 2.0 * scratch.pair[lane]


@kernel
def first_not_finite(values):
    """Index of the first number whose exponent bits are all set (infinite or NaN), or −1."""
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


@inlined_kernel
def _load_actions(block, lanes, teams, actions, scratch):
    """Copy a block's actions; those of finished teams and merged-away robots are zero."""
    n, size = actions.shape[1:]
    first = block * LANES
    given = actions[first : first + lanes].reshape(lanes, n * size)
    taken = scratch.action.reshape(n * size, LANES)
    for k in range(n * size):
        for lane in range(lanes):
            taken[k, lane] = given[lane, k]
    book = teams.book[block]
    for lane in range(lanes):
        running = book[STATUS * LANES + lane] == RUNNING
        if running and book[ACTIVE * LANES + lane] == n:
            continue
        for i in range(n):
            if not running or teams.merged_into[first + lane, i] != i:
                for k in range(size):
                    scratch.action[i, k * LANES + lane] = 0.0


@inlined_kernel
def _propose(block, lanes, physics, axes, span, teams, scratch):
    """The displacement of every robot, as if nothing were in its way."""
    for i in range(scratch.action.shape[0]):
        if physics.n_angles > 0:
            _propose_arcs(block, lanes, i, physics, len(axes), teams, scratch)
        else:
            velocity_displacements(
                span,
                scratch.action[i],
                teams.frames[block, i],
                physics.speed_limit,
                physics.duration,
                axes,
                scratch.displacement[i],
            )


@kernel
def _propose_arcs(block, lanes, i, physics, d, teams, scratch):
    action, out = scratch.action[i], scratch.displacement[i]
    arc = np.empty(d)
    for lane in range(lanes):
        team = block * LANES + lane
        speed = _clip(action[lane], physics.speed_limit)
        yaw_rate = _clip(action[LANES + lane], physics.yaw_rate_limit)
        yaw, pitch, pitch_rate = teams.angles[team, i, 0], 0.0, 0.0
        if physics.n_angles == 2:
            pitch = teams.angles[team, i, 1]
            pitch_rate = _clip(action[2 * LANES + lane], physics.pitch_rate_limit)
            action[2 * LANES + lane] = pitch_rate
        action[lane], action[LANES + lane] = speed, yaw_rate
        arc_displacement(speed, yaw, pitch, yaw_rate, pitch_rate, physics.duration, arc)
        for k in range(d):
            out[k * LANES + lane] = arc[k]
        out[d * LANES + lane] = abs(speed) * physics.duration


@kernel
def _clip(value, bound):
    return min(max(value, -bound), bound)


@inlined_kernel
def _advance(block, lanes, physics, axes, span, teams, results, scratch):
    """Carry out the displacements; teams in which something can meet go one by one."""
    first, tally = block * LANES, scratch.tally
    tally[:] = 0.0
    results.contact[first : first + lanes] = False
    _mark_near(block, physics, axes, span, teams, scratch)
    for lane in range(lanes):
        if tally[NEAR * LANES + lane] > 0.0:
            if teams.book[block, STATUS * LANES + lane] == RUNNING:
                _advance_exactly(block, lane, physics, len(axes), teams, results, scratch)
            else:  # nothing meets before an episode's first step or after its last
                tally[NEAR * LANES + lane] = 0.0
    for i in range(scratch.action.shape[0]):
        displacement, position = scratch.displacement[i], teams.positions[block, i]
        add_displacements(span, displacement, axes, position, tally[WAY * LANES :])


@inlined_kernel
def _mark_near(block, physics, axes, span, teams, scratch):
    """Mark teams where neighbours start within r + 2 v_max τ, or a robot within v_max τ of an
    obstacle.
    """
    reach = physics.speed_limit * physics.duration * (1.0 + 1e-9)
    square_reach = (physics.merge_radius * (1.0 + 1e-9) + 2.0 * reach) ** 2
    near = scratch.tally[NEAR * LANES :]
    mark_near_pairs(span, teams.book[block, SQUARE_CLOSEST * LANES :], square_reach, near)
    if physics.contact_mode != IGNORE:
        positions = teams.positions[block]
        for m in range(scratch.balls.shape[0]):
            for i in range(positions.shape[0]):
                mark_near_ball(span, positions[i], scratch.balls[m], reach + 1e-9, axes, near)


@kernel
def _advance_exactly(block, lane, physics, d, teams, results, scratch):
    """Move one team with swept contacts and merges."""
    n = scratch.action.shape[0]
    team = block * LANES + lane
    positions, weights = np.empty((n, d)), np.empty((n, n))
    displacements, lengths = np.empty((n, d)), np.empty(n)
    read_positions(block, lane, teams, positions)
    read_weights(block, lane, teams, weights)
    hindered = teams.obstacles.shape[1] > 0 and physics.contact_mode != IGNORE
    for i in range(n):
        for k in range(d):
            displacements[i, k] = scratch.displacement[i, k * LANES + lane]
        lengths[i] = scratch.displacement[i, d * LANES + lane]
        if teams.merged_into[team, i] == i and hindered:
            if _stay_outside(
                i, lane, team, physics, teams, scratch, positions[i], displacements[i]
            ):
                results.contact[team, i] = True
                scratch.tally[TOUCHES * LANES + lane] += 1.0
                lengths[i] = math.sqrt(np.sum(displacements[i] ** 2))
        scratch.took_part[lane, i] = teams.merged_into[team, i] == i
    report = np.zeros(4)
    merges = merge_swept(
        positions,
        displacements,
        lengths,
        weights,
        teams.merged_into[team],
        teams.obstacles[team],
        physics.merge_radius,
        report,
    )
    write_positions(block, lane, teams, positions)
    for i in range(n):
        scratch.displacement[i, d * LANES + lane] = lengths[i]
        for k in range(d):
            scratch.displacement[i, k * LANES + lane] = 0.0  # it has been moved
    if merges > 0:
        write_weights(block, lane, teams, weights)
        teams.book[block, ACTIVE * LANES + lane] -= merges
        scratch.tally[NEAR * LANES + lane] = 2.0
        for k in range(4):
            scratch.tally[(SCORED + LYAPUNOV_BEFORE_MERGE + k) * LANES + lane] = report[k]


@kernel
def _stay_outside(i, lane, team, physics, teams, scratch, start, displacement):
    """Replace a displacement by the one that obstacles leave; whether there was a contact."""
    obstacles = teams.obstacles[team]
    executed = np.empty(displacement.shape[0])
    if physics.n_angles == 0:
        contact = move_straight(start, displacement, obstacles, physics.contact_mode, executed)
    else:
        pitch, pitch_rate = 0.0, 0.0
        if physics.n_angles == 2:
            pitch, pitch_rate = teams.angles[team, i, 1], scratch.action[i, 2 * LANES + lane]
        contact = move_curved(
            start,
            scratch.action[i, lane],
            teams.angles[team, i, 0],
            pitch,
            scratch.action[i, LANES + lane],
            pitch_rate,
            physics.duration,
            obstacles,
            physics.contact_mode,
            executed,
        )
    displacement[:] = executed
    return contact


@kernel
def _turn(block, lanes, physics, teams, scratch):
    """Turn nonholonomic robots by their held rates."""
    for lane in range(lanes):
        team = block * LANES + lane
        for i in range(scratch.action.shape[0]):
            for k in range(physics.n_angles):
                rate = scratch.action[i, (1 + k) * LANES + lane]
                teams.angles[team, i, k] += rate * physics.duration
    _write_body_frames(block, lanes, physics, 1 + physics.n_angles, teams)


@kernel
def _write_body_frames(block, lanes, physics, d, teams):
    frame = np.empty((d, d))
    for lane in range(lanes):
        team = block * LANES + lane
        for i in range(teams.angles.shape[1]):
            pitch = teams.angles[team, i, 1] if physics.n_angles == 2 else 0.0
            body_frame(teams.angles[team, i, 0], pitch, frame)
            write_frame(block, lane, i, teams, frame)
