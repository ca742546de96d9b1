"""Contact with obstacles: swept motion along straight lines and arcs.

A contact is a path more than 1 µm deep into an obstacle. It is also a path that obstacles block:
one obstacle leaves nothing of it, or several that meet leave less than half. Separation, sliding
and shallower grazing are no contacts. Obstacles that only just meet, so that 1 µm would open a
passage, have a skin (``obstacle_set``): motion is checked against their union. No robot passes
through it at any speed, and no step ends inside an obstacle. At a contact a robot loses the
component of its motion into the obstacle:

    ṗ = Π_T(p) v,    T(p) = {w : wᵀn ≥ 0 for the normal n of every obstacle touched at p}

so that vᵀṗ = ‖ṗ‖² ≥ 0, and V also decreases along obstacles under law (1) (theory.md 6).
"""

import math

import numpy as np

from ..compilation import kernel
from ..physics.vectors import ORIGIN, add, cross, dot, load, norm, store, subtract, triple
from ..robots.motion import chord_error_bound, displacement_at, period
from .obstacle_set import (
    clear_of_obstacles,
    distance_to,
    entry,
    normals,
    push_out,
    within,
)
from .shape import CONTACT_DEPTH

SLIDE, STOP, IGNORE = range(3)
"""Contact modes: slide along the surface, stop on it, or pass through."""
_TOUCHING = -1e-13  # m; rounding error of the distance of a resting robot
_TOUCHED_SKIN = 1e-8  # m; contact distance of a skin
_CHORD_TOLERANCE = 1e-7  # m; maximum distance of a chord from its arc at a contact
_MAX_LEGS = 16
# number of chords of a curve; limited so that all obstacles with their corners, visited for every
# chord, stay within the work limit
_MOST_CHORDS, _LEAST_CHORDS, _MOST_WORK = 20_000, 500, 400_000
_NEARLY_PARALLEL = 1e-24  # squared sine of the angle below which two planes are parallel


@kernel
def move_straight(point, way, world, mode, normals):
    """Move a robot along a straight path up to and along obstacles: ṗ = Π_T(p) v (theory 6).

    The initial point, m, is outside every obstacle or on a surface. ``way`` is the displacement
    without obstacles, m, ``mode`` SLIDE, STOP or IGNORE, ``normals`` (2M, 3) working memory.
    Returns whether there was a contact, and the executed displacement, a triple, m. Without contact
    it is bitwise equal to ``way``.
    """
    if mode == IGNORE:
        return False, way
    near, fraction = _first_contact(point, way, world, CONTACT_DEPTH)
    end = add(point, 1.0, way)
    if not near or (fraction > 1.0 and clear_of_obstacles(end, world, _TOUCHING)):
        return False, way
    has_room, in_skin, start = _out_of_skins(point, world)
    if not has_room:
        return dot(way, way) > 0.0, ORIGIN
    if in_skin:
        _, fraction = _first_contact(start, way, world, CONTACT_DEPTH)
    executed = subtract(_follow(start, way, world, mode, normals), point)
    return fraction <= 1.0 or _is_held(point, executed, way, world), executed


@kernel
def move_curved(point, way, model, action, frame, memory, world, mode, normals, work=0):
    """Move a robot along the curve of its model, as ``move_straight``.

    From the contact on, the chord replaces the remaining curve and slides. ``work`` is that of all
    obstacles if the world holds only near ones, see ``work_of``; 0 is that of the world.
    """
    near, reach = False, model.speed_limit * model.duration
    for m in range(world.kinds.shape[0]):
        near = near or within(world, m, point, reach)
    if mode == IGNORE or not near:
        return False, way
    curve = (model, action, frame, memory)
    has_room, in_skin, start = _out_of_skins(point, world)
    if not has_room:
        return dot(way, way) > 0.0, ORIGIN
    if work == 0:
        work = work_of(world)
    contact_time = _first_contact_on_curve(start, curve, world, work)
    contact = contact_time <= model.duration
    free_end = add(start, 1.0, way)
    if not contact and clear_of_obstacles(free_end, world, _TOUCHING):
        return False, subtract(free_end, point) if in_skin else way
    time = min(contact_time, model.duration)
    end = _settle(start, curve, time, model.speed_limit, world)
    if contact and mode == SLIDE:
        end = _follow(end, subtract(free_end, end), world, mode, normals)
    executed = subtract(end, point)
    return contact or _is_held(point, executed, way, world), executed


@kernel
def _out_of_skins(point, world):
    """Check the initial point, and move it out of skins.

    Returns whether there is free space at the point, whether it is in a skin, as a given initial
    position may be, and the moved point.
    """
    for m in range(world.kinds.shape[0]):
        skin = world.skins[m]
        if skin > 0.0 and within(world, m, point, 0.0):
            if distance_to(world, m, point) < skin + _TOUCHING:
                has_room, start = push_out(point, world, _TOUCHING)
                return has_room, True, start
    return True, False, point


@kernel
def _is_held(point, executed, way, world):
    """True if obstacles block a displacement.

    They leave less than a thousandth of it, or less than half where touched obstacles meet others.
    """
    share = norm(executed) / norm(way) if dot(way, way) > 0.0 else 1.0
    end, touched = add(point, 1.0, executed), 0
    if 1e-3 <= share < 0.5:
        for m in range(world.kinds.shape[0]):
            if within(world, m, end, CONTACT_DEPTH):
                if distance_to(world, m, end) < world.skins[m] + CONTACT_DEPTH:
                    touched += 2 if world.skins[m] > 0.0 else 1
    return share < 1e-3 or touched > 1


@kernel
def _first_contact(point, way, world, depth):
    """True if a straight path comes near any obstacle, and its fraction before contact, or inf."""
    near, first = False, np.inf
    reach = norm(way) + max(0.0, -depth)
    for m in range(world.kinds.shape[0]):
        if within(world, m, point, reach):
            near = True
            first = min(first, entry(world, m, point, way, depth))
    return near, first


@kernel
def _follow(point, way, world, mode, normals):
    """End point of a robot that slides along, or stops at, obstacles on its path."""
    start, leg, left = point, way, 1.0
    end = point
    for _ in range(_MAX_LEGS):
        _, fraction = _first_contact(start, leg, world, CONTACT_DEPTH)
        end = _settle(start, leg, min(fraction, 1.0), norm(leg), world)
        if mode == STOP or fraction >= 1.0:
            return end
        left *= 1.0 - fraction
        start = end
        free = free_part(way, start, world, normals)
        leg = (free[0] * left, free[1] * left, free[2] * left)
    return end


@kernel
def _settle(start, path, share, pace, world):
    """Position at a fraction of a path, see ``place_on``, moved outside the obstacles.

    Where surfaces meet at a sharp angle, leaving one would enter another. The point then moves back
    along the path, by twice the distance each time, at most to the start. ``pace``, m, is the
    length of the longest path for a fraction of 1.
    """
    retreat = CONTACT_DEPTH / max(CONTACT_DEPTH, pace)
    while share > 0.0 and retreat > 0.0:  # a path of infinite length leaves no retreat
        is_out, point = push_out(place_on(path, start, share), world, _TOUCHING)
        if is_out:
            return point
        share -= retreat
        retreat *= 2.0
    _, point = push_out(start, world, _TOUCHING)
    return point


@kernel
def place_on(path, start, share):
    """Position, m, at a fraction of a straight path, or after a time, s, on a curve.

    A curve is (model, action, frame, memory).
    """
    if len(path) == 3:
        return add(start, share, path)
    model, action, frame, memory = path
    return add(start, 1.0, triple(displacement_at(model, action, frame, memory, share)))


@kernel
def work_of(world):
    """Work of a visit of all obstacles; it limits the number of chords."""
    work = 1
    for m in range(world.kinds.shape[0]):
        work += 1 + world.corners[m]
    return work


@kernel
def _first_contact_on_curve(point, curve, world, work):
    """Time until a curve makes contact, s; inf without contact.

    If the chords run out, it is the time that is proven collision-free. A chord clear of all
    obstacles, enlarged by ``motion.chord_error_bound``, proves its piece of the curve
    collision-free. Otherwise the next chord is half as long.
    """
    model, action, _, memory = curve
    bent = chord_error_bound(model, action, memory)
    duration = min(model.duration, period(model, action, memory))
    here, time, piece = point, 0.0, duration
    for _ in range(max(_LEAST_CHORDS, min(_MOST_CHORDS, _MOST_WORK // work))):
        end = min(duration, time + piece)
        there = place_on(curve, point, end)
        sagitta = bent * (end - time) ** 2
        _, fraction = _first_contact(here, subtract(there, here), world, CONTACT_DEPTH - sagitta)
        if fraction > 1.0:
            if end >= duration:
                return np.inf
            time, here = end, there
            piece *= 2.0
        elif sagitta <= _CHORD_TOLERANCE:
            return time + fraction * (end - time)
        else:
            piece = 0.5 * (end - time)
    return time


@kernel
def free_part(velocity, point, world, touched):
    """Π_T v: projection of a velocity onto the directions that the touched obstacles leave free.

    The candidates are the projections onto the faces of the cone T: v itself, planes, the lines in
    which two planes intersect, and 0. The longest candidate in T is the projection onto T.
    ``touched``, (2M, 3), receives two normals of each touched obstacle.
    """
    count = 0
    for m in range(world.kinds.shape[0]):
        reach = world.skins[m] + _TOUCHED_SKIN if world.skins[m] > 0.0 else CONTACT_DEPTH
        if distance_to(world, m, point) < reach:
            normal, other = normals(world, m, point)
            store(normal, touched[count])
            store(other, touched[count + 1])
            count += 2
    if _is_free(velocity, touched, count):
        return velocity
    longest, best = 0.0, ORIGIN
    for i in range(count):
        for j in range(i, count):
            candidate = _onto_face(velocity, load(touched[i]), load(touched[j]))
            length = dot(candidate, candidate)
            if length > longest and _is_free(candidate, touched, count):
                longest, best = length, candidate
    return best


@kernel
def _is_free(velocity, touched, count):
    """True if a velocity enters no touched obstacle: one of its two half-spaces contains it."""
    rounding = 1e-12 * math.sqrt(dot(velocity, velocity))
    for i in range(0, count, 2):
        one, other = load(touched[i]), load(touched[i + 1])
        if max(dot(velocity, one), dot(velocity, other)) < -rounding:
            return False
    return True


@kernel
def _onto_face(velocity, m, n):
    """Project a velocity onto the plane with normal n = m, or else onto the line m × n."""
    line = cross(m, n)  # in 2-D it is vertical, perpendicular to every velocity: the result is 0
    squared = dot(line, line)
    if squared < _NEARLY_PARALLEL:
        return add(velocity, -dot(velocity, n), n)
    along = dot(velocity, line) / squared
    return along * line[0], along * line[1], along * line[2]
