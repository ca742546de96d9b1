"""Stage that proposes the motion of every robot, and applies it where no contact is possible.

Also the update of robot model memory and frames after the step.
"""

from ...compilation import inner_kernel, kernel
from ...obstacles.contact import STOP
from ...robots.motion import FREE as UNTOUCHED
from ...robots.motion import (
    SLID,
    STOPPED,
    constants_of_robot,
    for_member,
    frame_of,
    is_steady,
    propose,
    update_memory,
)
from ..memory import (
    ACTIVE,
    CLOSENESS,
    FREE,
    MERGE_EXCESS,
    MERGE_RISE,
    MOVED,
    PROXIMITY,
    RUNNING,
    STATUS,
    STEP_CONTACTS,
    STEP_LENGTH,
    is_near,
    lane_count,
    load_fields,
    store_fields,
)


@kernel
def propose_motion(
    width, robot, first, last, reach, robots, merged_into, environments, moves, actions
):
    """Write displacement (d), path length, and action (a) of every robot of some blocks.

    The output is ``moves``, (blocks, n, (d + 1 + a)·L). Environments with possible contact (see
    ``is_near``) are marked, and wait for the exact stages. Robots of all others move.

    Actions are (B, n, a), or (0, n, a) if ``moves`` has them already; those of ended environments
    and of merged robots count as zero.
    """
    lanes, d, n = lane_count(width), len(robot.axes), robots.shape[1]
    for block in range(first, last):
        start, move, environment = block * lanes, moves[block - first], environments[block]
        count = min(lanes, len(merged_into) - start)
        for i in range(n):
            load_actions(width, robot, i, start, actions, move[i])
        for i in range(n):
            model = constants_of_robot(robot.model, robot.limits, i)
            for_member(model, _propose_robot, (width, robot, robots[block, i], move[i]))
        _hold_still(width, move, count, start, environment, merged_into)
        _begin_step(width, reach, environment)
        for i in range(n):
            _advance_robot(width, d, move[i], environment, robots[block, i])


@inner_kernel(inline="code")
def load_actions(width, robot, i, start, actions, move):
    """Copy the actions of robot i, (B, n, a), from environment ``start`` on to its motion."""
    lanes, d = lane_count(width), len(robot.axes)
    given = actions[start : min(start + lanes, len(actions))]
    for k in range(len(robot.inputs)):
        values = given[:, i, k]
        for lane in range(min(lanes, len(values))):  # at most a constant
            move[(d + 1 + k) * lanes + lane] = values[lane]


@inner_kernel(inline="code")
def _propose_robot(model, given):
    """Propose the motion of a robot in every lane, from the action in its fields."""
    width, robot, state, move = given
    lanes, d = lane_count(width), len(robot.axes)
    for lane in range(lanes):
        moved, length = propose(
            model,
            load_fields(move, d + 1, lane, lanes, robot.inputs),
            load_fields(state, d, lane, lanes, robot.entries),
            load_fields(state, d + d * d, lane, lanes, robot.memories),
        )
        store_fields(moved, move, 0, lane, lanes)
        move[d * lanes + lane] = length


@inner_kernel
def _hold_still(width, move, count, start, environment, merged_into):
    """Zero the motion and action of robots that do not move.

    These are merged robots, and all robots of an environment that is not running.
    """
    lanes, n, moving = lane_count(width), move.shape[0], 0
    for lane in range(lanes):
        running = environment[STATUS * lanes + lane] == RUNNING
        moving += running & (environment[ACTIVE * lanes + lane] == n)
    for lane in range(count if moving < lanes else 0):
        running = environment[STATUS * lanes + lane] == RUNNING
        if running and environment[ACTIVE * lanes + lane] == n:
            continue
        for i in range(n):
            if not running or merged_into[start + lane, i] != i:
                for k in range(lane, move.shape[1], lanes):
                    move[i, k] = 0.0


@inner_kernel(inline="code")
def _begin_step(width, reach, environment):
    """Initialise the fields of the step."""
    lanes = lane_count(width)
    for lane in range(lanes):
        near = is_near(environment, lane, lanes, reach)
        environment[PROXIMITY * lanes + lane] = MOVED if near else FREE
        environment[STEP_LENGTH * lanes + lane] = 0.0
        environment[STEP_CONTACTS * lanes + lane] = 0.0
        environment[CLOSENESS * lanes + lane] = 0.0
        environment[MERGE_RISE * lanes + lane] = 0.0
        environment[MERGE_EXCESS * lanes + lane] = 0.0


@inner_kernel(inline="code")
def _advance_robot(width, d, move, environment, state):
    """Apply a displacement where no contact is possible, and add up its path length."""
    lanes = lane_count(width)
    for k in range(d):
        for lane in range(lanes):
            # selection instead of a branch keeps it SIMD
            free = environment[PROXIMITY * lanes + lane] == FREE
            state[k * lanes + lane] += move[k * lanes + lane] if free else 0.0
    for lane in range(lanes):
        environment[STEP_LENGTH * lanes + lane] += move[d * lanes + lane]


@kernel
def update_robots(
    width, robot, first, last, mode, robots, merged_into, environments, moves, contact
):
    """Update memory and frames of robot models at the end of the step."""
    lanes = lane_count(width)
    for block in range(first, last):
        touched = contact[block * lanes : block * lanes + lanes]
        for i in range(robots.shape[1]):
            model = constants_of_robot(robot.model, robot.limits, i)
            if not is_steady(model):
                fields = environments[block], robots[block, i], moves[block - first, i]
                for_member(model, _update_robot, (width, robot, mode, *fields, touched[:, i]))


@inner_kernel(inline="code")
def _update_robot(model, given):
    """Update memory and frame of a robot in the lanes of running environments."""
    width, robot, mode, environment, state, move, touched = given
    lanes, d = lane_count(width), len(robot.axes)
    met = STOPPED if mode == STOP else SLID
    for lane in range(len(touched)):
        running = environment[STATUS * lanes + lane] == RUNNING
        frame = load_fields(state, d, lane, lanes, robot.entries)
        before = load_fields(state, d + d * d, lane, lanes, robot.memories)
        after = update_memory(
            model,
            load_fields(move, d + 1, lane, lanes, robot.inputs),
            frame,
            before,
            load_fields(move, 0, lane, lanes, robot.axes),
            met if touched[lane] else UNTOUCHED,
        )
        turned = frame_of(model, frame, after)
        # selection instead of a branch keeps it SIMD
        _store_if(running, after, before, state, d + d * d, lane, lanes)
        _store_if(running, turned, frame, state, d, lane, lanes)


@inner_kernel(inline="code")
def _store_if(condition, values, before, fields, first, lane, lanes):
    """Store values where a condition holds, else what was there before."""
    for k in range(len(values)):
        fields[(first + k) * lanes + lane] = values[k] if condition else before[k]


@kernel
def refresh_frames(robot, lanes, first, last, robots):
    """Recompute frames from robot model memory in environments that do not move."""
    d = len(robot.axes)
    for block in range(first, last):
        for i in range(robots.shape[1]):
            state, model = robots[block, i], constants_of_robot(robot.model, robot.limits, i)
            for lane in range(lanes):
                frame = load_fields(state, d, lane, lanes, robot.entries)
                kept = load_fields(state, d + d * d, lane, lanes, robot.memories)
                store_fields(frame_of(model, frame, kept), state, d, lane, lanes)
