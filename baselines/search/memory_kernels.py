"""Kernels for the memory of a searching unicycle, dead-reckoned by its own commands.

Lengths are in units of the merge radius r, times in units of r/v_max, directions in the body frame.
"""

import math
from typing import NamedTuple

import numpy as np

from rendezvous_env.compilation import inner_kernel, kernel

SCALES = (0.5, 2.0, 8.0)
"""Time constants of the averages, r/v_max."""
HARMONICS = 3
_J, _H = len(SCALES), HARMONICS
FIELDS = {
    "since": (1,), "counts": (_J,), "seen": (_J, _H, 2), "durations": (_J,), "looked": (_J, _H, 2),
    "inputs": (_J, 2), "last": (2,), "place": (2,), "start": (2,), "unseen": (1,), "turned": (1,),
    "varied": (1,), "met": (1,), "command": (2,),
}  # fmt: skip
"""Memory of a robot.

Time since its first step. For each time constant T, averages with weights e^(−age/T): the number of
visible robots, the sums of e^(ikφ) over their bearings φ for k = 1 to 3, 1, e^(ikφ) of the robot's
own axis, and speed and turn rate. Of the last sight of a robot: direction of f, place, time since,
rotation since, rad, a number in [−1, 1) that varies with the direction, and whether there was one.
The place of the first step. Speed and turn rate of the last step, m/s and rad/s.
"""
_SIZES = [math.prod(shape) for shape in FIELDS.values()]
(
    _SINCE, _COUNTS, _SEEN, _DURATIONS, _LOOKED, _INPUTS, _LAST, _PLACE, _START, _UNSEEN, _TURNED,
    _VARIED, _MET, _COMMAND,
) = (sum(_SIZES[:k]) for k in range(len(_SIZES)))  # fmt: skip
EDGES = 6
"""Memory of an obstacle: both edges, x and y each; distance driven since, r; 1, or 0 if none."""
NEIGHBOUR_COLUMNS, OBSTACLE_COLUMNS = 3, 6
"""Features of a neighbour: bearing x, y; weight. Of an obstacle: both edges; distance driven since
they were visible, r; 1 if they are."""
PERIODS = (6.0, 20.0)
"""Periods, r/v_max, of a clock that runs while no robot is in view."""
COLUMNS = 1 + _J * (4 * _H + 3) + 17 + 2 * len(PERIODS)
"""Number of context features."""
_SLIGHT = 0.02  # number of robots or duration below which an average of directions fades
_VARIATION = 40.0  # cycles of ``varied`` per rad of the last bearing
_STRAIGHT = 1e-6  # rad, of a step whose arc is its tangent


class Body(NamedTuple):
    """Quantities of a robot for kernels."""

    neighbour_slots: int
    merge_radius: float  # m
    speed: float  # m/s
    turn_rate: float  # rad/s
    tau: float  # s

    @property
    def time_unit(self) -> float:
        """r/v_max, s."""
        return self.merge_radius / self.speed


@inner_kernel
def _turn_pair(memory, place, c, s):
    """Rotate a pair of the memory by an angle with this cosine and sine."""
    x, y = memory[place], memory[place + 1]
    memory[place], memory[place + 1] = c * x - s * y, s * x + c * y


@inner_kernel
def _notice(memory, edges, rows, elapsed, body):
    """Add the rows of a robot, (rows, 2), to its memory; ``elapsed`` is in r/v_max."""
    K, f_x, f_y, count = body[0], 0.0, 0.0, 0
    for j in range(_J):
        weight = 1.0 - math.exp(-elapsed / SCALES[j])
        memory[_DURATIONS + j] += weight
        for k in range(_H):
            memory[_LOOKED + 2 * (j * _H + k)] += weight
    for slot in range(K):
        x, y = np.float64(rows[slot, 0]), np.float64(rows[slot, 1])
        length = math.sqrt(x * x + y * y)
        if length == 0.0:
            continue
        count += 1
        f_x += x
        f_y += y
        x, y = x / length, y / length
        for j in range(_J):
            weight = 1.0 - math.exp(-elapsed / SCALES[j])
            memory[_COUNTS + j] += weight
            c, s = x, y
            for k in range(_H):
                place = _SEEN + 2 * (j * _H + k)
                memory[place] += weight * c
                memory[place + 1] += weight * s
                c, s = c * x - s * y, s * x + c * y
    if count > 0:
        _note_sight(memory, f_x, f_y)
    for m in range(edges.shape[0]):
        row = K + 2 * m
        if rows[row, 0] != 0.0 or rows[row, 1] != 0.0:
            edges[m, 0], edges[m, 1] = rows[row, 0], rows[row, 1]
            edges[m, 2], edges[m, 3] = rows[row + 1, 0], rows[row + 1, 1]
            edges[m, 4], edges[m, 5] = 0.0, 1.0


@inner_kernel
def _note_sight(memory, f_x, f_y):
    """Begin the memory of a sight with net bearing f."""
    strength = math.sqrt(f_x * f_x + f_y * f_y)
    if strength > 0.0:
        memory[_LAST], memory[_LAST + 1] = f_x / strength, f_y / strength
    cycles = _VARIATION * math.atan2(f_y, f_x)
    memory[_VARIED] = 2.0 * (cycles - math.floor(cycles)) - 1.0
    memory[_PLACE] = memory[_PLACE + 1] = memory[_UNSEEN] = memory[_TURNED] = 0.0
    memory[_MET] = 1.0


@inner_kernel
def _dead_reckon(memory, edges, duration, body):
    """Move the memory by the last command, held for a duration, s; negative to undo it."""
    _, r, fastest, limit, _ = body
    speed, rate = memory[_COMMAND], memory[_COMMAND + 1]
    time, angle = duration * fastest / r, rate * duration
    c, s = math.cos(angle), math.sin(-angle)
    for j in range(_J):
        kept = math.exp(-time / SCALES[j])
        memory[_COUNTS + j] *= kept
        memory[_DURATIONS + j] *= kept
        place = _INPUTS + 2 * j
        memory[place] = kept * memory[place] + (1.0 - kept) * speed / fastest
        memory[place + 1] = kept * memory[place + 1] + (1.0 - kept) * rate / limit
        kc, ks = kept * c, kept * s
        for k in range(_H):
            _turn_pair(memory, _SEEN + 2 * (j * _H + k), kc, ks)
            _turn_pair(memory, _LOOKED + 2 * (j * _H + k), kc, ks)
            kc, ks = kc * c - ks * s, ks * c + kc * s
    ahead, aside = speed * duration, 0.5 * speed * duration * angle
    if abs(angle) > _STRAIGHT:
        ahead, aside = speed / rate * math.sin(angle), speed / rate * (1.0 - math.cos(angle))
    for place in (_PLACE, _START):
        memory[place] -= ahead / r
        memory[place + 1] -= aside / r
        _turn_pair(memory, place, c, s)
    _turn_pair(memory, _LAST, c, s)
    memory[_SINCE] += time
    memory[_UNSEEN] += time
    memory[_TURNED] += angle
    for m in range(edges.shape[0]):
        _turn_pair(edges[m], 0, c, s)
        _turn_pair(edges[m], 2, c, s)
        edges[m, 4] += abs(speed) * duration / r
        if edges[m, 4] >= 1.0:
            edges[m] = 0.0


@kernel
def command(part, observations, inputs, body, memories, elapsed, actions):
    """Write inputs (B, n, 2), m/s and rad/s, as actions, and update the memory.

    ``memories`` are those of robots, (B, n, size), and of obstacles, (B, n, M, EDGES). They take in
    the observations, (B, n, rows, 2), ``elapsed`` s after the previous ones, and are moved by a
    step of τ.
    """
    memory, edges = memories
    for team in range(part[0], part[1]):
        for i in range(observations.shape[1]):
            own, around = memory[team, i], edges[team, i]
            _notice(own, around, observations[team, i], elapsed * body[2] / body[1], body)
            for axis in range(2):
                own[_COMMAND + axis] = actions[team, i, axis] = inputs[team, i, axis]
            _dead_reckon(own, around, body[4], body)


@kernel
def move_memory(memories, duration, body):
    """Move all memories by the last commands, held for a duration, s; negative to undo it."""
    memory, edges = memories
    for team in range(memory.shape[0]):
        for i in range(memory.shape[1]):
            _dead_reckon(memory[team, i], edges[team, i], duration, body)


@kernel
def show_memory(part, teams, observations, memories, body, slots, shown):
    """Fill the features (B, n, size) of some environments, ``part`` of ``teams``.

    ``slots`` are those of neighbours and of obstacles in the features.
    """
    memory, edges = memories
    K = body[0]
    first = slots[0] * NEIGHBOUR_COLUMNS
    for place in range(part[0], part[1]):
        team = teams[place]
        for i in range(observations.shape[1]):
            rows, out = observations[team, i], shown[team, i]
            out[:] = 0.0
            count, f_x, f_y = 0, 0.0, 0.0
            for slot in range(K):
                x, y = np.float64(rows[slot, 0]), np.float64(rows[slot, 1])
                length = math.sqrt(x * x + y * y)
                if length > 0.0:
                    column = slot * NEIGHBOUR_COLUMNS
                    out[column], out[column + 1] = x / length, y / length
                    out[column + 2] = length
                    count, f_x, f_y = count + 1, f_x + x, f_y + y
            for m in range(edges.shape[2]):
                row, column = K + 2 * m, first + m * OBSTACLE_COLUMNS
                known = edges[team, i, m]
                if rows[row, 0] != 0.0 or rows[row, 1] != 0.0:
                    out[column], out[column + 1] = rows[row, 0], rows[row, 1]
                    out[column + 2], out[column + 3] = rows[row + 1, 0], rows[row + 1, 1]
                    out[column + 5] = 1.0
                elif known[5] > 0.0:
                    for k in range(5):
                        out[column + k] = known[k]
            context = out[first + slots[1] * OBSTACLE_COLUMNS :]
            _show_context(memory[team, i], (count, f_x, f_y), body, context)


@inner_kernel
def _show_context(memory, now, body, out):
    """Write the features of a memory and of the net bearing now."""
    count, f_x, f_y = now
    out[0], column = 1.0, 1
    for j in range(_J):
        seen, lasted = memory[_COUNTS + j], memory[_DURATIONS + j]
        out[column], out[column + 1] = 0.25 * math.log1p(50.0 * seen), memory[_INPUTS + 2 * j]
        out[column + 2] = memory[_INPUTS + 2 * j + 1]
        column += 3
        for k in range(2 * _H):
            place = 2 * _H * j + k
            out[column + k] = memory[_SEEN + place] / (seen + _SLIGHT)
            out[column + 2 * _H + k] = memory[_LOOKED + place] / (lasted + _SLIGHT)
        column += 4 * _H
    strength, sees = math.sqrt(f_x * f_x + f_y * f_y), count > 0
    out[column], out[column + 1] = memory[_LAST], memory[_LAST + 1]
    if sees and strength > 0.0:
        out[column], out[column + 1] = f_x / strength, f_y / strength
    unseen = 0.0 if sees else memory[_UNSEEN]
    for k in range(2):
        out[column + 2 + k] = 0.0 if sees else math.tanh(0.25 * memory[_PLACE + k])
        out[column + 4 + k] = math.tanh(0.1 * memory[_START + k])
    had = sees or memory[_MET] > 0.0
    for k in range(3):
        out[column + 6 + k] = math.exp(-unseen / (0.7 * 4.0**k)) if had else 0.0
        out[column + 9 + k] = math.exp(-memory[_SINCE] / (1.5 * 3.0**k))
    out[column + 12] = 0.0 if sees else math.tanh(memory[_TURNED] / 6.0)
    out[column + 13], out[column + 14] = memory[_VARIED], 1.0 if had else 0.0
    out[column + 15] = memory[_COMMAND] / body[2]
    out[column + 16] = memory[_COMMAND + 1] / body[3]
    for k in range(len(PERIODS)):
        phase = 2.0 * math.pi * unseen / PERIODS[k]
        out[column + 17 + 2 * k] = 0.0 if sees else math.sin(phase)
        out[column + 18 + 2 * k] = 0.0 if sees else math.cos(phase)
