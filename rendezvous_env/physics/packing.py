"""Packing of disc-shaped robots, which stop at contact and form a cluster instead of merging."""

import math

from ..compilation import inner_kernel, kernel
from .half_planes import nearest_within

_SHORT_OF_TOUCHING = 1.0 - 1e-9
"""Fraction of the available gap that is used, so that rounding causes no overlap."""
_ROUNDING = 1e-12
"""Relative error of the distance at which bodies stop each other."""
_TOUCHED = 2
"""Minimum number of contacts of a disc in a packed cluster; with one contact it can still roll."""


@kernel
def move_apart(positions, displacements, lengths, size, work):
    """Move discs by their displacements, cut so that none overlap at any time of the motion.

        min ‖x_i − Δ_i‖²   subject to   x_i·g_ij ≤ (‖p_j − p_i‖ − D)/2   for all j

    Each disc uses at most half of every gap (buffered Voronoi cells, Zhou et al. 2017), so none is
    pushed. A curved path stays within its length of its initial point. If the length exceeds half a
    gap, the disc executes the straight displacement instead.

    Positions and displacements, (n, 2), m, and path lengths, (n,), m, are overwritten by the
    executed ones; ``size`` is D, m; working memory is (normals (n, 2), rooms (≥ n − 1,)).
    """
    normals, rooms = work
    for i in range(len(lengths)):
        wanted = displacements[i, 0], displacements[i, 1]
        reach, count = max(math.hypot(wanted[0], wanted[1]), lengths[i]), 0
        for j in range(len(lengths)):
            across = positions[j, 0] - positions[i, 0]
            up = positions[j, 1] - positions[i, 1]
            distance = math.hypot(across, up)
            room = max(0.5 * (distance - size), 0.0) * _SHORT_OF_TOUCHING
            if j != i and room < reach and distance > 0.0:
                normals[count, 0], normals[count, 1] = across / distance, up / distance
                rooms[count] = room
                count += 1
        if count > 0:
            x, y = nearest_within(wanted, normals, rooms, count)
            displacements[i, 0], displacements[i, 1] = x, y
            lengths[i] = math.hypot(x, y)
    for i in range(len(lengths)):
        for k in range(2):
            positions[i, k] += displacements[i, k]


@kernel
def is_packed(positions, radius, work):
    """True if all discs are connected by contacts and each touches two others (one for n = 2).

    Contacts have ‖p_i − p_j‖ ≤ radius, m, up to rounding: bodies of half that radius stop each
    other just there. Working memory is (order (n,) int64, reached (n,) bool).
    """
    order, reached = work
    n, done, found = len(positions), 0, 1
    reach = radius * (1.0 + _ROUNDING)
    reached[:] = False
    order[0], reached[0] = 0, True
    while done < found:
        i, touched = order[done], 0
        for j in range(n):
            if j != i and apart(positions, i, j) <= reach:
                touched += 1
                if not reached[j]:
                    order[found], reached[j] = j, True
                    found += 1
        if touched < min(_TOUCHED, n - 1):
            return False
        done += 1
    return found == n


@inner_kernel
def apart(positions, i, j):
    """‖p_i − p_j‖ in the plane, a number, m; positions (n, 2)."""
    return math.hypot(positions[j, 0] - positions[i, 0], positions[j, 1] - positions[i, 1])
