"""The first stage of a step: what every robot would do if nothing were in its way."""

from ..compilation import inlined_kernel
from ..equations.contact import STOP
from ..equations.robots.motion import FREE, SLID, STOPPED, drifts, frame_of, propose, remember
from .memory import ACTIVE, RUNNING, STATUS, lane_count, read, write


@inlined_kernel
def load_actions(block, count, layout, teams, actions, buffers):
    """Copy a block's actions; those of finished teams and merged-away robots are zero."""
    first = block * lane_count(layout.width)
    given = actions[first : first + count]
    for k in range(given.shape[1]):
        for lane in range(given.shape[0]):
            buffers.taken[k, lane] = given[lane, k]
    size = actions.shape[1] // buffers.action.shape[0]
    _hold_still(block, count, size, layout, teams, buffers.action)


@inlined_kernel
def _hold_still(block, count, parts, layout, teams, values):
    """Make the first ``parts`` numbers of robots that do not move zero: all of a team that is not
    running, and those that have merged away.
    """
    lanes, statistics = lane_count(layout.width), teams.statistics[block]
    for lane in range(count):
        running = statistics[STATUS * lanes + lane] == RUNNING
        if running and statistics[ACTIVE * lanes + lane] == values.shape[0]:
            continue
        for i in range(values.shape[0]):
            if not running or teams.merged_into[block * lanes + lane, i] != i:
                for k in range(parts):
                    values[i, k * lanes + lane] = 0.0


@inlined_kernel
def propose_block(block, count, layout, robot, teams, buffers):
    """The displacement of every robot over the step, and the length of its way."""
    d, lanes = len(layout.axes), lane_count(layout.width)
    for i in range(buffers.action.shape[0]):
        action, out = buffers.action[i], buffers.displacement[i]
        frames, memory = teams.frames[block, i], teams.memory[block, i]
        for lane in range(lanes):
            displacement, length = propose(
                robot.model,
                read(action, lane, layout.width, robot.inputs),
                read(frames, lane, layout.width, layout.entries),
                read(memory, lane, layout.width, robot.memories),
            )
            write(displacement, out, 0, lane, layout.width)
            out[d * lanes + lane] = length
    if drifts(robot.model):
        _hold_still(block, count, d + 1, layout, teams, buffers.displacement)


@inlined_kernel
def turn_block(block, count, layout, constants, robot, memories, teams, results, buffers):
    """What the robot models keep, brought up to the end of the step, and the frames with it.

    Args:
        block: which one.
        count: teams in it.
        layout: of the memory.
        constants: of the scenario.
        robot: its model.
        memories: of the robot, by itself: without any nothing is compiled.
        teams: state.
        results: gives the contacts.
        buffers: gives actions and displacements.
    """
    if len(memories) > 0:
        lanes, width = lane_count(layout.width), layout.width
        met = STOPPED if constants.contact_mode == STOP else SLID
        for i in range(buffers.action.shape[0]):
            frames, memory = teams.frames[block, i], teams.memory[block, i]
            for lane in range(count):
                if teams.statistics[block, STATUS * lanes + lane] == RUNNING:
                    frame = read(frames, lane, width, layout.entries)
                    after = remember(
                        robot.model,
                        read(buffers.action[i], lane, width, robot.inputs),
                        frame,
                        read(memory, lane, width, memories),
                        read(buffers.displacement[i], lane, width, layout.axes),
                        met if results.contact[block * lanes + lane, i] else FREE,
                    )
                    write(after, memory, 0, lane, width)
                    write(frame_of(robot.model, frame, after), frames, 0, lane, width)


@inlined_kernel
def bring_frames_up(block, count, layout, robot, memories, teams):
    """Frames from what the robot models keep; arguments as ``turn_block``."""
    if len(memories) > 0:
        width = layout.width
        for i in range(teams.frames.shape[1]):
            frames, memory = teams.frames[block, i], teams.memory[block, i]
            for lane in range(count):
                frame = read(frames, lane, width, layout.entries)
                kept = read(memory, lane, width, memories)
                write(frame_of(robot.model, frame, kept), frames, 0, lane, width)
