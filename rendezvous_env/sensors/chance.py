"""Random numbers and rotations in float32, without branches, each from a word of 32 bits.

Over the lanes of many environments they become SIMD. No library function is used, so that results
are bitwise equal for one environment, many, and plain Python.
"""

import math

import numpy as np

from ..compilation import kernel
from ..physics.random_streams import mix
from ..physics.vectors import combine, norm


def _float32(*factors: float) -> tuple[np.float32, ...]:
    return tuple(map(np.float32, factors))


_STEP = np.uint64(0xD1B54A32D192ED03)
_HALF, _ONE, _TWO = np.float32(0.5), np.float32(1.0), np.float32(2.0)
_ONE_BIT, _EIGHT_BITS = np.uint32(1), np.uint32(8)
_TO_UNIT_INTERVAL, _TURN = np.float32(2.0**-24), np.float32(2.0 * math.pi)
_WITHIN = np.float32(1.0 - 2.0**-20)
"""Factor that keeps a vector within its bound in spite of rounding."""
_PER_MAGNITUDE = np.float32(2.0**-31)
_TURN_PER_WORD = np.float32(2.0 * math.pi * 2.0**-32)
_MANTISSA = np.int32(23)
_TWO_THIRDS = np.int32(0x3F2AAAAB)  # its bits; a mantissa m ∈ [2/3, 4/3) is counted from there
_LOG_2 = np.float32(math.log(2.0))
_LOG = _float32(
    0.9999989912342966, -0.5000382460121644, 0.3334500819861033, -0.24795877235834773,
    0.19661320093766646, -0.1970276719897473, 0.17820187987880562,
)  # fmt: skip
"""Coefficients of log(1 + f)/f, in ascending powers of f ∈ [−1/3, 1/3]: to 2.2·10⁻⁷ of the
logarithm."""

_UPPER = _float32(
    1.2533142806544626, 0.452894784668922, 0.089987094324385, 0.011902153349247773,
    0.001002491338762828, 2.9212625387046752e-05,
)  # fmt: skip
_LOWER = _float32(
    1.0, 0.0995612165585267, 0.032691129366930895, 0.0022913411154914425,
    0.00016975306862813063, 1.003840129258438e-06,
)  # fmt: skip
"""Coefficients of Φ⁻¹((1 + x)/2)/x, in ascending powers of w = −log(1 − x²) ∈ [0, 21.5]: a
minimax rational function, with relative error 1.2·10⁻⁷."""

_ROUNDS = np.float32(1.5 * 2.0**23)  # adding it leaves the nearest integer in the last bits
_QUARTERS = np.float32(2.0 / math.pi)
# π/2 as a short number with exact multiples, and the remainder
_QUARTER = (np.float32(1.5703125), np.float32(0.5 * math.pi - 1.5703125))
_SMALL = np.float32(0.123)  # rad; 6.34 times as much is still below π/4
_SINE = _float32(-1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4)
_COSINE = _float32(4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5)


@kernel
def step_key(key, step):
    """Key of the part of a stream that belongs to one step of the episode; uint64."""
    return mix(key ^ (np.uint64(step + 1) * _STEP))


@kernel(inline="code")
def unit_number(word):
    """A number in [0, 1), float32, from a word, uint32."""
    return np.float32(np.int32(word >> _EIGHT_BITS)) * _TO_UNIT_INTERVAL


@kernel(inline="code")
def drawn_within(radius, words, other, axes):
    """Pair or triple, uniform in a disc or ball, in float32, from four or five uint32.

    The largest of d uniform numbers u has the distribution of the length, P(r < x R) = xᵈ:

        r = R max u,   v = r (cos α, sin α)   or   r (√(1 − h²) cos α, √(1 − h²) sin α, h)
    """
    one, two, three, four = words
    length = radius * _WITHIN * max(unit_number(one), unit_number(two))
    x, y = cosine_and_sine(_TURN * unit_number(four), False)
    if len(axes) == 2:
        return length * x, length * y
    length = max(length, radius * _WITHIN * unit_number(three))
    height = _TWO * unit_number(other) - _ONE
    level = length * np.float32(math.sqrt(_ONE - height * height))
    return level * x, level * y, length * height


@kernel(inline="code")
def gaussian(word):
    """Standard normal number, float32: the inverse distribution function at a uniform uint32.

        z = Φ⁻¹((1 + x)/2) = ± |x| R(w),   w = −log(1 − x²)   (the variable of Giles, 2010)

    The lowest bit of the word is the sign, the others are |x|, so that |z| ≤ 6.34 with 1,200 values
    beyond 5.
    """
    y = (np.float32(np.int32(word >> _ONE_BIT)) + _HALF) * _PER_MAGNITUDE  # 1 − |x|
    v = y * (_TWO - y)  # 1 − x², as precise in the tails
    bits = np.float32(v).view(np.int32)
    exponent = np.int32(np.int32(bits - _TWO_THIRDS) >> _MANTISSA)
    f = np.int32(bits - np.int32(exponent << _MANTISSA)).view(np.float32) - _ONE
    w = -(f * _polynomial(_LOG, f)) - np.float32(exponent) * _LOG_2
    z = (_ONE - y) * (_polynomial(_UPPER, w) / _polynomial(_LOWER, w))
    return -z if word & _ONE_BIT else z


@kernel(inline="code")
def _polynomial(factors, x):
    """Polynomial by Horner's rule; 3, 6 or 7 coefficients in ascending powers."""
    if len(factors) == 3:
        return (factors[2] * x + factors[1]) * x + factors[0]
    high = (factors[5] * x + factors[4]) * x + factors[3]
    if len(factors) == 7:
        high = ((factors[6] * x + factors[5]) * x + factors[4]) * x + factors[3]
    return ((high * x + factors[2]) * x + factors[1]) * x + factors[0]


@kernel(inline="code")
def cosine_and_sine(angle, small):
    """Pair (cos α, sin α), to 10⁻⁷, of a float32 angle of at most some thousand rad.

    Computed from the distance to the nearest multiple of π/2 (coefficients of Cephes, Moshier). A
    ``small`` angle, at most π/4, needs no reduction.
    """
    if small:
        return _near_zero(angle)
    shifted = angle * _QUARTERS + _ROUNDS
    quarter, count = np.float32(shifted).view(np.int32), shifted - _ROUNDS
    cosine, sine = _near_zero((angle - count * _QUARTER[0]) - count * _QUARTER[1])
    swapped = (quarter & 1) != 0
    c, s = (sine if swapped else cosine), (cosine if swapped else sine)
    return (-c if (quarter + 1) & 2 else c), (-s if quarter & 2 else s)


@kernel(inline="code")
def _near_zero(angle):
    square = angle * angle
    sine = angle + angle * (square * _polynomial(_SINE, square))
    return _ONE - _HALF * square + square * square * _polynomial(_COSINE, square), sine


@kernel(inline="code")
def is_small(deviation):
    """True if no angle of this standard deviation, rad, exceeds π/4."""
    return deviation <= _SMALL


@kernel(inline="code")
def turned_by_chance(row, deviation, small, word, other):
    """Row rotated by an angle α ~ N(0, deviation²); its length and zero rows are unchanged.

    In 2-D the rotation is counterclockwise, in 3-D towards a uniformly distributed direction about
    the row.

        R(α) g,   or   cos α g + sin α ‖g‖ t,   t = cos φ b + sin φ c,   b, c, g orthogonal

    The row and the deviation, rad, are float32; α is computed from ``word`` and φ from ``other``,
    uint32.
    """
    return turned_by_angle(row, deviation * gaussian(word), small, other)


@kernel(inline="code")
def turned_by_angle(row, angle, small, other):
    """``turned_by_chance`` by a given angle α, rad, float32; ``small`` as ``cosine_and_sine``."""
    c, s = cosine_and_sine(angle, small)
    if len(row) == 2:
        return c * row[0] - s * row[1], s * row[0] + c * row[1]
    return combine(
        c, row, s, _across(row, np.float32(np.uint32(other).view(np.int32)) * _TURN_PER_WORD)
    )


@kernel(inline="code")
def _across(row, turn):
    """Triple perpendicular to a row, of equal length, at an angle about it.

    After Duff et al., "Building an orthonormal basis, revisited", 2017.
    """
    (x, y, z), (c, s) = row, cosine_and_sine(turn, False)
    length = np.float32(norm(row))
    sign, height = _ONE if z >= 0 else -_ONE, abs(z) + length
    level = c * sign * x + s * y
    share = level / (height if height > 0 else _ONE)
    return c * length - sign * x * share, sign * (s * length - y * share), -level
