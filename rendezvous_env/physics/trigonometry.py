"""Cosine, sine and arctangent without branches, so that loops over lanes become SIMD.

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
# (atan t − t)/t³ as a polynomial of t², likewise for |t| ≤ 1/3: error of 2·10⁻¹⁸ of (atan t)/t
_A = (
    -0.3333333333333333,
    0.1999999999999738,
    -0.14285714284934276,
    0.11111111020815218,
    -0.0909090376763387,
    0.07692126730373454,
    -0.06662899051580884,
    0.0583330243012363,
    -0.0486935598723719,
    0.02923200151550045,
)
_HALF = float.fromhex("0x1.dac670561bb4fp-2"), float.fromhex("0x1.a2b7f222f65e2p-56")
"""atan(1/2) as a sum."""
_PI = math.pi, float.fromhex("0x1.1a62633145c07p-53")


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


@kernel(inline="code")
def arctangent(y, x):
    """Angle of the vector (x, y) from the x axis, rad in [−π, π], as ``math.atan2``.

    The relative error is at most 3·10⁻¹⁶. Coordinates are at most 8·10³⁰⁷, of any unit; of two
    zeros the signs count. It is NaN if one is NaN or both are infinite.
    """
    along, across = abs(x), abs(y)
    steep = across > along
    small, large = (along, across) if steep else (across, along)
    # atan(a/b) = atan(1/2) + atan((2a − b)/(2b + a)), where the difference is exact
    beyond = 3.0 * small > large
    top, bottom = (2.0 * small - large, 2.0 * large + small) if beyond else (small, large)
    tangent = top / (bottom if bottom != 0.0 else 1.0)
    square = tangent * tangent
    bend = _A[6] + square * (_A[7] + square * (_A[8] + square * _A[9]))
    bend = _A[3] + square * (_A[4] + square * (_A[5] + square * bend))
    bend = _A[0] + square * (_A[1] + square * (_A[2] + square * bend))
    high, low = _HALF if beyond else (0.0, 0.0)
    angle = high + (tangent + (tangent * (square * bend) + low))
    back = math.copysign(1.0, x) < 0.0
    first = 0.5 if steep else (1.0 if back else 0.0)  # half turns
    angle = first * _PI[0] + ((-angle if steep != back else angle) + first * _PI[1])
    return math.copysign(angle, y)
