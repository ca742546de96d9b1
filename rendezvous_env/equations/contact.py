"""How obstacles stop a robot: swept motion along straight lines and arcs.

A contact is a path that would go deeper than 1 µm into an obstacle; leaving, sliding along and
shallower grazing are free. No robot passes through an obstacle at any speed, and none ends a step
inside one. Where it makes contact a robot loses the part of its motion that would enter:

    ṗ = Π_T(p) v,    T(p) = {w : wᵀn ≥ 0 for the normal n of every obstacle touched at p}

so that vᵀṗ = ‖ṗ‖² ≥ 0, and law (1) lets V fall along obstacles too (theory.md 6).
"""

import math

import numpy as np

from ..compilation import kernel
from .geometry import (
    CENTRE,
    COUNT,
    RADIUS,
    ball_crossing,
    dot,
    obstacle_distance,
    outward_normal,
    polygon_edge,
)
from .kinematics import arc_displacement

SLIDE, STOP, IGNORE = range(3)
"""What a contact does: slide along the surface, rest at it, or nothing."""
CONTACT_DEPTH = 1e-6
"""m; how deep a path goes before it is a contact."""

_SURFACE_TOLERANCE = 1e-13  # m; what rounding may leave a resting robot inside
_VERTEX_TOLERANCE = 1e-9  # m; on a vertex are points that are no deeper behind either edge
_CHORD_TOLERANCE = 1e-7  # m; how far a chord may be from its arc when a contact is decided
_MAX_LEGS = 16
_MAX_CHORDS = 20_000
_MAX_PUSHES = 8


@kernel
def move_straight(position, displacement, obstacles, mode, out):
    """Move a robot straight, as far as the obstacles let it.

    Args:
        position: (d,), m, outside every obstacle or on its surface.
        displacement: (d,), what the robot would do without obstacles, m.
        obstacles: (M, width) packed rows.
        mode: SLIDE, STOP or IGNORE.
        out: (d,) array for the displacement executed, m; bit-equal to ``displacement`` on a path
            that touches nothing.

    Returns:
        Whether there was a contact.
    """
    _copy(displacement, out)
    if mode == IGNORE:
        return False
    near, fraction = _first_contact(position, displacement, obstacles, CONTACT_DEPTH)
    if not near:
        return False
    _add(position, displacement, 1.0, out)
    contact = fraction <= 1.0
    if not contact and _outside_all(out, obstacles):
        _copy(displacement, out)
        return False
    _follow(position, displacement, obstacles, mode, out)
    _subtract(out, position, out)
    return contact


@kernel
def move_curved(position, speed, yaw, pitch, yaw_rate, pitch_rate, duration, obstacles, mode, out):
    """Move a nonholonomic robot along its arc, as far as the obstacles let it.

    From the contact on, what is left of the arc is replaced by its chord, which slides as in
    ``move_straight``.

    Args:
        position: (d,), m, outside every obstacle or on its surface.
        speed: v, m/s; negative is backwards.
        yaw: α at the start, rad.
        pitch: β at the start, rad; 0 in 2-D.
        yaw_rate: ω_α, rad/s.
        pitch_rate: ω_β, rad/s; 0 in 2-D.
        duration: of the step, s.
        obstacles: (M, width) packed rows.
        mode: SLIDE, STOP or IGNORE.
        out: (d,) array for the displacement executed, m; that of ``arc_displacement``, bit for
            bit, on a path that touches nothing.

    Returns:
        Whether there was a contact.
    """
    arc = (speed, yaw, pitch, yaw_rate, pitch_rate)
    _along_arc(arc, duration, out)
    if mode == IGNORE or not _any_within(obstacles, position, abs(speed) * duration):
        return False
    contact_time = _first_contact_on_arc(position, arc, duration, obstacles)
    contact = contact_time <= duration
    free_end, point, chord = position.copy(), position.copy(), position.copy()
    _add(position, out, 1.0, free_end)
    if not contact and _outside_all(free_end, obstacles):
        return False
    _settle_on_arc(position, arc, min(contact_time, duration), obstacles, point)
    if contact and mode == SLIDE:
        _subtract(free_end, point, chord)
        _follow(point.copy(), chord, obstacles, mode, point)
    _subtract(point, position, out)
    return contact


@kernel
def _first_contact(position, displacement, obstacles, depth):
    """Whether a straight path comes near any obstacle, and the fraction of it before a contact.

    The fraction is where the path meets the surface of the first obstacle that it enters deeper
    than ``depth``; inf if there is none. A negative depth makes the obstacles fatter by so much.
    """
    near, first = False, np.inf
    reach = math.sqrt(dot(displacement, displacement)) + max(0.0, -depth)
    for m in range(obstacles.shape[0]):
        if _within(obstacles, m, position, reach):
            near = True
            first = min(first, _entry(obstacles[m], position, displacement, depth))
    return near, first


@kernel
def _within(obstacles, m, position, reach):
    """Whether the bounding ball of obstacle m is nearer than ``reach``, m."""
    if obstacles[m, COUNT] < 0:
        return False
    square, bound = 0.0, obstacles[m, RADIUS] + reach
    for k in range(position.shape[0]):
        difference = position[k] - obstacles[m, CENTRE + k]
        square += difference * difference
    return square <= bound * bound


@kernel
def _any_within(obstacles, position, reach):
    for m in range(obstacles.shape[0]):
        if _within(obstacles, m, position, reach):
            return True
    return False


@kernel
def _entry(obstacle, position, displacement, depth):
    """Fraction of a path at which it meets a surface that it goes deeper than ``depth`` into."""
    fatter = max(0.0, -depth)
    if obstacle[COUNT] > 0:
        return _polygon_entry(obstacle, position, displacement, depth, fatter)
    radius = obstacle[RADIUS]
    if ball_crossing(obstacle, position, displacement, radius - depth) > 1.0:
        return np.inf
    return ball_crossing(obstacle, position, displacement, radius + fatter)


@kernel
def _polygon_entry(obstacle, position, displacement, depth, fatter):
    """The same for a polygon: clip the path by its edges, moved inwards by ``depth``."""
    surface, first, last = 0.0, 0.0, 1.0
    for k in range(int(obstacle[COUNT])):
        x, y, ex, ey, _ = polygon_edge(obstacle, k)
        height = (position[0] - x) * ey - (position[1] - y) * ex
        rate = displacement[0] * ey - displacement[1] * ex
        if rate < 0.0:
            surface = max(surface, (fatter - height) / rate)
            first = max(first, -(height + depth) / rate)
        elif rate > 0.0:
            last = min(last, -(height + depth) / rate)
        elif height > -depth:
            return np.inf
    return surface if first < last else np.inf


@kernel
def _follow(position, displacement, obstacles, mode, point):
    """Where a robot ends that slides along, or stops at, the obstacles in its way.

    Args:
        position: (d,), m.
        displacement: (d,), what it would do without obstacles, m.
        obstacles: (M, width) packed rows.
        mode: SLIDE or STOP.
        point: (d,) array for the end, m.
    """
    start, leg, left = position.copy(), displacement.copy(), 1.0
    for _ in range(_MAX_LEGS):
        _, fraction = _first_contact(start, leg, obstacles, CONTACT_DEPTH)
        _settle_on_line(start, leg, min(fraction, 1.0), obstacles, point)
        if mode == STOP or fraction >= 1.0:
            return
        left *= 1.0 - fraction
        _copy(point, start)
        _free_part(displacement, start, obstacles, leg)
        for k in range(leg.shape[0]):
            leg[k] *= left


@kernel
def _settle_on_line(start, leg, fraction, obstacles, point):
    """Put ``point`` at a fraction of a leg, outside the obstacles.

    Where two surfaces meet so sharply that pushing it out of one pushes it into the other, it goes
    back along the leg a little, twice as far each time, at worst to the start.
    """
    retreat = CONTACT_DEPTH / max(CONTACT_DEPTH, math.sqrt(dot(leg, leg)))
    while fraction > 0.0:
        _add(start, leg, fraction, point)
        if _push_out(point, obstacles):
            return
        fraction -= retreat
        retreat *= 2.0
    _copy(start, point)
    _push_out(point, obstacles)


@kernel
def _settle_on_arc(start, arc, time, obstacles, point):
    """The same on an arc: ``point`` where the robot is after ``time``, or a little earlier."""
    retreat = CONTACT_DEPTH / max(CONTACT_DEPTH, abs(arc[0]))
    while time > 0.0:
        _along_arc(arc, time, point)
        _add(start, point, 1.0, point)
        if _push_out(point, obstacles):
            return
        time -= retreat
        retreat *= 2.0
    _copy(start, point)
    _push_out(point, obstacles)


@kernel
def _push_out(point, obstacles):
    """Move a point that is barely inside obstacles onto their surface; False if it cannot be."""
    normal = np.empty_like(point)
    for _ in range(_MAX_PUSHES):
        if _outside_all(point, obstacles):
            return True
        for m in range(obstacles.shape[0]):
            distance = obstacle_distance(obstacles[m], point)
            if distance < 0.0:
                outward_normal(obstacles[m], point, normal)
                _add(point, normal, -distance, point)
    return _outside_all(point, obstacles)


@kernel
def _outside_all(point, obstacles):
    for m in range(obstacles.shape[0]):
        if (
            _within(obstacles, m, point, 0.0)
            and obstacle_distance(obstacles[m], point) < -_SURFACE_TOLERANCE
        ):
            return False
    return True


@kernel
def _free_part(velocity, point, obstacles, out):
    """Π_T v: a velocity projected onto the directions that the obstacles touched leave free.

    Of the projections onto the faces of the cone T — v itself, planes, the lines in which two
    planes meet, 0 — that lie in T, the longest is the projection onto T.

    Args:
        velocity: v, (d,).
        point: (d,), m.
        obstacles: (M, width) packed rows; touched are those nearer to the point than 1 µm.
        out: (d,) array for the projection.
    """
    normals, count = _normals_touched(point, obstacles)
    candidate = velocity.copy()
    out.fill(0.0)
    if _is_free(candidate, normals, count):
        _copy(candidate, out)
        return
    longest = 0.0
    for i in range(count):
        for j in range(i, count if velocity.shape[0] == 3 else i + 1):
            _onto_face(velocity, normals[i], normals[j], candidate)
            length = dot(candidate, candidate)
            if length > longest and _is_free(candidate, normals, count):
                longest = length
                _copy(candidate, out)


@kernel
def _normals_touched(point, obstacles):
    """Two normals of every obstacle touched, one after the other, and their number.

    They differ on the vertex of a polygon only, where either edge may be slid along.
    """
    normals = np.empty((2 * obstacles.shape[0], point.shape[0]))
    count = 0
    for m in range(obstacles.shape[0]):
        if obstacle_distance(obstacles[m], point) < CONTACT_DEPTH:
            outward_normal(obstacles[m], point, normals[count])
            outward_normal(obstacles[m], point, normals[count + 1])
            _edges_touched(obstacles[m], point, normals[count], normals[count + 1])
            count += 2
    return normals, count


@kernel
def _edges_touched(obstacle, point, normal, other):
    """Replace a polygon's normals by those of the edges that have the point before them."""
    for k in range(int(obstacle[COUNT])):
        x, y, ex, ey, _ = polygon_edge(obstacle, k)
        if (point[0] - x) * ey - (point[1] - y) * ex > -_VERTEX_TOLERANCE:
            _copy(other, normal)
            other[0], other[1] = ey, -ex


@kernel
def _is_free(velocity, normals, count):
    """Whether a velocity enters no obstacle touched: it keeps before one of its two planes."""
    rounding = 1e-12 * math.sqrt(dot(velocity, velocity))
    for i in range(0, count, 2):
        if max(dot(velocity, normals[i]), dot(velocity, normals[i + 1])) < -rounding:
            return False
    return True


@kernel
def _onto_face(velocity, m, n, out):
    """Project a velocity onto the plane with normal n = m, or else onto the line m × n (3-D)."""
    cx, cy, cz = 0.0, 0.0, 0.0
    if velocity.shape[0] == 3:
        cx, cy, cz = m[1] * n[2] - m[2] * n[1], m[2] * n[0] - m[0] * n[2], m[0] * n[1] - m[1] * n[0]
    squared = cx * cx + cy * cy + cz * cz
    if squared < 1e-24:
        _add(velocity, n, -dot(velocity, n), out)
        return
    along = (velocity[0] * cx + velocity[1] * cy + velocity[2] * cz) / squared
    out[0], out[1], out[2] = along * cx, along * cy, along * cz


@kernel
def _first_contact_on_arc(position, arc, duration, obstacles):
    """Time until an arc meets the surface of the first obstacle that it enters deeper than 1 µm.

    The arc is followed chord by chord. While a robot moves for a time h it stays within |v| Ω h²/8
    of the chord, Ω the turn rate of its axis, so a chord that clears all obstacles made fatter by
    so much proves its piece of arc clear; if it does not, the next one is half as long.

    Returns:
        Time in s, inf if there is no contact. If the chords run out, the time that was proved
        clear.
    """
    speed, _, _, yaw_rate, pitch_rate = arc
    bend = abs(speed) * math.sqrt(yaw_rate * yaw_rate + pitch_rate * pitch_rate) / 8.0
    here, there = position.copy(), np.empty_like(position)
    chord = np.empty_like(position)
    time, piece = 0.0, duration
    for _ in range(_MAX_CHORDS):
        end = min(duration, time + piece)
        _along_arc(arc, end, there)
        _add(position, there, 1.0, there)
        _subtract(there, here, chord)
        sagitta = bend * (end - time) ** 2
        _, fraction = _first_contact(here, chord, obstacles, CONTACT_DEPTH - sagitta)
        if fraction > 1.0:
            if end >= duration:
                return np.inf
            time = end
            _copy(there, here)
            piece *= 2.0
        elif sagitta <= _CHORD_TOLERANCE:
            return time + fraction * (end - time)
        else:
            piece = 0.5 * (end - time)
    return time


@kernel
def _along_arc(arc, time, out):
    speed, yaw, pitch, yaw_rate, pitch_rate = arc
    arc_displacement(speed, yaw, pitch, yaw_rate, pitch_rate, time, out)


@kernel
def _copy(a, out):
    for k in range(out.shape[0]):
        out[k] = a[k]


@kernel
def _add(a, b, factor, out):
    """Out = a + factor b, for (d,) arrays."""
    for k in range(out.shape[0]):
        out[k] = a[k] + factor * b[k]


@kernel
def _subtract(a, b, out):
    """Out = a - b, for (d,) arrays."""
    for k in range(out.shape[0]):
        out[k] = a[k] - b[k]
