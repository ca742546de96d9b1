"""What obstacles touched leave free of a velocity: the projection onto the cone of free directions.

T(p) = {w : wᵀn ≥ 0 for the normal n of every obstacle touched at p}
"""

import math

from ..compilation import kernel
from .obstacles import distance_to, normals
from .vectors import ORIGIN, add, cross, dot, load, store

_NEARLY_PARALLEL = 1e-24  # square sine of the angle between two planes that meet in no line


@kernel
def free_part(velocity, point, world, reach, touched):
    """Π_T v: a velocity projected onto the directions that the obstacles touched leave free.

    Of the projections onto the faces of the cone T — v itself, planes, the lines in which two
    planes meet, 0 — that lie in T, the longest is the projection onto T.

    Args:
        velocity: v, a triple, m/s, or of any other unit; its z is 0 in the plane.
        point: a triple, m.
        world: obstacles of the team.
        reach: touched are those nearer to the point than this, m.
        touched: (2M, 3) working memory.

    Returns:
        Π_T v, a triple in the unit of v; z = 0 in the plane.
    """
    count = _normals_touched(point, world, reach, touched)
    if _is_free(velocity, touched, count):
        return velocity
    longest, best = 0.0, ORIGIN
    for i in range(count):
        for j in range(i, count):
            candidate = _onto_face(velocity, load(touched[i]), load(touched[j]))
            length = dot(candidate, candidate)
            if length > longest and _is_free(candidate, touched, count):
                longest, best = length, candidate
    return best


@kernel
def _normals_touched(point, world, reach, touched):
    """Two normals of every obstacle touched, one after the other; their number."""
    count = 0
    for m in range(world.kinds.shape[0]):
        if distance_to(world, m, point) < reach:
            normal, other = normals(world, m, point)
            store(normal, touched[count])
            store(other, touched[count + 1])
            count += 2
    return count


@kernel
def _is_free(velocity, touched, count):
    """Whether a velocity enters no obstacle touched: it keeps before one of its two planes."""
    rounding = 1e-12 * math.sqrt(dot(velocity, velocity))
    for i in range(0, count, 2):
        one, other = load(touched[i]), load(touched[i + 1])
        if max(dot(velocity, one), dot(velocity, other)) < -rounding:
            return False
    return True


@kernel
def _onto_face(velocity, m, n):
    """Project a velocity onto the plane with normal n = m, or else onto the line m × n.

    In the plane that line is the vertical, across every velocity: 0 is left of it.
    """
    line = cross(m, n)
    squared = dot(line, line)
    if squared < _NEARLY_PARALLEL:
        return add(velocity, -dot(velocity, n), n)
    along = dot(velocity, line) / squared
    return along * line[0], along * line[1], along * line[2]
