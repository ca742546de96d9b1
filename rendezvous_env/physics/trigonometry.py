"""Cosine and sine of one angle without branches, so that loops over lanes become SIMD.

The library functions of C are called lane by lane, and their last digit depends on the platform.
"""

import math

import numpy as np

from ..compilation import kernel

_TURNS = 2.0 / math.pi  # quarter turns per radian
# π/2 as a sum. The first three have 23 bits, so that their products with up to 2³⁰ are exact.
_QUARTER = (
    float.fromhex("0x1.921fb4p+0"),
    float.fromhex("0x1.4442dp-24"),
    float.fromhex("0x1.846988p-48"),
    float.fromhex("0x1.8cc51701b839ap-72"),
)
_EIGHTH = 0.25 * math.pi
# (sin r − r)/r³ and (cos r − 1 + r²/2)/r⁴ as polynomials of r², interpolated at Chebyshev nodes for
# |r| ≤ π/4: errors of 2·10⁻¹⁷ and 10⁻¹⁸ of sin r and cos r
_S = (
    -0.16666666666666666,
    0.008333333333330948,
    -0.00019841269836756774,
    2.7557316101617874e-06,
    -2.505113165023518e-08,
    1.5918115263265974e-10,
)
_C = (
    0.041666666666666664,
    -0.0013888888888887398,
    2.480158729876456e-05,
    -2.7557317271145144e-07,
    2.087614614655861e-09,
    -1.1382623647474604e-11,
)


@kernel(inline="code")
def cos_sin(angle):
    """(cos a, sin a), without unit, of an angle in rad.

    The absolute error is at most 2.3·10⁻¹⁶ for |a| ≤ 10⁹. Both stay within [−1, 1] for all finite
    angles, and are NaN for others.
    """
    quarters = np.floor(_TURNS * angle + 0.5)
    rest = angle - quarters * _QUARTER[0]
    rest = (rest - quarters * _QUARTER[1]) - quarters * _QUARTER[2]
    rest = min(max(rest - quarters * _QUARTER[3], -_EIGHTH), _EIGHTH)
    square = rest * rest
    sine = _S[0] + square * (_S[1] + square * (_S[2] + square * _fourth(_S, square)))
    sine = rest + rest * (square * sine)
    cosine = _C[0] + square * (_C[1] + square * (_C[2] + square * _fourth(_C, square)))
    half = 0.5 * square
    most = 1.0 - half
    cosine = most + (((1.0 - most) - half) + square * square * cosine)
    quarter = quarters - 4.0 * np.floor(0.25 * quarters)
    crossed = (quarter == 1.0) | (quarter == 3.0)
    along, across = (sine, cosine) if crossed else (cosine, sine)
    along = -along if (quarter == 1.0) | (quarter == 2.0) else along
    return along, -across if quarter >= 2.0 else across


@kernel(inline="code")
def _fourth(factors, square):
    return factors[3] + square * (factors[4] + square * factors[5])
