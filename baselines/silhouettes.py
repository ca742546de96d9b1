"""Headings at the edges of obstacles: the rules, as kernels over robots.

Silhouette points of an obstacle are S unit vectors in the robot's own frame: the counter-clockwise
and the clockwise edge in the plane, eight boundary rays of a cone in space. An obstacle whose first
point is exactly zero is not seen. All kernels take net bearings (N, d) float64 and silhouettes
(N, M, S, d) of any float type, and write unit headings (N, d); a robot without a net bearing heads
along its x axis.
"""

import math

import numpy as np

from rendezvous_env.compilation import allocating_kernel, kernel
from rendezvous_env.equations.vectors import X_AXIS, combine, dot, load, split, without

TWO_PI = 2.0 * math.pi
_STRAIGHT_AHEAD = -1
_ROUNDING = 1e-12
_FAR = 100.0
"""rad; sums of the angles in here stay below it."""


@kernel
def tangent_headings(net_bearing, silhouettes, only_blocking, out):
    """Head for the edge nearest to f of the most prominent obstacle, along f if there is none.

    Section IV-C of the paper. "Most prominent" is the one with the largest angular width, the first
    of equals.

    Args:
        net_bearing: fᵢ, (N, d).
        silhouettes: (N, M, S, d).
        only_blocking: whether to look only at obstacles that f points into.
        out: (N, d).
    """
    for i in range(out.shape[0]):
        towards = _direction(net_bearing[i])
        prominent = _most_prominent(towards, silhouettes[i], only_blocking)
        if prominent == _STRAIGHT_AHEAD:
            _store(towards, out[i])
        else:
            _store(_nearest_point(towards, silhouettes[i, prominent]), out[i])


@allocating_kernel
def joined_headings_2d(net_bearing, silhouettes, clearance, carried, persistence, out):
    """Head for the nearer edge of all that blocks f, overlapping silhouettes being one obstacle.

    Silhouettes that overlap, directly or through others, are joined into one interval of angles.
    If f lies in it, or within the clearance of it, head for its nearer edge, moved away from it by
    the clearance, or by half of the gap to the next interval if that is less. With nothing in the
    way, or no free direction at all, keep f. Within the clearance of two intervals the nearer one
    counts. With a persistence λ the nearer edge is the one with the smaller angle from f plus λ
    times the angle from the carried heading, so that a robot seldom changes its mind.

    Args:
        net_bearing: fᵢ, (N, 2).
        silhouettes: (N, M, 2, 2), counter-clockwise edge, then clockwise edge.
        clearance: rad.
        carried: headings of the step before, (N, 2); zero = none yet.
        persistence: λ, 0 or more.
        out: (N, 2).
    """
    intervals = np.empty((silhouettes.shape[1], 2))
    for i in range(out.shape[0]):
        towards, before = _direction(net_bearing[i]), load(carried[i])
        kept, weight = 0.0, 0.0
        if before[0] != 0.0 or before[1] != 0.0:
            kept, weight = math.atan2(_cross(towards, before), dot(towards, before)), persistence
        joined = joined_interval_2d(towards, silhouettes[i], intervals)
        turn = _turn_to_free(joined, clearance, kept, weight)
        c, s = math.cos(turn), math.sin(turn)
        out[i, 0] = c * towards[0] - s * towards[1]
        out[i, 1] = s * towards[0] + c * towards[1]


@allocating_kernel
def joined_headings_3d(net_bearing, silhouettes, clearance, out):
    """Head for a free direction beside all that blocks f, overlapping cones being one obstacle.

    Cones whose angular discs overlap, directly or through others, are joined. If f lies in a disc
    widened by the clearance (of several, the one it is deepest in counts), the candidates are the
    boundary rays, eight of each cone joined with that one, moved outward by the clearance. Head for
    the candidate nearest to f that lies in no other cone; with nothing in the way, or no such
    candidate, keep f. Ray 0 of a cone is its boundary direction nearest to f, so a single cone is
    left by the shortest way.

    Args:
        net_bearing: fᵢ, (N, 3).
        silhouettes: (N, M, 8, 3).
        clearance: rad.
        out: (N, 3).
    """
    cones = np.empty((silhouettes.shape[1], 4))
    slots = np.empty(silhouettes.shape[1], np.int64)
    joined = np.empty(silhouettes.shape[1], np.bool_)
    for i in range(out.shape[0]):
        towards = _direction(net_bearing[i])
        count = _seen_cones(silhouettes[i], cones, slots)
        blocking = _deepest(towards, cones[:count], clearance)
        if blocking == _STRAIGHT_AHEAD:
            _store(towards, out[i])
            continue
        _join(blocking, cones[:count], joined)
        rays = silhouettes[i]
        _store(_nearest_free_ray(towards, cones[:count], joined, rays, slots, clearance), out[i])


# ---- one robot, any dimension -------------------------------------------------------------------


@kernel
def _direction(net_bearing):
    length, direction = split(load(net_bearing))
    return direction if length > 0.0 else X_AXIS


@kernel
def _store(vector, out):
    for k in range(out.shape[0]):
        out[k] = vector[k]


@kernel
def _is_seen(points):
    for k in range(points.shape[1]):
        if points[0, k] != 0.0:
            return True
    return False


@kernel
def _unit(point):
    return split(load(point))[1]


@kernel
def _opposite(points):
    """Two points across the silhouette: both edges in the plane, rays 0 and 4 in space."""
    return _unit(points[0]), _unit(points[points.shape[0] // 2])


@kernel
def _most_prominent(towards, silhouettes, only_blocking):
    """Index of the obstacle of the largest angular width."""
    prominent, least_cosine = _STRAIGHT_AHEAD, math.inf
    for m in range(silhouettes.shape[0]):
        if not _is_seen(silhouettes[m]):
            continue
        first, second = _opposite(silhouettes[m])
        if dot(first, second) >= least_cosine:
            continue
        if not only_blocking or _blocks(towards, first, second):
            prominent, least_cosine = m, dot(first, second)
    return prominent


@kernel
def _blocks(towards, first, second):
    """Whether a direction is as near to the middle of a silhouette as its edges are."""
    middle = split(combine(1.0, first, 1.0, second))[1]
    return dot(towards, middle) >= dot(first, middle)


@kernel
def _nearest_point(towards, points):
    """The silhouette point nearest in angle, the first of equals."""
    nearest, best = 0, -math.inf
    for s in range(points.shape[0]):
        cosine = dot(towards, _unit(points[s]))
        if cosine > best:
            nearest, best = s, cosine
    return _unit(points[nearest])


# ---- one robot in the plane ---------------------------------------------------------------------


@kernel
def _relative_intervals(towards, silhouettes, out):
    """Silhouettes as (start, width), rad: from f to the clockwise edge, and on to the other.

    Returns:
        How many there are.
    """
    u, count = towards, 0
    for m in range(silhouettes.shape[0]):
        if not _is_seen(silhouettes[m]):
            continue
        last, first = load(silhouettes[m, 0]), load(silhouettes[m, 1])
        out[count, 0] = math.atan2(_cross(u, first), dot(u, first))
        out[count, 1] = max(math.atan2(_cross(first, last), dot(first, last)), 0.0)
        count += 1
    return count


@kernel
def _cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


@kernel
def joined_interval_2d(towards, silhouettes, intervals):
    """The angles that the silhouettes before a direction cover, those that overlap being joined.

    Args:
        towards: a unit vector, as a triple.
        silhouettes: (M, 2, 2) of one robot.
        intervals: (M, 2), working memory.

    Returns:
        The clockwise and the counter-clockwise edge, rad counter-clockwise from the direction, of
        the joined interval that holds it, or else has the edge nearest to it; then the free angles
        beyond either edge. A full turn between the edges means that nothing is free; edges of ∞ and
        −∞, that nothing is seen.
    """
    seen = intervals[: _relative_intervals(towards, silhouettes, intervals)]
    nearest = _nearest_interval(seen)
    if nearest == _STRAIGHT_AHEAD:
        return math.inf, -math.inf, TWO_PI, TWO_PI
    low, high = _join_from(nearest, seen)
    gap_below, gap_above = _gaps(low, high, seen)
    return low, high, gap_below, gap_above


@kernel
def _turn_to_free(joined, clearance, kept, persistence):
    """Angle from f, counter-clockwise, to the heading of ``joined_headings_2d``, rad.

    Args:
        joined: see ``joined_interval_2d``.
        clearance: rad.
        kept: angle of the carried heading, rad from f.
        persistence: what an edge's angle from that heading counts beside its angle from f.
    """
    low, high, gap_below, gap_above = joined
    if high - low >= TWO_PI or low >= clearance or high <= -clearance:
        return 0.0
    above = high + persistence * _between(high, kept)
    below = -low + persistence * _between(low, kept)
    if above <= below:
        return high + min(clearance, 0.5 * gap_above)
    return low - min(clearance, 0.5 * gap_below)


@kernel
def _between(a, b):
    """Angle between two directions given as angles, rad."""
    apart = _counter_clockwise(a - b)
    return min(apart, TWO_PI - apart)


@kernel
def _gaps(low, high, intervals):
    """Free angle below and above a joined interval, up to the next one or to itself, rad."""
    gap_below = gap_above = TWO_PI - (high - low)
    for k in range(intervals.shape[0]):
        after_low = _counter_clockwise(intervals[k, 0] - low)
        if after_low > high - low:
            gap_above = min(gap_above, after_low - (high - low))
            gap_below = min(gap_below, TWO_PI - (after_low + intervals[k, 1]))
    return gap_below, gap_above


@kernel
def _nearest_interval(intervals):
    """Index of an interval that holds 0, or else of the one with the nearest edge."""
    nearest, least = _STRAIGHT_AHEAD, math.inf
    for k in range(intervals.shape[0]):
        low = intervals[k, 0]
        high = low + intervals[k, 1]
        if low <= 0.0 <= high:
            return k
        distance = min(abs(low), abs(high), TWO_PI - high)
        if distance < least:
            nearest, least = k, distance
    return nearest


@kernel
def _counter_clockwise(angle):
    """The same angle in [0, 2π); what rounds to 2π is 0, and NaN stays NaN."""
    if not -_FAR < angle < _FAR:  # ±∞ would never get there turn by turn; % makes it NaN
        angle = angle % TWO_PI
    while angle < 0.0:
        angle += TWO_PI
    while angle >= TWO_PI - _ROUNDING:
        angle -= TWO_PI
    return max(angle, 0.0)


@kernel
def _join_from(first, intervals):
    """Grow an interval by all that overlap it, until nothing more does: (low, high), rad from f.

    high − low reaches 2π where everything around is covered.
    """
    low = intervals[first, 0]
    high = low + intervals[first, 1]
    if low > 0.0 and TWO_PI - high < low:  # counted from below, its upper edge is the near one
        low, high = low - TWO_PI, high - TWO_PI
    for _ in range(2 * intervals.shape[0] + 1):  # every pass but the last takes one in, on a side
        if not high - low < TWO_PI:
            break
        grown = False
        for k in range(intervals.shape[0]):
            after_low = _counter_clockwise(intervals[k, 0] - low)
            end = after_low + intervals[k, 1]
            if after_low <= high - low and low + end > high:
                high, grown = low + end, True
            elif after_low > high - low and end >= TWO_PI:
                low, grown = low + after_low - TWO_PI, True
        if not grown:
            break
    return low, high


# ---- one robot in space -------------------------------------------------------------------------


@kernel
def _seen_cones(silhouettes, cones, slots):
    """Unit centre direction and half angle in rad of each cone that is seen; how many there are."""
    count = 0
    for m in range(silhouettes.shape[0]):
        if not _is_seen(silhouettes[m]):
            continue
        first, second = _opposite(silhouettes[m])
        centre = split(combine(1.0, first, 1.0, second))[1]
        cones[count, 0], cones[count, 1], cones[count, 2] = centre
        cones[count, 3] = _angle(first, centre)
        slots[count] = m
        count += 1
    return count


@kernel
def _angle(a, b):
    """Angle between unit vectors, rad."""
    return math.acos(min(max(dot(a, b), -1.0), 1.0))


@kernel
def _deepest(towards, cones, clearance):
    """Index of the cone that f is deepest in, the clearance being part of each."""
    deepest, least = _STRAIGHT_AHEAD, clearance
    for k in range(cones.shape[0]):
        outside = _angle(towards, load(cones[k, :3])) - cones[k, 3]
        if outside < least:
            deepest, least = k, outside
    return deepest


@kernel
def _join(first, cones, joined):
    """Mark the cones that overlap the first one, directly or through others."""
    joined[:] = False
    joined[first] = True
    grown = True
    while grown:
        grown = False
        for k in range(cones.shape[0]):
            if not joined[k] and _touches(k, cones, joined):
                joined[k] = grown = True


@kernel
def _touches(k, cones, joined):
    for other in range(cones.shape[0]):
        apart = _angle(load(cones[k, :3]), load(cones[other, :3]))
        if joined[other] and apart < cones[k, 3] + cones[other, 3]:
            return True
    return False


@kernel
def _nearest_free_ray(towards, cones, joined, silhouettes, slots, clearance):
    """The widened boundary ray nearest to f that lies in no other cone; f if there is none."""
    heading, best = towards, -math.inf
    for k in range(cones.shape[0]):
        if not joined[k]:
            continue
        centre = load(cones[k, :3])
        angle = min(cones[k, 3] + clearance, math.pi)
        for s in range(silhouettes.shape[1]):
            outward = split(without(_unit(silhouettes[slots[k], s]), centre))[1]
            ray = combine(math.cos(angle), centre, math.sin(angle), outward)
            if dot(towards, ray) > best and _is_free(ray, k, cones):
                heading, best = ray, dot(towards, ray)
    return heading


@kernel
def _is_free(ray, own, cones):
    for k in range(cones.shape[0]):
        if k != own and dot(ray, load(cones[k, :3])) > math.cos(cones[k, 3]):
            return False
    return True
