"""Gradient of the hull perimeter L with respect to a robot's position (guarantees, section 9).

    ∂L/∂p_i = ∫_{N_i} u du,   N_i the directions u in which robot i is the farthest

L' = Σ_i v_i·∂L/∂p_i, so a bearing rotated towards the gradient increases L most (section 11).
"""

import math

from ..compilation import inner_kernel, kernel
from .vectors import ORIGIN, combine, cross, dot, load, norm, split, store, subtract

_IN_LINE = 1e-9  # Sine of the angle between two directions below which they count as one


@kernel
def outward_directions(positions, merged_into, out):
    """Write unit vectors u_i = ∂L/∂p_i/‖∂L/∂p_i‖ to ``out`` (n, d).

    For robots inside the hull, whose motion does not change L, it is the direction away from the
    centroid, or zero. Only active robots count.
    """
    count, centre = 0, ORIGIN
    for i in range(positions.shape[0]):
        if merged_into[i] == i:
            count, centre = count + 1, combine(1.0, centre, 1.0, load(positions[i]))
    for i in range(positions.shape[0]):
        if merged_into[i] == i:
            if positions.shape[1] == 2:
                gradient = _gradient_in_plane(positions, merged_into, i)
            else:
                gradient = _gradient_in_space(positions, merged_into, i)
            if norm(gradient) <= _IN_LINE:
                gradient = combine(1.0, load(positions[i]), -1.0 / count, centre)
            store(split(gradient)[1], out[i])


@inner_kernel
def _gradient_in_plane(positions, merged_into, i):
    """Minus the sum of the bearings of both neighbours on the hull; zero inside it."""
    found, first, last = False, ORIGIN, ORIGIN
    for j in range(positions.shape[0]):
        offset = subtract(load(positions[j]), load(positions[i]))
        if merged_into[j] != j or norm(offset) == 0.0:
            continue
        if not found:
            found, first, last = True, offset, offset
        else:
            pointed, first, last = _widened(first, last, offset)
            if not pointed:
                return ORIGIN
    return combine(-1.0, split(first)[1], -1.0, split(last)[1])


@inner_kernel
def _gradient_in_space(positions, merged_into, i):
    """½ Σ over the edges of the hull at p_i: exterior dihedral angle × bearing from the other end.

    Zero inside the hull, and if all robots are on one line.
    """
    gradient = ORIGIN
    for j in range(positions.shape[0]):
        along = subtract(load(positions[j]), load(positions[i]))
        if merged_into[j] == j and norm(along) > 0.0:
            angle = _exterior_angle(positions, merged_into, i, along)
            gradient = combine(1.0, gradient, -0.5 * angle, split(along)[1])
    return gradient


@inner_kernel
def _exterior_angle(positions, merged_into, i, along):
    """Exterior dihedral angle of the hull at the line from p_i along an offset, rad.

    π minus the angle of the wedge that contains all robots; 0 if the line is no edge of the hull.
    """
    length, axis = split(along)
    found, first, last, x, y = False, ORIGIN, ORIGIN, ORIGIN, ORIGIN
    for k in range(positions.shape[0]):
        offset = subtract(load(positions[k]), load(positions[i]))
        across = combine(1.0, offset, -dot(offset, axis), axis)
        distance = norm(offset)
        if merged_into[k] != k or distance == 0.0:
            continue
        if norm(across) <= _IN_LINE * distance:
            if 0.0 < dot(offset, axis) < length * (1.0 - _IN_LINE):
                return 0.0  # this robot, nearer on the same line, is the end of the edge
            continue
        if not found:
            found, x = True, split(across)[1]
            y = cross(axis, x)
            first = last = (1.0, 0.0, 0.0)
        else:
            flat = (dot(across, x), dot(across, y), 0.0)
            pointed, first, last = _widened(first, last, flat)
            if not pointed:
                return 0.0
    if not found:
        return 0.0
    return math.pi - math.atan2(abs(cross(first, last)[2]), dot(first, last))


@inner_kernel
def _widened(first, last, new):
    """Extend a wedge of the plane, from ``first`` counter-clockwise to ``last``, by a direction.

    Returns also whether it is still at most π wide.
    """
    from_first, from_last = cross(first, new)[2], cross(last, new)[2]
    if from_first < 0.0 and from_last > 0.0:
        return False, first, last
    if from_last > 0.0 or (from_first == 0.0 and from_last == 0.0 and dot(first, new) < 0.0):
        return True, first, new
    if from_first < 0.0:
        return True, new, last
    return True, first, last
