"""Which velocities of a robot lengthen none of its links, and the one that is nearest to a wish.

    B_i = ∩_j ball(ρ g_ij, ρ)                                         (theorem R, guarantees 12)

All these balls touch the origin, so resting is always allowed. A velocity of B_i stays there if it
is made shorter. Vectors are triples; a vector of the plane has z = 0 and keeps it.
"""

import math

from ..compilation import inlined_kernel, kernel
from ..equations.least_norm import least_along
from ..equations.vectors import (
    ORIGIN,
    X_AXIS,
    combine,
    cross,
    dot,
    scaled,
    split,
    subtract,
    without,
)

_MOST_ROUNDS = 48
"""A few do, however many links there are."""
_SLACK = 1e-13
"""So far outside of a ball, as a share of ρ², counts as on it."""
_ALIKE = 1e-11
"""Bearings whose difference is shorter than this are one bearing."""


@kernel
def project_on_links(wanted, rows, neighbour_slots, radius, error):
    """The velocity in B_i that is nearest to a wish (theorem R c).

    Found as an active set of at most three balls: while the point lies outside of some ball, the
    nearest point of that one and the active ones takes its place, and its distance grows. What
    rounding leaves outside is scaled into the set.

    Args:
        wanted: a triple, m/s.
        rows: of one robot, a_ij g_ij, (rows, d), m/s; zero rows are absent.
        neighbour_slots: K, how many of them, from the first, are neighbours.
        radius: ρ, m/s.
        error: η, rad, the largest angle by which a bearing may be wrong.

    Returns:
        A triple, m/s, no longer than ``wanted``.
    """
    point, active = wanted, (ORIGIN, ORIGIN, ORIGIN)
    for _ in range(_MOST_ROUNDS):
        bearing = worst_bearing(point, rows, neighbour_slots, error)
        if _excess(point, bearing, radius) <= _SLACK * radius * radius:
            break
        point, active = _nearest_on(wanted, bearing, active, radius)
        if dot(point, point) == 0.0:
            break
    return shortened_to_links(point, rows, neighbour_slots, radius, error)


@kernel
def shortened_to_links(velocity, rows, neighbour_slots, radius, error):
    """A velocity made just short enough for B_i: ‖v‖ ≤ 2 ρ cos ∠(v, g) for all g that may be there.

    Arguments as ``project_on_links``.

    Returns:
        A triple, m/s.
    """
    speed, direction = split(velocity)
    bearing = worst_bearing(direction, rows, neighbour_slots, error)
    most = max(2.0 * radius * dot(direction, bearing), 0.0)
    return velocity if speed <= most else scaled(direction, most)


@kernel
def worst_bearing(direction, rows, neighbour_slots, error):
    """Of all bearings within η of the seen ones the one that lies least along a direction.

        g cos α − u sin α,   α = min(η, π − ∠(g, v)),   u the part of v across g

    Args:
        direction: v, a triple, of any unit.
        rows: of one robot, (rows, d), of any unit.
        neighbour_slots: K.
        error: η, rad.

    Returns:
        A unit triple; zero where nobody is seen.
    """
    g = least_along(rows, neighbour_slots, direction)
    if error == 0.0 or dot(g, g) == 0.0:
        return g
    size, across = split(without(direction, g))
    if size == 0.0:
        across = _any_across(g)
    tilt = min(error, math.pi - math.atan2(size, dot(direction, g)))
    return combine(math.cos(tilt), g, -math.sin(tilt), across)


@inlined_kernel
def _any_across(g):
    """A unit triple across a unit triple; in the plane where that one is."""
    size, across = split((-g[1], g[0], 0.0))
    return across if size > 0.5 else split(without(X_AXIS, g))[1]


@kernel
def _excess(point, bearing, radius):
    """‖x‖² − 2 ρ x·g: how far a point is outside of the ball of a bearing; negative inside."""
    return dot(point, point) - 2.0 * radius * dot(point, bearing)


@kernel
def _nearest_on(wanted, bearing, active, radius):
    """The point nearest to a wish in the balls of a bearing and of up to three others, one of them
    zero if it is none, where it is on the first one's boundary; and the balls that it is on.
    """
    found, kept = ORIGIN, (ORIGIN, ORIGIN, ORIGIN)
    least = dot(wanted, wanted)
    others = (ORIGIN, active[0], active[1], active[2])
    for k in range(4):
        for m in range(max(k, 1)):
            on = (bearing, others[k], others[m])
            point = _nearest_on_all(wanted, on, radius)
            worst = -math.inf
            for other in active:
                if _is(other):
                    worst = max(worst, _excess(point, other, radius))
            gap = subtract(point, wanted)
            if worst <= _SLACK * radius * radius and dot(gap, gap) < least:
                found, kept, least = point, on, dot(gap, gap)
    return found, kept


@inlined_kernel
def _is(bearing):
    """Whether there is one."""
    return dot(bearing, bearing) > 0.0


@kernel
def _nearest_on_all(wanted, on, radius):
    """The point nearest to a wish on the boundaries of one to three balls; the origin, which they
    share, where there is no other.

    Two spheres of the same radius through the origin meet in a circle, across the difference of
    their bearings; three meet in one more point.
    """
    g, first, second = on
    centre, strides = g, wanted
    if _is(first):
        size, normal = split(subtract(g, first))
        if size < _ALIKE:
            return ORIGIN
        if _is(second):
            size, line = split(cross(normal, subtract(g, second)))
            if size < _ALIKE:
                return ORIGIN
            return scaled(line, 2.0 * radius * dot(line, g))
        centre, strides = combine(0.5, g, 0.5, first), without(wanted, normal)
    _, outward = split(combine(1.0, strides, -radius, centre))
    return scaled(combine(1.0, centre, math.sqrt(dot(centre, centre)), outward), radius)
