"""Walls are followed: kernels over robots of the joined rule under an energy tank.

A robot passes what blocks f on one side and turns back when that costs too much; in space it does
so in a plane that holds f (``planes_in_space``).
"""

import math
from typing import NamedTuple

import numpy as np

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.vectors import (
    ORIGIN,
    X_AXIS,
    combine,
    cross,
    dot,
    load,
    norm,
    scaled,
    split,
    store,
)
from rendezvous_env.safety.tank import certain_descent, descent_scale, promised_descent
from rendezvous_env.safety.turning import Gate, mean_axis, send_rates

from ..steering import inputs_towards
from .merged_silhouettes_2d import TWO_PI, joined_interval_2d
from .planes_in_space import kept_azimuth, widened_rays
from .turning_robots import axis_is_clear, axis_is_clear_3d

SIDE, HEADING_X, HEADING_Y, WORK, PATIENCE, SHORT = range(6)
MEMORY = 6
"""Numbers in a robot's memory: the side on which it passes what blocks f (1 counter-clockwise, −1
clockwise, 0 nothing blocks f); its heading; ∫ f·v dt since it met the wall, m²/s; over ‖f‖ how far
that may fall before it turns back, m; whether its tank was too low for the step before."""
HEADING, ASIDE = MEMORY, MEMORY + 3
MEMORY_IN_SPACE = MEMORY + 6
"""In space that heading is counted in a plane that holds f; its heading in its own frame follows,
and the unit vector across f of that plane."""

_JUMP = 1.5
"""rad; an edge so far from the heading is another wall's."""
_LOST = 2.4
"""rad; farther round than this no wall is felt for."""
_BEHIND_EDGE = 0.9
"""Of the clearance: how far beside the heading the wall is felt for."""
_LARGEST_PATIENCE = 1e3
"""m."""
_ROUNDING = 1e-6
"""m²/s; what a tank must have left, as actions are sent in float32."""
_REST_TIME = 30.0
"""For so long must the tank last at rest after any step that costs something, s."""


class Settings(NamedTuple):
    """What wall followers share."""

    clearance: float
    """Angle by which to stay clear of an edge, rad; in space within the plane, and across it."""
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
    turns: bool
    """Whether robots are nonholonomic."""
    gate: Gate
    """Step and turn limits of these."""
    aligned: float
    """Within this angle of where they are to go these drive, rad."""


@kernel(allocates=True)
def wall_following_velocities(
    net_bearing, degrees, silhouettes, levels, settings, pitches, memory, out
):
    """Desired velocities: along f where nothing blocks it, else along the wall; of robots that turn
    the speeds and turn rates with which they follow them.

        vᵢ = sᵢ ‖fᵢ‖ hᵢ                                                            (guarantees 8)

    A robot rests where its tank would not last, and turns back after that.

    Args:
        net_bearing: fᵢ, (N, 2), m/s.
        degrees: Dᵢ, (N,), m/s.
        silhouettes: (N, M, 2, 2), counter-clockwise edge, then clockwise edge.
        levels: Aᵢ, (N,), m²/s.
        settings: a Settings.
        pitches: βᵢ, (N,), rad, of robots of space that turn; else 0.
        memory: (N, MEMORY), changed.
        out: (N, 2), m/s; or m/s and rad/s.
    """
    intervals = np.empty((silhouettes.shape[1], 2))
    for i in range(out.shape[0]):
        f = load(net_bearing[i])
        strength, towards = split(f)
        looks_aside = settings.turns and _looks_aside(
            load(memory[i, HEADING_X : HEADING_Y + 1]), settings
        )
        spent = _is_spent(strength, memory[i]) and not looks_aside
        memory[i, SHORT] = 0.0
        if strength == 0.0:
            out[i, :] = 0.0
            continue
        free, turn = _turn(towards, spent, silhouettes[i], settings, memory[i], intervals)
        heading = _turned(towards, turn)
        memory[i, HEADING_X], memory[i, HEADING_Y] = heading[0], heading[1]
        account, plane = (degrees[i], levels[i]), (towards, _left_of(towards))
        if settings.turns:
            speed, rates = _inputs(f, account, heading, free, pitches[i], settings, memory[i])
            clear = axis_is_clear(rates, silhouettes[i], settings.gate)
            out[i, 0] = speed if clear else 0.0
            send_rates(rates, out[i], settings.gate)
            continue
        store(_affordable(f, plane, account, heading, free, settings, memory[i]), out[i])


@kernel(allocates=True)
def wall_following_velocities_3d(
    net_bearing, degrees, silhouettes, levels, settings, pitches, memory, out
):
    """As ``wall_following_velocities``, in a plane of space: of (N, 3), silhouettes (N, M, 8, 3),
    memory (N, MEMORY_IN_SPACE).
    """
    slots = silhouettes.shape[1]
    rays, cut, intervals = np.empty((slots, 8, 3)), np.empty((slots, 2, 2)), np.empty((slots, 2))
    for i in range(out.shape[0]):
        f = load(net_bearing[i])
        strength, towards = split(f)
        heading = load(memory[i, HEADING:ASIDE])
        spent = _is_spent(strength, memory[i]) and not (
            settings.turns and _looks_aside(heading, settings)
        )
        memory[i, SHORT] = 0.0
        if strength == 0.0:
            out[i, :] = 0.0
            continue
        seen = widened_rays(silhouettes[i], settings.clearance, rays)
        views, held = (rays[:seen], cut[:seen], intervals[:seen]), memory[i, SIDE]
        before = load(memory[i, ASIDE:])
        keeps = TWO_PI if held != 0.0 else 0.0
        aside, kept = kept_azimuth(towards, before, keeps, settings.clearance, views)
        if held != 0.0 and not kept:
            memory[i, SIDE] = held = 1.0
        memory[i, HEADING_X], memory[i, HEADING_Y] = dot(heading, towards), dot(heading, aside)
        free, turn = _turn(X_AXIS, spent, views[1], settings, memory[i], views[2])
        heading = combine(math.cos(turn), towards, math.sin(turn), aside)
        account, plane = (degrees[i], levels[i]), (towards, aside)
        if settings.turns:
            speed, rates = _inputs(f, account, heading, free, pitches[i], settings, memory[i])
            clear = axis_is_clear_3d(rates, pitches[i], views[0], settings.gate)
            out[i, 0] = speed if clear else 0.0
            send_rates(rates, out[i], settings.gate)
        else:
            store(_affordable(f, plane, account, heading, free, settings, memory[i]), out[i])
        if held < 0.0 < memory[i, SIDE]:  # both azimuths of the plane have been tried
            aside = cross(towards, aside)
        store(heading, memory[i, HEADING:ASIDE])
        store(aside if memory[i, SIDE] != 0.0 else ORIGIN, memory[i, ASIDE:])


@kernel
def _is_spent(strength, memory):
    """Whether a robot turns back: its tank was too low, or it has lost too much of its work."""
    return memory[SHORT] > 0.0 or memory[WORK] < -memory[PATIENCE] * strength


@kernel
def _turn(towards, spent, silhouettes, settings, memory, intervals):
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
    _choose_side(joined, spent, memory)
    side = memory[SIDE]
    edge, gap = _edge(joined, side)
    if held == side and abs(_wrapped(edge - kept)) > _JUMP:
        edge, gap = _along_wall(towards, kept, edge, gap, silhouettes, settings, side, intervals)
    return True, edge + side * min(clearance, 0.5 * gap)


@kernel
def _choose_side(joined, spent, memory):
    """Take the nearer edge at first; the other side once work or tank are spent."""
    if memory[SIDE] == 0.0:
        memory[SIDE] = 1.0 if abs(joined[1]) <= abs(joined[0]) else -1.0
        memory[WORK] = 0.0
    elif spent:
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
def _affordable(f, plane, account, heading, free, settings, memory):
    """The velocity along a heading, or rest where the tank would not last; ``plane`` is f/‖f‖ and a
    unit vector across it, ``account`` D, m/s, and A, m²/s.
    """
    (towards, aside), (degree, level), strength = plane, account, norm(f)
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
    turn = math.copysign(math.acos(settings.min_alignment), dot(aside, heading))
    return combine(speed * math.cos(turn), towards, speed * math.sin(turn), aside)


@kernel
def _looks_aside(heading, settings):
    """Whether a robot has still to turn on the spot towards a unit vector of its body frame."""
    return heading[0] < math.cos(settings.aligned)


@kernel
def _inputs(f, account, heading, free, pitch, settings, memory):
    """Speed and turn rates of a robot that is to go along a heading, which turns there and drives
    where its tank lasts. ``account`` as for ``_affordable``.
    """
    (degree, level), strength = account, norm(f)
    r, duration = settings.merge_radius, settings.duration
    speed = strength * descent_scale(strength, degree, r, duration, settings.speed_limit)
    speed, rates = inputs_towards(scaled(heading, speed), pitch, settings.gate, settings.aligned)
    moved = scaled(mean_axis(rates, pitch, settings.gate), speed * duration)
    if not free or level + certain_descent(f, degree, moved, r) < _ROUNDING:
        memory[SHORT] = 1.0 if speed > 0.0 else 0.0
        speed = 0.0
    return speed, rates


@kernel
def _kept_angle(towards, memory):
    """Angle from f to the heading of the step before, rad; 0 if there is none."""
    before = memory[HEADING_X], memory[HEADING_Y], 0.0
    return math.atan2(dot(_left_of(towards), before), dot(towards, before))


@kernel
def _left_of(direction):
    """A direction of the plane a quarter turn on, as a triple."""
    return -direction[1], direction[0], 0.0


@kernel
def _turned(direction, angle):
    """A direction of the plane turned counter-clockwise, as a triple."""
    return combine(math.cos(angle), direction, math.sin(angle), _left_of(direction))


@kernel
def _wrapped(angle):
    """The same angle in [−π, π)."""
    return angle - TWO_PI * math.floor((angle + math.pi) / TWO_PI)
