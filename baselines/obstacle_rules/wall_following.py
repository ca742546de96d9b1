"""Round walls under an energy tank: keep to one side, and turn back when it costs too much.

Kernels over robots in the plane. A robot's memory is a row of numbers, see MEMORY.
"""

import math
from typing import NamedTuple

import numpy as np

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.vectors import combine, dot, load, split, store
from rendezvous_env.safety.tank import certain_descent, descent_scale, promised_descent

from .merged_silhouettes_2d import TWO_PI, joined_interval_2d

SIDE, HEADING_X, HEADING_Y, WORK, PATIENCE, SHORT = range(6)
MEMORY = 6
"""Numbers in a robot's memory: the side on which it passes what blocks f (1 counter-clockwise, −1
clockwise, 0 nothing blocks f); its heading; ∫ f·v dt since it met the wall, m²/s; over ‖f‖ how far
that may fall before it turns back, m; whether its tank was too low for the step before."""

_JUMP = 1.5
"""rad; an edge so far from the heading is another wall's."""
_LOST = 2.4
"""rad; farther round than this no wall is felt for."""
_BEHIND_EDGE = 0.9
"""Of the clearance: how far beside the heading the wall is felt for."""
_LARGEST_PATIENCE = 1e3
"""m."""
_REST_TIME = 30.0
"""For so long must the tank last at rest after any step that costs something, s."""


class Settings(NamedTuple):
    """What wall followers share."""

    clearance: float
    """Angle by which to stay clear of an edge, rad."""
    patience: float
    """How far back a first try may lead, m; each turn doubles it."""
    min_alignment: float
    """ε of the tank."""
    merge_radius: float
    """r, m."""
    duration: float
    """τ, s."""
    speed_limit: float
    """v_max, m/s."""


@kernel(allocates=True)
def wall_following_wishes(net_bearing, degrees, silhouettes, levels, settings, memory, out):
    """Wished velocities: along f where nothing blocks it, else along the wall.

        vᵢ = sᵢ ‖fᵢ‖ hᵢ                                                            (guarantees 8)

    A robot rests where its tank would not last, and turns back after that.

    Args:
        net_bearing: fᵢ, (N, 2), m/s.
        degrees: Dᵢ, (N,), m/s.
        silhouettes: (N, M, 2, 2), counter-clockwise edge, then clockwise edge.
        levels: Aᵢ, (N,), m²/s.
        settings: a Settings.
        memory: (N, MEMORY), changed.
        out: (N, 2), m/s.
    """
    intervals = np.empty((silhouettes.shape[1], 2))
    for i in range(out.shape[0]):
        f = load(net_bearing[i])
        strength, towards = split(f)
        memory[i, SHORT], short = 0.0, memory[i, SHORT] > 0.0
        if strength == 0.0:
            out[i, :] = 0.0
            continue
        free, turn = _turn(towards, strength, short, silhouettes[i], settings, memory[i], intervals)
        heading = _turned(towards, turn)
        memory[i, HEADING_X], memory[i, HEADING_Y] = heading[0], heading[1]
        velocity = _affordable(f, degrees[i], levels[i], heading, free, settings, memory[i])
        store(velocity, out[i])


@kernel
def _turn(towards, strength, short, silhouettes, settings, memory, intervals):
    """Whether any direction is free, and the angle from f to the heading, rad."""
    joined = joined_interval_2d(towards, silhouettes, intervals)
    low, high = joined[0], joined[1]
    clearance = settings.clearance
    if high - low >= TWO_PI:
        return False, 0.0
    if low >= clearance or high <= -clearance:
        if memory[WORK] >= 0.0:
            memory[PATIENCE] = settings.patience
        memory[SIDE] = 0.0
        return True, 0.0
    kept = _kept_angle(towards, memory)
    held = memory[SIDE]
    _choose_side(joined, strength, short, memory)
    side = memory[SIDE]
    edge, gap = _edge(joined, side)
    if held == side and abs(_wrapped(edge - kept)) > _JUMP:
        edge, gap = _along_wall(towards, kept, edge, gap, silhouettes, settings, side, intervals)
    return True, edge + side * min(clearance, 0.5 * gap)


@kernel
def _choose_side(joined, strength, short, memory):
    """Take the nearer edge at first; the other side once work or tank are spent."""
    if memory[SIDE] == 0.0:
        memory[SIDE] = 1.0 if abs(joined[1]) <= abs(joined[0]) else -1.0
        memory[WORK] = 0.0
    elif short or memory[WORK] < -memory[PATIENCE] * strength:
        memory[SIDE] = -memory[SIDE]
        memory[PATIENCE] = min(2.0 * memory[PATIENCE], _LARGEST_PATIENCE)


@kernel
def _along_wall(towards, kept, edge, gap, silhouettes, settings, side, intervals):
    """Edge of the wall beside the heading, rad from f, and the gap beyond; else as given."""
    feeler = kept - side * _BEHIND_EDGE * settings.clearance
    felt = joined_interval_2d(_turned(towards, feeler), silhouettes, intervals)
    if felt[1] - felt[0] >= TWO_PI:
        return edge, gap
    nearest, beyond = _edge(felt, side)
    other, before = _edge(felt, -side)
    if side * other > 0.0:  # nearest is one on the far side: the wall lies before it
        nearest, beyond = other - side * before, before
    if side * nearest < -_LOST:
        return edge, gap
    return feeler + nearest, beyond


@kernel
def _edge(joined, side):
    """The edge of a joined interval on a side, and the free angle beyond it, rad."""
    if side > 0.0:
        return joined[1], joined[3]
    return joined[0], joined[2]


@kernel
def _affordable(f, degree, level, heading, free, settings, memory):
    """The velocity along a heading, or rest where the tank would not last."""
    strength, towards = split(f)
    r, duration = settings.merge_radius, settings.duration
    scale = descent_scale(strength, degree, r, duration, settings.speed_limit)
    speed = scale * strength
    moved = combine(speed * duration, heading, 0.0, heading)
    owed = promised_descent(strength, scale, settings.min_alignment, duration)
    deposit = certain_descent(f, degree, moved, r) - owed
    reserve = owed * _REST_TIME / duration
    if free and (deposit >= 0.0 or level + deposit >= reserve):
        return combine(speed, heading, 0.0, heading)
    memory[SHORT] = 1.0
    if level >= owed:
        return 0.0, 0.0, 0.0
    # law (4) will drive it: then as little as can be, and away from the wall
    across = towards[0] * heading[1] - towards[1] * heading[0]
    turn = math.copysign(math.acos(settings.min_alignment), across)
    return combine(speed, _turned(towards, turn), 0.0, heading)


@kernel
def _kept_angle(towards, memory):
    """Angle from f to the heading of the step before, rad; 0 if there is none."""
    before = memory[HEADING_X], memory[HEADING_Y], 0.0
    across = towards[0] * before[1] - towards[1] * before[0]
    return math.atan2(across, dot(towards, before))


@kernel
def _turned(direction, angle):
    """A direction of the plane turned counter-clockwise, as a triple."""
    c, s = math.cos(angle), math.sin(angle)
    return c * direction[0] - s * direction[1], s * direction[0] + c * direction[1], 0.0


@kernel
def _wrapped(angle):
    """The same angle in [−π, π)."""
    return angle - TWO_PI * math.floor((angle + math.pi) / TWO_PI)
