"""The first stage of a step, what every robot would do if nothing were in its way; and the fourth,
what robot models make of what has come of it.
"""

from ...compilation import inner_kernel
from ...obstacles.contact import STOP
from ...robots.motion import FREE, SLID, STOPPED, drifts, frame_of, propose, update_memory
from ..memory import RUNNING, in_lanes, lane_count, read, statistics_of, write


@inner_kernel(inline="text")
def load_actions(block, teams, actions, action):
    """Copy a block's actions, from (B, n, a) to (n, a, L); those of finished teams and of
    merged-away robots are zero.
    """
    given = actions[block.first : block.first + block.count]
    for i in range(given.shape[1]):
        for k in range(given.shape[2]):
            _load_number(given[:, i, k], action[i, k])
    _hold_still(block, teams, action)


@inner_kernel(inline="code")
def _load_number(given, action):
    """One number of one robot's action in every lane."""
    for lane in range(len(given)):
        action[lane] = given[lane]


@inner_kernel(inline="code")
def _hold_still(block, teams, values):
    """Make the numbers (n, k, L) of robots that do not move zero: all of a team that is not
    running, and those that have merged away.
    """
    statistics = statistics_of(teams, block.index)
    for lane in range(block.count):
        running = statistics.status[lane] == RUNNING
        if running and statistics.active[lane] == values.shape[0]:
            continue
        for i in range(values.shape[0]):
            if not running or teams.merged_into[block.first + lane, i] != i:
                for k in range(values.shape[1]):
                    values[i, k, lane] = 0.0


@inner_kernel(inline="code")
def propose_block(block, setup, teams, scratch):
    """The displacement of every robot over the step, and the length of its way."""
    frames, memory = teams.frames[block.index], teams.memory[block.index]
    for i in range(scratch.action.shape[0]):
        now = scratch.action[i], frames[i], memory[i]
        _propose_robot(setup.layout, setup.robot, now, scratch.displacement[i])
    if drifts(setup.robot.model):
        _hold_still(block, teams, scratch.displacement)


@inner_kernel(inline="code")
def _propose_robot(layout, robot, now, displacement):
    """One robot of every team, from its action, frame and memory."""
    action, frame, memory = now
    if not (
        in_lanes(action, layout) and in_lanes(frame, layout) and in_lanes(displacement, layout)
    ):
        return
    for lane in range(lane_count(layout.width)):
        moved, length = propose(
            robot.model,
            read(action, lane, robot.inputs),
            read(frame, lane, layout.entries),
            read(memory, lane, robot.memories),
        )
        write(moved, displacement, lane)
        displacement[len(layout.axes), lane] = length


@inner_kernel(inline="code")
def turn_block(block, setup, memories, teams, contact, scratch):
    """What the robot models keep, brought up to the end of the step, and the frames with it;
    ``memories`` are the robot's, by themselves: without any nothing is compiled.
    """
    if len(memories) > 0:
        layout, robot = setup.layout, setup.robot
        statistics = statistics_of(teams, block.index)
        met = STOPPED if setup.constants.contact_mode == STOP else SLID
        for i in range(scratch.action.shape[0]):
            frames, memory = teams.frames[block.index, i], teams.memory[block.index, i]
            for lane in range(block.count):
                if statistics.status[lane] == RUNNING:
                    frame = read(frames, lane, layout.entries)
                    after = update_memory(
                        robot.model,
                        read(scratch.action[i], lane, robot.inputs),
                        frame,
                        read(memory, lane, memories),
                        read(scratch.displacement[i], lane, layout.axes),
                        met if contact[block.first + lane, i] else FREE,
                    )
                    write(after, memory, lane)
                    write(frame_of(robot.model, frame, after), frames, lane)


@inner_kernel(inline="code")
def update_frames(block, setup, memories, teams):
    """Frames from what the robot models keep; arguments as ``turn_block``."""
    if len(memories) > 0:
        for i in range(teams.frames.shape[1]):
            frames, memory = teams.frames[block.index, i], teams.memory[block.index, i]
            for lane in range(block.count):
                frame = read(frames, lane, setup.layout.entries)
                kept = read(memory, lane, memories)
                write(frame_of(setup.robot.model, frame, kept), frames, lane)
