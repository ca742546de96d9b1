"""First crossing of a straight path with a ball or a capsule."""

import math

import numpy as np

from ..compilation import inner_kernel, kernel
from .vectors import combine, dot, norm, subtract


@kernel
def first_crossing(offset, velocity, radius):
    """First crossing of a straight path with a ball around the origin.

    The smallest s in [0, 1] with ‖offset + s velocity‖ ≤ radius, a number; inf if there is none.
    Offset (m) and velocity (m per unit of s) are triples.
    """
    distance = norm(offset)
    if distance <= radius:
        return 0.0
    approach = -dot(offset, velocity)
    speed_squared = dot(velocity, velocity)
    if approach <= 0.0 or radius < 0.0 or speed_squared == 0.0:
        return np.inf
    miss = norm(combine(1.0, offset, approach / speed_squared, velocity))
    if miss > radius:
        return np.inf
    # the smaller root of the quadratic, as c / (-b + √(b² - ac)): no difference of near equals
    root = math.sqrt(speed_squared * (radius - miss) * (radius + miss))
    s = (distance - radius) * (distance + radius) / (approach + root)
    return s if s <= 1.0 else np.inf


@inner_kernel
def capsule_crossing(offset, velocity, half, radius):
    """``first_crossing`` with a capsule: ‖offset + s velocity − q‖ ≤ radius for a q of its segment.

    ``offset`` is relative to the centre of the segment, ``half`` points to an end, triples, m. The
    path enters through the ball around an end, or through the cylinder between them.
    """
    first = min(
        first_crossing(subtract(offset, half), velocity, radius),
        first_crossing(combine(1.0, offset, 1.0, half), velocity, radius),
    )
    length = norm(half)
    if length == 0.0:
        return first
    axis = (half[0] / length, half[1] / length, half[2] / length)
    across = combine(1.0, offset, -dot(offset, axis), axis)
    s = first_crossing(across, combine(1.0, velocity, -dot(velocity, axis), axis), radius)
    if s < first and abs(dot(combine(1.0, offset, s, velocity), axis)) <= length:
        return s
    return first
