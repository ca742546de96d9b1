"""Contact of robots with moving obstacles: swept motion in relative coordinates.

Within a step every obstacle moves straight at constant speed until a robot blocks it. In the
frame of an obstacle the path of a robot is its own path minus the motion of the obstacle. The first
contact is that with a still obstacle, so nothing passes through at any speed. After a contact

    ṗ = argmin ‖w − v‖   over   nᵀ(w − u) ≥ 0

for the normals n and velocities u of all touched obstacles. A robot slides along an obstacle in its
frame, and is pushed where nᵀu > 0. Times are fractions of the step, velocities are displacements
over a whole step, m.

An obstacle is blocked in three cases: it stops at robots instead of pushing them; no velocity
satisfies the inequalities (a robot between an obstacle and a wall); or the robot would have to move
faster than ‖v‖ + max ‖u‖. All robots are moved again with each blocked obstacle, in order
of time. The result therefore does not depend on the order of robots.
"""

import numpy as np

from ..compilation import kernel
from ..obstacles.contact import SLIDE, move_curved, move_straight, place_on
from ..obstacles.obstacle_set import distance_to, entry, normals, surface, within
from ..obstacles.shape import ABSENT, CONTACT_DEPTH
from ..physics.vectors import ORIGIN, add, cross, dot, load, norm, scaled, store, subtract
from ..robots.motion import chord_error_bound
from .motion import SHARE

_TOUCHING = -1e-13  # m; rounding error of the distance of a resting robot
_CHORD_TOLERANCE = 1e-7  # m; maximum distance of a chord from its arc at a contact
_MAX_CHORDS = 2000
_MAX_LEGS = 64
_MAX_PUSHES = 16
_NEARLY_PARALLEL = 1e-20  # squared sine between planes that have no line in common
_SAME_TIME = 1e-12  # of the step
_FASTER = 1.0 + 1e-9


@kernel
def moved(plan, time):
    """Displacement of an obstacle at a time of the step, a triple, m."""
    share = min(time, plan[SHARE])
    return plan[0] * share, plan[1] * share, plan[2] * share


@kernel
def _velocity(plan, time):
    """Velocity of an obstacle after a time of the step, a triple, m per step."""
    if time < plan[SHARE] - _SAME_TIME:
        return plan[0], plan[1], plan[2]
    return ORIGIN


@kernel
def meets_traffic(point, reach, world, plans):
    """True if an obstacle that moves in this step may come within ``reach``, m, of a point."""
    for m in range(world.kinds.shape[0]):
        way = norm((plans[m, 0], plans[m, 1], plans[m, 2]))
        if way > 0.0 and within(world, m, point, reach + way):
            return True
    return False


@kernel
def move_among(point, path, way, duration, world, plans, settings, memory):
    """Move a robot among obstacles with plans (M, 4); it starts outside of all.

    ``point`` is the initial position, a triple, m. ``path`` is a displacement, or (model, action,
    frame, memory) of a curve; ``way`` is its displacement, ``duration`` 1, or the time step of a
    curve, s. ``settings`` are the contact mode, whether obstacles push, and the dimension.
    ``memory`` is normals (2M, 3), levels (2M,), halts (M,) bool.

    Returns whether there was a contact, the executed displacement, and the time at which obstacles
    marked in ``halts`` are blocked, or inf.
    """
    mode, _, _ = settings
    held, levels, halts = memory
    halts[:] = False
    here, time, met, velocity = point, 0.0, False, ORIGIN
    free_end = add(point, 1.0, way)
    for _ in range(_MAX_LEGS):
        until = _next_stop(world, plans, time)
        if met:
            leg = scaled(velocity, until - time)
            share = first_contact(here, leg, time, until, world, plans, CONTACT_DEPTH)
            moment = time + share * (until - time) if share <= 1.0 else np.inf
            here = add(here, min(share, 1.0), leg)
        else:
            moment, here = _along(point, path, duration, here, time, until, world, plans)
        time = min(moment, until)
        if moment > until and not met:
            if until >= 1.0:
                break
            continue  # an obstacle stops before the robot has met any
        if moment > until and until >= 1.0:
            break
        is_out, here = push_out_of_traffic(here, time, world, plans)
        if not is_out:
            _halt_all(here, time, world, plans, halts)
            return True, subtract(here, point), time
        met = True
        wish = _rest_of(path, point, way, duration, time) if mode == SLIDE else ORIGIN
        count = _touched(here, time, world, plans, held, levels)
        velocity = _allowed(here, time, wish, way, count, world, plans, settings, memory)
        for m in range(len(halts)):
            if halts[m]:
                return True, subtract(here, point), time
    is_out, end = push_out_of_traffic(here, 1.0, world, plans)
    if not is_out or time < 1.0 - _SAME_TIME:
        _halt_all(here, 0.0, world, plans, halts)
        return True, subtract(end, point), 0.0
    met = met or norm(subtract(end, free_end)) > CONTACT_DEPTH
    return met, subtract(end, point) if met or end != free_end else way, np.inf


@kernel
def _rest_of(path, start, way, duration, time):
    """Mean velocity of a path from a time on, m per step."""
    if len(path) == 3:
        return way
    left = max(1.0 - time, _SAME_TIME)
    ahead = subtract(add(start, 1.0, way), place_on(path, start, time * duration))
    return scaled(ahead, 1.0 / left)


@kernel
def _next_stop(world, plans, time):
    """Earliest time after a given one at which an obstacle stops, at most 1."""
    until = 1.0
    for m in range(world.kinds.shape[0]):
        if time + _SAME_TIME < plans[m, SHARE] < until:
            until = plans[m, SHARE]
    return until


@kernel
def first_contact(point, way, time, until, world, plans, depth):
    """Fraction of a straight path between two times before contact with any obstacle, or inf.

    No obstacle stops between the two times.
    """
    first = np.inf
    for m in range(world.kinds.shape[0]):
        if world.kinds[m] != ABSENT:
            relative = subtract(point, moved(plans[m], time))
            towards = add(way, time - until, _velocity(plans[m], time))
            if within(world, m, relative, norm(towards) + max(0.0, -depth)):
                first = min(first, entry(world, m, relative, towards, depth))
    return first


@kernel
def _bend(path):
    """β of a path, m/s²; see ``Motion.chord_error_bound``."""
    if len(path) == 3:
        return 0.0
    model, action, _, memory = path
    return chord_error_bound(model, action, memory)


@kernel
def _along(start, path, duration, here, time, until, world, plans):
    """First contact on a path between two times, or inf, and the position then.

    If the chords run out, it is the time that is proven collision-free.
    """
    bent, piece = _bend(path), until - time
    for _ in range(_MAX_CHORDS):
        end = min(until, time + piece)
        there = place_on(path, start, end * duration)
        sagitta = bent * ((end - time) * duration) ** 2
        way = subtract(there, here)
        share = first_contact(here, way, time, end, world, plans, CONTACT_DEPTH - sagitta)
        if share > 1.0:
            if end >= until:
                return np.inf, there
            time, here = end, there
            piece *= 2.0
        elif sagitta <= _CHORD_TOLERANCE:
            moment = time + share * (end - time)
            return moment, place_on(path, start, moment * duration)
        else:
            piece = 0.5 * (end - time)
    return time, here


@kernel
def push_out_of_traffic(point, time, world, plans):
    """Move a point that is slightly inside obstacles at a time onto their surface.

    Returns whether it is outside, and the point.
    """
    for _ in range(_MAX_PUSHES):
        is_out = True
        for m in range(world.kinds.shape[0]):
            offset = moved(plans[m], time)
            relative = subtract(point, offset)
            if within(world, m, relative, 0.0):
                distance, normal = surface(world, m, relative)
                if distance < world.skins[m] + _TOUCHING:
                    is_out = False
                    point = add(point, world.skins[m] - distance, normal)
        if is_out:
            return True, point
    return False, point


@kernel
def _touched(point, time, world, plans, held, levels):
    """Write two normals of each obstacle touched at a time, and the least normal velocities."""
    count = 0
    for m in range(world.kinds.shape[0]):
        relative = subtract(point, moved(plans[m], time))
        reach = world.skins[m] + CONTACT_DEPTH
        if within(world, m, relative, CONTACT_DEPTH) and distance_to(world, m, relative) < reach:
            velocity = _velocity(plans[m], time)
            one, other = normals(world, m, relative)
            store(one, held[count])
            store(other, held[count + 1])
            levels[count], levels[count + 1] = dot(one, velocity), dot(other, velocity)
            count += 2
    return count


@kernel
def _allowed(point, time, wish, way, count, world, plans, settings, memory):
    """Velocity of a robot in contact; obstacles that it blocks are marked in ``halts``."""
    _, pushes, dim = settings
    held, levels, halts = memory
    if not pushes:
        for m in range(world.kinds.shape[0]):
            halts[m] = _runs_into(point, time, wish, m, world, plans)
        for m in range(world.kinds.shape[0]):
            if halts[m]:
                return ORIGIN
    pushed = 0.0
    for m in range(world.kinds.shape[0]):
        pushed = max(pushed, norm((plans[m, 0], plans[m, 1], plans[m, 2])))
    fastest = (max(norm(way), norm(wish)) + pushed) * _FASTER
    possible, velocity = nearest_allowed(wish, held, levels, count, dim)
    if not possible or norm(velocity) > fastest:
        for m in range(world.kinds.shape[0]):
            halts[m] = _is_pushing(point, time, m, world, plans)
        return ORIGIN
    return velocity


@kernel
def _touches(point, time, m, world, plans):
    """True if a point touches an obstacle at a time, the normal there, and its velocity."""
    relative, velocity = subtract(point, moved(plans[m], time)), _velocity(plans[m], time)
    if within(world, m, relative, CONTACT_DEPTH):
        distance, normal = surface(world, m, relative)
        return distance < world.skins[m] + CONTACT_DEPTH, normal, velocity
    return False, ORIGIN, velocity


@kernel
def _is_pushing(point, time, m, world, plans):
    touches, normal, velocity = _touches(point, time, m, world, plans)
    return touches and dot(normal, velocity) > 0.0


@kernel
def _runs_into(point, time, wish, m, world, plans):
    """True if an obstacle advances towards a robot that does not move away from it."""
    touches, normal, velocity = _touches(point, time, m, world, plans)
    return touches and dot(normal, velocity) > max(0.0, dot(normal, wish))


@kernel
def _halt_all(point, time, world, plans, halts):
    """Mark all moving obstacles, since a robot between them cannot move."""
    for m in range(world.kinds.shape[0]):
        halts[m] = norm(_velocity(plans[m], time)) > 0.0


@kernel
def nearest_allowed(wish, held, levels, count, dim):
    """Velocity nearest to ``wish``, m per step, among those that enter no touched obstacle.

    Obstacle k is not entered if nᵀw ≥ b for one of its two normals. These are rows 2k and 2k + 1 of
    ``held``, with b in ``levels``. Candidates are ``wish`` and its projections onto one, two or, in
    3-D, three planes nᵀw = b. Returns whether there is such a velocity.
    """
    if _is_allowed(wish, held, levels, count):
        return True, wish
    found, best, nearest = False, ORIGIN, np.inf
    for i in range(count):
        for j in range(i, count):
            for k in range(j, count if dim == 3 and j > i else j + 1):
                exists, candidate = _onto_planes(wish, held, levels, i, j, k)
                if exists:
                    off = subtract(candidate, wish)
                    square = dot(off, off)
                    if square < nearest and _is_allowed(candidate, held, levels, count):
                        found, best, nearest = True, candidate, square
    return found, best


@kernel
def _is_allowed(velocity, held, levels, count):
    for i in range(0, count, 2):
        rounding = 1e-12 * (norm(velocity) + abs(levels[i]) + abs(levels[i + 1]))
        one = dot(velocity, load(held[i])) - levels[i]
        other = dot(velocity, load(held[i + 1])) - levels[i + 1]
        if max(one, other) < -rounding:
            return False
    return True


@kernel
def _onto_planes(wish, held, levels, i, j, k):
    """Projection of a velocity onto up to three planes: w + Nᵀ G⁻¹ (b − N w), G = N Nᵀ.

    Equal indices are one plane. Returns whether the planes have a common point.
    """
    m, n, o = load(held[i]), load(held[j]), load(held[k])
    first = levels[i] - dot(m, wish)
    if j == i:
        return True, add(wish, first, m)
    second, c = levels[j] - dot(n, wish), dot(m, n)
    square = 1.0 - c * c
    if square < _NEARLY_PARALLEL:
        return False, wish
    if k == j:
        a, b = (first - c * second) / square, (second - c * first) / square
        return True, add(add(wish, a, m), b, n)
    volume = dot(m, cross(n, o))
    if volume * volume < _NEARLY_PARALLEL:
        return False, wish
    x, y, z = scaled(cross(n, o), levels[i]), scaled(cross(o, m), levels[j]), cross(m, n)
    return True, scaled(add(add(x, 1.0, y), levels[k], z), 1.0 / volume)


@kernel
def move_past_still(point, path, way, world, mode, held):
    """Motion of a robot among obstacles that do not move: ``move_straight`` or ``move_curved``."""
    if len(path) == 3:
        return move_straight(point, way, world, mode, held)
    model, action, frame, memory = path
    return move_curved(point, way, model, action, frame, memory, world, mode, held)
