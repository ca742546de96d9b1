"""Rule of merged intervals in the plane: overlapping silhouettes count as one obstacle."""

import math

import numpy as np

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.physics.vectors import X_AXIS, cross_in_plane, dot, load, rotated, store
from rendezvous_env.safety.turning import mean_axis

from .obstacle_edges import STRAIGHT_AHEAD, direction_of, is_seen

TWO_PI = 2.0 * math.pi
_ROUNDING = 1e-12
_A_LITTLE_LESS = 1.0 - 1e-9
_UNDECIDED = 1e-9  # rad; costs closer than this are compared exactly
_FAR = 100.0  # rad; bound of sums of angles in this module


@kernel(allocates=True)
def merged_headings_2d(net_bearing, silhouettes, clearance, carried, persistence, out):
    """Headings towards the nearer edge of the merged interval that blocks f.

    Silhouettes that overlap, directly or through others, are merged into one interval of angles. If
    f lies in it or within the clearance, the heading is its nearer edge. The edge is moved outward
    by the clearance, or by half of the gap to the next interval if that is less. Without a blocking
    interval, or without any free direction, the heading is f. Within the clearance of two intervals
    the nearer one counts. The nearer edge minimises the angle from f plus λ ≥ 0 times the angle
    from the carried heading. This persistence λ prevents frequent changes of side.

    Inputs are fᵢ, (N, 2), and silhouettes (N, M, 2, 2), counter-clockwise edge first. The clearance
    is in rad; carried headings, (N, 2), are zero where undefined. The output is ``out``, (N, 2).
    """
    intervals = np.empty((silhouettes.shape[1], 2))
    for i in range(out.shape[0]):
        towards, before = direction_of(net_bearing[i]), load(carried[i])
        rule = clearance, persistence
        store(merged_heading_2d(towards, silhouettes[i], before, rule, intervals), out[i])


@inner_kernel
def merged_heading_2d(towards, silhouettes, carried, rule, intervals):
    """``merged_headings_2d`` of one robot, in triples; ``rule`` is clearance and persistence."""
    if is_clear(towards, silhouettes, rule[0]):
        return towards
    count = intervals_around(towards, silhouettes, intervals)
    return rotated(towards, turn_past(towards, intervals[:count], carried, rule))


@inner_kernel
def turn_past(towards, intervals, carried, rule):
    """Angle past merged intervals (count, 2) around a unit pair or triple, rad.

    See ``merged_headings_2d``; ``rule`` is clearance and persistence.
    """
    clearance, persistence = rule
    low, high, gap_below, gap_above = merged_interval(intervals)
    if high - low >= TWO_PI or low >= clearance or high <= -clearance:
        return 0.0
    if _is_upper_nearer(low, high, towards, carried, persistence):
        return high + min(clearance, 0.5 * gap_above)
    return low - min(clearance, 0.5 * gap_below)


@inner_kernel
def _is_upper_nearer(low, high, towards, carried, persistence):
    """True if the counter-clockwise edge costs less: its angle plus λ times that from carried."""
    if carried[0] == 0.0 and carried[1] == 0.0:
        return high <= -low
    # the two angles from carried differ by no more than the edges do
    if abs(high + low) > persistence * _between(high, low) + _UNDECIDED:
        return high < -low
    kept = math.atan2(cross_in_plane(towards, carried), dot(towards, carried))
    above = high + persistence * _between(high, kept)
    return above <= -low + persistence * _between(low, kept)


@inner_kernel
def is_clear(towards, silhouettes, clearance):
    """True if all of (M, 2, 2) are certainly farther from a unit triple than the clearance, rad.

    The same then holds for their merged intervals. The test computes no angle and applies to most
    robots in most steps.
    """
    least = least_square_cosine(clearance)
    for m in range(silhouettes.shape[0]):
        if is_seen(silhouettes[m]):
            last, first = load(silhouettes[m, 0]), load(silhouettes[m, 1])
            if comes_near(towards, last, first, least):
                return False
    return clearance < 0.5 * math.pi


@inner_kernel
def least_square_cosine(clearance):
    """Square cosine of the clearance, rad, a little less; above it, an edge may be too near."""
    return math.cos(clearance) ** 2 * _A_LITTLE_LESS


@inner_kernel(inline="code")
def comes_near(towards, last, first, least):
    """True unless a visible silhouette is certainly farther from a unit vector than the clearance.

    Arguments are pairs or triples: the direction, and the counter-clockwise and clockwise edge.
    ``least`` is from ``least_square_cosine``. It has no branch.
    """
    width = cross_in_plane(first, last)
    wide = (width < 0.0) | ((width == 0.0) & (dot(first, last) > 0.0))  # than π, or a point
    covers = (cross_in_plane(first, towards) >= 0.0) & (cross_in_plane(towards, last) >= 0.0)
    before, after = dot(towards, first), dot(towards, last)
    near_first = (before > 0.0) & (before * before >= least * dot(first, first))
    near_last = (after > 0.0) & (after * after >= least * dot(last, last))
    return wide | covers | near_first | near_last


@inner_kernel
def axis_is_clear(rates, silhouettes, gate):
    """True if a unicycle's axis, and its mean over a step with these rates, miss (M, 2, 2)."""
    on_the_way = mean_axis(rates, 0.0, gate)
    return is_clear(X_AXIS, silhouettes, 0.0) and is_clear(on_the_way, silhouettes, 0.0)


@inner_kernel
def merged_interval_2d(towards, silhouettes, intervals):
    """Interval of angles covered by silhouettes (M, 2, 2) around a unit triple, after merging.

    Results as ``merged_interval``. ``intervals``, (M, 2), is working memory.
    """
    count = intervals_around(towards, silhouettes, intervals)
    return merged_interval(intervals[:count])


@inner_kernel
def intervals_around(towards, silhouettes, intervals):
    """Write the intervals of visible silhouettes (M, 2, 2) to (M, 2); returns their number."""
    count = 0
    for m in range(silhouettes.shape[0]):
        if is_seen(silhouettes[m]):
            interval_around(towards, silhouettes[m], intervals[count])
            count += 1
    return count


@inner_kernel
def interval_around(towards, silhouette, interval):
    """Write the clockwise edge and the width of a silhouette (2, 2), rad, to ``interval``, (2,).

    The edge is counter-clockwise from ``towards``, a unit triple.
    """
    last, first = load(silhouette[0]), load(silhouette[1])
    interval[0] = math.atan2(cross_in_plane(towards, first), dot(towards, first))
    interval[1] = width_of(math.atan2(cross_in_plane(first, last), dot(first, last)))


@inner_kernel(inline="code")
def width_of(angle):
    """Width of a silhouette, rad, from the angle between its edges.

    At contact, rounding or sensor errors may swap the edges.
    """
    return max(angle, 0.0) if angle > -0.5 * math.pi else angle + TWO_PI


@inner_kernel
def merged_interval(intervals):
    """Merged interval that contains the direction 0, or else the one with the nearest edge.

    Inputs are clockwise edges and widths, (count, 2), rad. Returns the clockwise and the
    counter-clockwise edge, and the free angles beyond either edge. A full turn between the edges
    means that no direction is free. Edges of ∞ and −∞ mean that there is no interval.
    """
    nearest = _nearest_interval(intervals)
    if nearest == STRAIGHT_AHEAD:
        return math.inf, -math.inf, TWO_PI, TWO_PI
    low, high = _join_from(nearest, intervals)
    gap_below = gap_above = TWO_PI - (high - low)  # free angle up to the next interval or to itself
    for k in range(intervals.shape[0]):
        after_low = counter_clockwise(intervals[k, 0] - low)
        if after_low > high - low:
            gap_above = min(gap_above, after_low - (high - low))
            gap_below = min(gap_below, TWO_PI - (after_low + intervals[k, 1]))
    return low, high, gap_below, gap_above


@inner_kernel
def _between(a, b):
    """Angle between two directions given as angles, rad."""
    apart = counter_clockwise(a - b)
    return min(apart, TWO_PI - apart)


@inner_kernel
def _nearest_interval(intervals):
    """Index of an interval that contains 0, or else of the one with the nearest edge."""
    nearest, least = STRAIGHT_AHEAD, math.inf
    for k in range(intervals.shape[0]):
        low = intervals[k, 0]
        high = low + intervals[k, 1]
        if low <= 0.0 <= high:
            return k
        distance = min(abs(low), abs(high), TWO_PI - high)
        if distance < least:
            nearest, least = k, distance
    return nearest


@inner_kernel
def counter_clockwise(angle):
    """Equivalent angle in [0, 2π); values that round to 2π become 0, NaN is kept."""
    if not -_FAR < angle < _FAR:  # ±∞ would never terminate; % makes it NaN
        angle = angle % TWO_PI
    while angle < 0.0:
        angle += TWO_PI
    while angle >= TWO_PI - _ROUNDING:
        angle -= TWO_PI
    return max(angle, 0.0)


@inner_kernel
def _join_from(first, intervals):
    """Merge an interval with all that overlap it: (low, high), rad from f, up to a full turn."""
    low = intervals[first, 0]
    high = low + intervals[first, 1]
    if low > 0.0 and TWO_PI - high < low:  # seen from below, its upper edge is nearer
        low, high = low - TWO_PI, high - TWO_PI
    for _ in range(2 * intervals.shape[0] + 1):  # each pass but the last merges one on a side
        if not high - low < TWO_PI:
            break
        grown = False
        for k in range(intervals.shape[0]):
            after_low = counter_clockwise(intervals[k, 0] - low)
            end = after_low + intervals[k, 1]
            if after_low <= high - low and low + end > high:
                high, grown = low + end, True
            elif after_low > high - low and end >= TWO_PI:
                low, grown = low + after_low - TWO_PI, True
        if not grown:
            break
    return low, high
