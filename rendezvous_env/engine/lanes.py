"""The arithmetic of a step over lanes: the innermost loop runs over teams, so that it becomes SIMD.

A *lane buffer* holds LANES teams side by side: entry ``k * LANES + lane`` is the k-th number of the
team in that lane. Every function here has few flat buffers and loops of constant length, which is
what lets the compiler turn square roots and divisions into vector instructions. ``axes`` is the
tuple (0, 1) or (0, 1, 2): its length is known when compiling, so loops over it unroll. In the same
way ``span`` says how much of a block is computed: () all lanes, (0,) only the first FEW, which is
enough for one team. Unused lanes hold harmless numbers.
"""

import math

from ..compilation import kernel
from ..equations.geometry import disc_edges

LANES = 32
FEW = 4


@kernel
def width(span):
    """How many lanes are computed."""
    return FEW if len(span) > 0 else LANES


@kernel
def velocity_displacements(span, action, frame, speed_limit, duration, axes, out):
    """Displacement of a single integrator: ‖v‖ limited to v_max, direction kept, frame to global.

    Args:
        span: how much of a block, see above.
        action: velocity in the robot's own frame, d numbers, m/s.
        frame: rotation from local to global, d·d numbers, row by row.
        speed_limit: v_max, m/s.
        duration: τ, s.
        axes: (0, 1) or (0, 1, 2).
        out: displacement, d numbers, m, and its length.
    """
    d = len(axes)
    for lane in range(width(span)):
        square = 0.0
        for k in range(d):
            square += action[k * LANES + lane] * action[k * LANES + lane]
        speed = math.sqrt(square)
        scale = duration * (speed_limit / speed if speed > speed_limit else 1.0)
        for row in range(d):
            along = 0.0
            for k in range(d):
                along += frame[(row * d + k) * LANES + lane] * action[k * LANES + lane]
            out[row * LANES + lane] = along * scale
        out[d * LANES + lane] = speed * scale


@kernel
def mark_near_pairs(span, square_closest, square_reach, near):
    """Set ``near`` to 1 where two neighbours start close enough to meet within the step, else 0."""
    for lane in range(width(span)):
        near[lane] = 1.0 if square_closest[lane] < square_reach else 0.0


@kernel
def mark_near_ball(span, position, ball, reach, axes, near):
    """Raise ``near`` where a robot is within ``reach``, m, of the bounding ball of an obstacle.

    Args:
        span: how much of a block, see above.
        position: d numbers, m.
        ball: centre, d numbers, and radius, m; NaN where there is no obstacle.
        reach: m.
        axes: (0, 1) or (0, 1, 2).
        near: one number.
    """
    d = len(axes)
    for lane in range(width(span)):
        square = 0.0
        for k in range(d):
            offset = ball[k * LANES + lane] - position[k * LANES + lane]
            square += offset * offset
        touch = ball[d * LANES + lane] + reach
        near[lane] = 1.0 if square < touch * touch else near[lane]


@kernel
def see_disc(span, position, ball, sight, out):
    """Bearings of the two edges of a disc in the global frame, zero where it is not seen.

    Args:
        span: how much of a block, see above.
        position: 2 numbers, m.
        ball: as ``mark_near_ball``, and the radius of the disc, m; NaN where there is none.
        sight: from how near it is seen, one number, m.
        out: the distance to the nearest disc so far, which falls; then 2 numbers of the
            counter-clockwise edge and 1, its factor in ``store_row``, and 3 of the clockwise edge.
    """
    for lane in range(width(span)):
        radius = ball[3 * LANES + lane]
        ax, ay, bx, by, distance = disc_edges(
            ball[lane] - position[lane], ball[LANES + lane] - position[LANES + lane], radius
        )
        gap = distance - radius
        seen = gap <= sight[lane]
        out[lane] = gap if gap < out[lane] else out[lane]
        out[LANES + lane] = ax if seen else 0.0
        out[2 * LANES + lane] = ay if seen else 0.0
        out[3 * LANES + lane] = 1.0
        out[4 * LANES + lane] = bx if seen else 0.0
        out[5 * LANES + lane] = by if seen else 0.0
        out[6 * LANES + lane] = 1.0


@kernel
def see_pair(span, position_i, position_j, weight, axes, out):
    """What neighbours i and j are to each other, and what that adds to the sums over all pairs.

    Args:
        span: how much of a block, see above.
        position_i: d numbers, m.
        position_j: d numbers, m.
        weight: a_ij, one number, m/s; 0 = no edge.
        axes: (0, 1) or (0, 1, 2).
        out: the sum of a_ij ‖p_j − p_i‖, which grows, and the least ‖p_j − p_i‖² of neighbours,
            which falls; then p_j − p_i, d numbers, m, a_ij/‖p_j − p_i‖, and that with a minus:
            the factors of a_ij g_ij and of a_ij g_ji.
    """
    d = len(axes)
    for lane in range(width(span)):
        square = 0.0
        for k in range(d):
            offset = position_j[k * LANES + lane] - position_i[k * LANES + lane]
            out[(2 + k) * LANES + lane] = offset
            square += offset * offset
        distance = math.sqrt(square)
        gain = weight[lane]
        least = out[LANES + lane]
        out[lane] += gain * distance
        out[LANES + lane] = square if (gain > 0.0) & (square < least) else least
        gain = gain / distance if square > 0.0 else 0.0
        out[(2 + d) * LANES + lane] = gain
        out[(3 + d) * LANES + lane] = -gain


@kernel
def store_row(span, vector, factor, frame, axes, row):
    """Write one row of observations: a vector of the global frame, as a robot sees it.

        row = factor · Rᵀ vector

    Args:
        span: how much of a block, see above.
        vector: d numbers, and then possible factors, one number each.
        factor: which of the factors, counted from 0.
        frame: R, d·d numbers.
        axes: (0, 1) or (0, 1, 2).
        row: (d·LANES,) float32, the d numbers of a lane side by side.
    """
    d = len(axes)
    for lane in range(width(span)):
        for axis in range(d):
            along = 0.0
            for k in range(d):
                along += frame[(k * d + axis) * LANES + lane] * vector[k * LANES + lane]
            # never the negative zero
            row[lane * d + axis] = along * vector[(d + factor) * LANES + lane] + 0.0


@kernel
def add_displacements(span, displacement, axes, position, way):
    """Move one robot of every team.

    Args:
        span: how much of a block, see above.
        displacement: d numbers, m, and the length of the path, m.
        axes: (0, 1) or (0, 1, 2).
        position: d numbers, m.
        way: one number, which grows by the length.
    """
    d = len(axes)
    for k in range(d):
        for lane in range(width(span)):
            position[k * LANES + lane] += displacement[k * LANES + lane]
    for lane in range(width(span)):
        way[lane] += displacement[d * LANES + lane]
