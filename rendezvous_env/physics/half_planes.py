"""Projection onto an intersection of half-planes."""

import math

from ..compilation import kernel

_PARALLEL = 1e-12  # Sine below which two borders do not cross


@kernel
def nearest_within(wanted, normals, rooms, count):
    """Closest feasible pair x to a desired one, w, in its unit (incremental, Seidel 1991).

        min ‖x − w‖²   subject to   n_kᵀ x ≤ c_k,   c_k ≥ 0

    If x violates a constraint, the solution lies on its boundary, restricted by the previous
    constraints. The origin, which is always feasible, is the fallback for rounding. Normals n_k,
    (≥ count, 2), are unit vectors; c_k has shape (≥ count,).
    """
    x, y = wanted
    for j in range(count):
        a, b, room = normals[j, 0], normals[j, 1], rooms[j]
        if a * x + b * y <= room:
            continue
        low, high = -math.inf, math.inf
        for k in range(j):
            along = normals[k, 1] * a - normals[k, 0] * b
            left = rooms[k] - room * (normals[k, 0] * a + normals[k, 1] * b)
            if along > _PARALLEL:
                high = min(high, left / along)
            elif along < -_PARALLEL:
                low = max(low, left / along)
        if low > high:
            return 0.0, 0.0
        t = min(max(wanted[1] * a - wanted[0] * b, low), high)
        x, y = room * a - t * b, room * b + t * a
    return x, y
