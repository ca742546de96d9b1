"""The point of an intersection of half-planes that is nearest to another: who may go how far."""

import math

from ..compilation import kernel

_PARALLEL = 1e-12  # Sine below which two borders do not cross


@kernel
def nearest_within(wanted, normals, rooms, count):
    """The pair x nearest to a wanted one, w, in its unit (Seidel 1991, one by one).

        min ‖x − w‖²   subject to   n_kᵀ x ≤ c_k,   c_k ≥ 0

    While x fits, nothing is to be done; else the nearest point lies on the border that it violates,
    within what the borders before leave of that. It is the origin, which always fits, where
    rounding leaves nothing else. Normals n_k, (≥ count, 2), are unit vectors, rooms c_k (≥ count,).
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
