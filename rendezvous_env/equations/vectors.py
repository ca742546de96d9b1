"""Small vectors as triples of numbers, for kernels that allocate nothing.

A vector of the plane has z = 0, and every function here keeps it so.
"""

import math

import numpy as np

from ..compilation import kernel

X_AXIS = (1.0, 0.0, 0.0)


@kernel
def load(row):
    """A row of d = 2 or 3 numbers as (x, y, z)."""
    z = np.float64(row[2]) if row.shape[0] == 3 else 0.0
    return np.float64(row[0]), np.float64(row[1]), z


@kernel
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def combine(p, a, q, b):
    """The vector p a + q b."""
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


@kernel
def split(a):
    """Length and unit vector; (0, zero) for the zero vector. Safe for any finite numbers."""
    square = dot(a, a)
    if 1e-200 < square < 1e200:
        length = math.sqrt(square)
        inverse = 1.0 / length
        return length, (a[0] * inverse, a[1] * inverse, a[2] * inverse)
    largest = max(abs(a[0]), abs(a[1]), abs(a[2]))
    if largest == 0.0:
        return 0.0, (0.0, 0.0, 0.0)
    b = (a[0] / largest, a[1] / largest, a[2] / largest)
    length = math.sqrt(dot(b, b))
    return largest * length, (b[0] / length, b[1] / length, b[2] / length)


@kernel
def without(a, h):
    """The part of a across the unit vector h; done twice, so that rounding leaves none of h."""
    once = combine(1.0, a, -dot(a, h), h)
    return combine(1.0, once, -dot(once, h), h)
