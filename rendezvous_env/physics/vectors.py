"""Small vectors as tuples of numbers, without allocation, so that loops over lanes become SIMD.

Most functions take triples, with z = 0 in the plane. Those on the hot path also take pairs; the
length of the argument selects the compiled branch.
"""

import math

import numpy as np

from ..compilation import inner_kernel, kernel

X_AXIS = (1.0, 0.0, 0.0)
ORIGIN = (0.0, 0.0, 0.0)
_MANY, _FEW = 2.0**600, 2.0**-600
_VERTICAL = 1e-6
"""Minimum length in the xy plane of a unit triple that has a direction there."""


@kernel
def load(row):
    """A row (d,) as the triple v = (x, y, z), z = 0 where d is 2; in the unit of the row."""
    z = np.float64(row[2]) if row.shape[0] == 3 else 0.0
    return np.float64(row[0]), np.float64(row[1]), z


@inner_kernel
def load_pair(row):
    """A row (2,) of the plane as the pair v = (x, y), in its unit."""
    return np.float64(row[0]), np.float64(row[1])


@inner_kernel(inline="code")
def x_axis(v):
    """The x axis e_x = (1, 0, …), without unit, a pair or triple as v is."""
    return (1.0, 0.0) if len(v) == 2 else X_AXIS


@kernel(inline="code")
def triple(v):
    """A pair or triple as the triple v = (x, y, z), z = 0 for a pair; in its unit."""
    if len(v) == 2:
        return v[0], v[1], 0.0
    return v


@inner_kernel
def store(vector, out):
    """Write a triple v to the row ``out`` (d,), d = 2 or 3: out_k ← v_k, in the unit of v."""
    out[0], out[1] = vector[0], vector[1]
    if out.shape[0] == 3:
        out[2] = vector[2]


@kernel(inline="code")
def dot(a, b):
    """Scalar product aᵀb of two pairs or two triples, a number; unit of a times unit of b."""
    if len(a) == 2:
        return a[0] * b[0] + a[1] * b[1]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    """Vector product a × b of two triples, a triple; unit of a times unit of b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner_kernel(inline="code")
def cross_in_plane(a, b):
    """The number a_x b_y − a_y b_x of two pairs, or triples with z = 0; unit of a times unit of b.
    It is positive where b is to the left of a.
    """
    return a[0] * b[1] - a[1] * b[0]


@inner_kernel(inline="code")
def combine(p, a, q, b):
    """The pair or triple p a + q b of numbers p, q and two of them; unit of p times unit of a."""
    if len(a) == 2:
        return p * a[0] + q * b[0], p * a[1] + q * b[1]
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


@kernel
def add(a, factor, b):
    """The pair or triple a + factor b, in the unit of a; bitwise a where b is zero."""
    if len(a) == 2:
        return a[0] + factor * b[0], a[1] + factor * b[1]
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@kernel(inline="code")
def subtract(a, b):
    """The pair or triple a − b of two of them, in their unit."""
    if len(a) == 2:
        return a[0] - b[0], a[1] - b[1]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel(inline="code")
def norm(a):
    """Length ‖a‖ = √(aᵀa) of a pair or triple, a number in the unit of a."""
    return math.sqrt(dot(a, a))


@kernel(inline="code")
def split(a):
    """Length ‖a‖ and unit vector a/‖a‖ of a pair or triple; (0, zero) for the zero vector.

    The length is a number in the unit of a. Safe for all finite numbers, including those with
    overflowing or vanishing squares: scaling by powers of two is exact, and selects keep loops
    SIMD.
    """
    largest = max(abs(a[0]), abs(a[1]))
    if len(a) == 3:
        largest = max(largest, abs(a[2]))
    tiny, huge = largest < 1e-100, largest > 1e100
    b = scaled(a, _MANY if tiny else _FEW if huge else 1.0)
    length = math.sqrt(dot(b, b))
    inverse = 1.0 / length if length > 0.0 else 0.0
    return length * (_FEW if tiny else _MANY if huge else 1.0), scaled(b, inverse)


@kernel(inline="code")
def without(a, h):
    """Component a − (hᵀa) h across a unit pair or triple h, in the unit of a.

    It is applied twice, so that rounding leaves no component along h.
    """
    once = combine(1.0, a, -dot(a, h), h)
    return combine(1.0, once, -dot(once, h), h)


@inner_kernel(inline="code")
def split_across(a, h):
    """``split`` of the component a − (hᵀa) h across a unit vector h.

    In the plane there are two directions across h, so no division is needed; for a along h it is
    the left one.
    """
    if len(a) == 2:
        to_left = h[0] * a[1] - h[1] * a[0]
        side = 1.0 if to_left >= 0.0 else -1.0
        return abs(to_left), (-side * h[1], side * h[0])
    return split(without(a, h))


@inner_kernel(inline="code")
def perpendicular(h):
    """Perpendicular p ⊥ h of a unit pair or triple h, without unit.

    It is counter-clockwise in the xy plane, or along x if h is vertical.
    """
    if len(h) == 2:
        return -h[1], h[0]
    level = (-h[1], h[0], 0.0)
    return level if dot(level, level) >= _VERTICAL * _VERTICAL else without(X_AXIS, h)


@kernel
def rotated(v, angle):
    """A triple v, z = 0, turned counter-clockwise by α, rad: w = R(α) v, in the unit of v."""
    c, s = math.cos(angle), math.sin(angle)
    return c * v[0] - s * v[1], s * v[0] + c * v[1], 0.0


@kernel(inline="code")
def scaled(v, factor):
    """The pair or triple factor · v, factor a number; unit of v times unit of the factor."""
    if len(v) == 2:
        return v[0] * factor, v[1] * factor
    return v[0] * factor, v[1] * factor, v[2] * factor


@kernel(inline="code")
def rounded(v):
    """A pair or triple v, each v_k ← float32(v_k), in its unit."""
    x, y = np.float64(np.float32(v[0])), np.float64(np.float32(v[1]))
    if len(v) == 2:
        return x, y
    return x, y, np.float64(np.float32(v[2]))


@kernel(inline="code")
def exactly(v):
    """A pair or triple v of float32 as float64, v_k ← float64(v_k), in its unit."""
    if len(v) == 2:
        return np.float64(v[0]), np.float64(v[1])
    return np.float64(v[0]), np.float64(v[1]), np.float64(v[2])


@inner_kernel(inline="code")
def to_global(frame, v):
    """Turn a pair or triple from a local frame to the global one: w = R v, in the unit of v.

    A frame is R, local → global, row by row, 4 or 9 numbers without unit.
    """
    if len(v) == 2:
        return frame[0] * v[0] + frame[1] * v[1], frame[2] * v[0] + frame[3] * v[1]
    return (
        frame[0] * v[0] + frame[1] * v[1] + frame[2] * v[2],
        frame[3] * v[0] + frame[4] * v[1] + frame[5] * v[2],
        frame[6] * v[0] + frame[7] * v[1] + frame[8] * v[2],
    )


@inner_kernel(inline="code")
def to_local(frame, v):
    """Turn a pair or triple from the global frame to a local one: w = Rᵀ v, as ``to_global``."""
    if len(v) == 2:
        return frame[0] * v[0] + frame[2] * v[1], frame[1] * v[0] + frame[3] * v[1]
    return (
        frame[0] * v[0] + frame[3] * v[1] + frame[6] * v[2],
        frame[1] * v[0] + frame[4] * v[1] + frame[7] * v[2],
        frame[2] * v[0] + frame[5] * v[1] + frame[8] * v[2],
    )


@inner_kernel
def local_axis(frame, k):
    """Axis a_k = R e_k of a local frame in the global one, a unit triple, z = 0 in the plane."""
    if len(frame) == 4:
        return frame[k], frame[2 + k], 0.0
    return frame[k], frame[3 + k], frame[6 + k]
