"""The arithmetic of a step over lanes: the innermost loop runs over teams, so that it becomes SIMD.

A *lane buffer* holds LANES teams side by side: entry ``k * LANES + lane`` is the k-th number of the
team in that lane. Every function here has few flat buffers and loops of constant length, which is
what lets the compiler turn square roots and divisions into vector instructions. ``axes`` is the
tuple (0, 1) or (0, 1, 2): its length is known when compiling, so loops over it unroll. Unused lanes
hold harmless numbers.
"""

import math

from .geometry import disc_edges
from .jit import kernel

LANES = 32


@kernel
def velocity_displacements(action, frame, speed_limit, duration, axes, out):
    """Displacement of a single integrator: ‖v‖ limited to v_max, direction kept, frame to global.

    Args:
        action: velocity in the robot's own frame, d numbers, m/s.
        frame: rotation from local to global, d·d numbers, row by row.
        speed_limit: v_max, m/s.
        duration: τ, s.
        axes: (0, 1) or (0, 1, 2).
        out: displacement, d numbers, m, and its length.
    """
    d = len(axes)
    for lane in range(LANES):
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
def mark_near_pairs(start_i, start_j, weight, square_reach, axes, near):
    """Raise ``near`` where neighbours i and j start close enough to meet within the step."""
    d = len(axes)
    for lane in range(LANES):
        square = 0.0
        for k in range(d):
            offset = start_j[k * LANES + lane] - start_i[k * LANES + lane]
            square += offset * offset
        near[lane] = 1.0 if weight[lane] > 0.0 and square < square_reach else near[lane]


@kernel
def mark_near_balls(centre, radius, position, reach, axes, near):
    """Raise ``near`` where a robot starts within ``reach`` of a ball.

    Args:
        centre: d numbers, m.
        radius: one number, m.
        position: d numbers, m.
        reach: m.
        axes: (0, 1) or (0, 1, 2).
        near: one number.
    """
    for lane in range(LANES):
        square = 0.0
        for k in range(len(axes)):
            offset = centre[k * LANES + lane] - position[k * LANES + lane]
            square += offset * offset
        bound = radius[lane] + reach
        near[lane] = 1.0 if square < bound * bound else near[lane]


@kernel
def disc_rows(centre, radius, position, frame, active, sight, out):
    """Silhouette bearings of a disc in the frames of robots, zero where it is not seen.

    Args:
        centre: 2 numbers, m.
        radius: one number, m.
        position: 2 numbers, m.
        frame: local → global, 4 numbers.
        active: one number, 0 for a robot that is gone.
        sight: from how near a disc is seen, m.
        out: the first number falls to the distance from the surface, m, where the robot is active;
            then 2 numbers of the counter-clockwise edge and 2 of the clockwise one.
    """
    for lane in range(LANES):
        ax, ay, bx, by, distance = disc_edges(
            centre[lane] - position[lane],
            centre[LANES + lane] - position[LANES + lane],
            radius[lane],
        )
        gap = distance - radius[lane]
        xx, xy = frame[lane], frame[LANES + lane]
        yx, yy = frame[2 * LANES + lane], frame[3 * LANES + lane]
        seen = active[lane] > 0.0 and gap <= sight
        out[lane] = gap if active[lane] > 0.0 and gap < out[lane] else out[lane]
        # never the negative zero
        out[LANES + lane] = xx * ax + yx * ay + 0.0 if seen else 0.0
        out[2 * LANES + lane] = xy * ax + yy * ay + 0.0 if seen else 0.0
        out[3 * LANES + lane] = xx * bx + yx * by + 0.0 if seen else 0.0
        out[4 * LANES + lane] = xy * bx + yy * by + 0.0 if seen else 0.0


@kernel
def pair_rows(position_i, position_j, frame_i, frame_j, weight, axes, out):
    """What neighbours i and j see of each other, and their part of V.

        row = a_ij R_iᵀ g_ij,   g_ij = (p_j − p_i)/‖p_j − p_i‖

    Args:
        position_i: d numbers, m.
        position_j: d numbers, m.
        frame_i: local → global, d·d numbers.
        frame_j: likewise.
        weight: a_ij, one number, m/s; 0 = no edge.
        axes: (0, 1) or (0, 1, 2).
        out: V grows by a_ij ‖p_j − p_i‖ in the first number; then d numbers of i's row, d of j's.
    """
    d = len(axes)
    for lane in range(LANES):
        square = 0.0
        for k in range(d):
            offset = position_j[k * LANES + lane] - position_i[k * LANES + lane]
            square += offset * offset
        distance = math.sqrt(square)
        gain = weight[lane] / distance if square > 0.0 else 0.0
        out[lane] += weight[lane] * distance
        for axis in range(d):
            seen_by_i = 0.0
            seen_by_j = 0.0
            for k in range(d):
                offset = position_j[k * LANES + lane] - position_i[k * LANES + lane]
                seen_by_i += frame_i[(k * d + axis) * LANES + lane] * offset
                seen_by_j -= frame_j[(k * d + axis) * LANES + lane] * offset
            out[(1 + axis) * LANES + lane] = seen_by_i * gain + 0.0  # never the negative zero
            out[(1 + d + axis) * LANES + lane] = seen_by_j * gain + 0.0


@kernel
def add_displacements(displacement, near, axes, position):
    """Move the robots of teams in which nothing can meet; the others have been moved already."""
    for k in range(len(axes)):
        for lane in range(LANES):
            moved = position[k * LANES + lane] + displacement[k * LANES + lane]
            position[k * LANES + lane] = position[k * LANES + lane] if near[lane] > 0.0 else moved
