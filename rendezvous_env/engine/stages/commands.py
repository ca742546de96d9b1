"""Stage before ``propose_motion``: the commands that robots execute, by their clocks.

It is called only in scenarios with ``activation``. A robot that is active takes its action as its
command; any other one keeps its command, or stands still.
"""

from ...compilation import inner_kernel, kernel
from ...graphs.edges import load_links
from ...physics.potential import net_bearings_of_links
from ...physics.random_streams import ACTIVATION, stream_key
from ...physics.vectors import dot
from ...robots.activation import is_adversarial, is_scheduled
from ...robots.motion import propose
from ..memory import RUNNING, STATUS, STEPS, load_fields, load_positions


@kernel
def take_commands(
    robot,
    lanes,
    first,
    last,
    rules,
    streams,
    robots,
    merged_into,
    environments,
    links,
    clocks,
    vectors,
    listed,
    weights,
    actions,
):
    """Write the commands of all robots of some blocks, from actions, (B, n, a), and those before.

    ``clocks`` are the commands, (B, n, a); the step of each robot's last activation, (B, n), −1
    before the first; and whether it is active in this step, (B, n). ``streams`` are the seeds and
    episodes, (B,). Working memory: vectors (3, n, d), listed (2, E), weights (E,). To call it again
    in the same step, with other actions, gives the same as to call it once.
    """
    (seeds, episodes), n = streams, robots.shape[1]
    commands, last_step, activated = clocks
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            b, now = block * lanes + lane, environments[block]
            running = now[STATUS * lanes + lane] == RUNNING
            if running and is_adversarial(rules):
                load_positions(robots[block], lane, lanes, vectors[0])
                found = load_links(links, block, lane, n, listed[0], listed[1], weights)
                edges = listed[0, :found], listed[1, :found], weights[:found]
                net_bearings_of_links(vectors[0], edges, vectors[1])
            key, step = (
                stream_key(seeds[b], episodes[b], ACTIVATION),
                int(now[STEPS * lanes + lane]),
            )
            for i in range(n):
                activated[b, i] = False
                if not running or merged_into[b, i] != i:
                    continue
                command, action, before = commands[b, i], actions[b, i], last_step[b, i]
                due = is_scheduled(rules, key, step, step - before - 1, i) or before == step
                if is_adversarial(rules) and not due:
                    state, net_bearing = robots[block, i], vectors[1, i]
                    gain = _work(robot, lanes, lane, state, action, net_bearing)
                    kept = 0.0
                    if not rules.stops:
                        kept = _work(robot, lanes, lane, state, command, net_bearing)
                    due = gain < kept
                if due:
                    activated[b, i], last_step[b, i] = True, step
                for k in range(len(command)):
                    if due:
                        command[k] = action[k]
                    elif rules.stops:
                        command[k] = 0.0


@inner_kernel
def _work(robot, lanes, lane, state, action, net_bearing):
    """f_i · Δ_i of an action, m²/s: half of the rate at which it lowers V."""
    d, given = len(robot.axes), action
    moved, _ = propose(
        robot.model,
        _as_tuple(given, robot.inputs),
        load_fields(state, d, lane, lanes, robot.entries),
        load_fields(state, d + d * d, lane, lanes, robot.memories),
    )
    return dot(moved, _as_tuple(net_bearing, robot.axes))


@inner_kernel(inline="code")
def _as_tuple(values, parts):
    """An array as a tuple, as long as ``parts``."""
    if len(parts) == 1:
        return (values[0],)
    if len(parts) == 2:
        return values[0], values[1]
    if len(parts) == 3:
        return values[0], values[1], values[2]
    return values[0], values[1], values[2], values[3]
