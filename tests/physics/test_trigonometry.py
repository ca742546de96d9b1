"""Cosine, sine and arctangent of kernels, against those of the C library."""

import math

import numpy as np
import pytest

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.trigonometry import arctangent, cos_sin

pytestmark = pytest.mark.kernels
ANGLES = [
    *np.linspace(-7.0, 7.0, 1001),
    *(0.5 * math.pi * np.arange(-40, 41)),
    *(10.0 ** np.arange(-300, 10, 10)),
    *np.random.default_rng(3).uniform(-1e9, 1e9, 1000),
    *np.random.default_rng(4).uniform(-1e5, 1e5, 1000),
]


@kernel
def fill(angles, out):
    for k in range(len(angles)):
        out[k, 0], out[k, 1] = cos_sin(angles[k])


def over(angles):
    angles = np.asarray(angles, float)
    out = np.empty((len(angles), 2))
    fill(angles, out)
    return out


def test_cos_sin_is_within_rounding_of_the_library():
    wanted = [(math.cos(angle), math.sin(angle)) for angle in ANGLES]
    # 2.3e-16, and half a unit in the last place of the library
    assert abs(over(ANGLES) - wanted).max() <= 2.3e-16 + 1.2e-16


def test_cos_sin_of_small_angles_keeps_all_digits():
    angles = 10.0 ** np.arange(-300.0, -8.0, 7.0)
    assert (over(angles)[:, 1] == angles).all()
    assert (over(-angles)[:, 1] == -angles).all()
    assert (over(angles)[:, 0] == 1.0).all()


def test_cos_sin_is_even_and_odd():
    there, back = over(ANGLES), over(np.negative(ANGLES))
    away = abs(there).min(axis=1) > 1e-9  # halfway between two quarters, rounding goes up
    assert abs(there[:, 0] - back[:, 0])[away].max() <= 2.3e-16
    assert abs(there[:, 1] + back[:, 1])[away].max() <= 2.3e-16


def test_cos_sin_of_huge_angles_is_bounded():
    pairs = over([1e10, -3e15, 1e100, -1.7e308])
    assert abs(pairs).max() <= 1.0
    assert np.hypot(*pairs.T) == pytest.approx(1.0, abs=1e-15)


def test_cos_sin_of_no_angle_is_nan():
    assert np.isnan(over([math.inf, -math.inf, math.nan])).all()


def test_cos_sin_interpreted_equals_compiled():
    plain = getattr(cos_sin, "py_func", cos_sin)
    assert [plain(angle) for angle in ANGLES[:200]] == [tuple(pair) for pair in over(ANGLES[:200])]


@kernel
def angles_of(vectors, out):
    for k in range(len(out)):
        out[k] = arctangent(vectors[k, 1], vectors[k, 0])


def arctangents(vectors):
    vectors = np.asarray(vectors, float)
    out = np.empty(len(vectors))
    angles_of(vectors, out)
    return out


def library(vectors):
    return np.array([math.atan2(y, x) for x, y in vectors])


def directions():
    """Vectors in all quadrants, near the axes, near slopes 1/3, 1/2 and 1, and of many lengths."""
    random = np.random.default_rng(5)
    vectors = random.normal(size=(20_000, 2))
    vectors[:5000, 0] *= 10.0 ** random.uniform(-300, 0, 5000)
    vectors[5000:10_000, 1] *= 10.0 ** random.uniform(-300, 0, 5000)
    slopes = random.choice([1 / 3, 1 / 2, 1.0, 2.0, 3.0], 5000) * (1 + random.normal(0, 1e-3, 5000))
    vectors[10_000:15_000, 1] = slopes * vectors[10_000:15_000, 0]
    return vectors * 10.0 ** random.uniform(-300, 300, (20_000, 1)).clip(-250, 250)


def test_arctangent_is_within_rounding_of_the_library():
    vectors = directions()
    wanted = library(vectors)
    assert len({(x > 0, y > 0, abs(x) > abs(y)) for x, y in vectors}) == 8
    error = abs(arctangents(vectors) - wanted)
    # denormal results have an absolute error
    assert (error <= 2.0 * np.spacing(abs(wanted))).all()
    assert (error <= 3e-16 * abs(wanted) + 5e-324).all()


def test_arctangent_of_zeros_and_axes_is_exact():
    numbers = [0.0, -0.0, 5e-324, -5e-324, 1.0, -1.0]
    vectors = [(x, y) for x in numbers for y in numbers]
    vectors += [(x, y) for x in (math.inf, -math.inf) for y in numbers]
    vectors += [(x, y) for y in (math.inf, -math.inf) for x in numbers]
    found, wanted = arctangents(vectors), library(vectors)
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(wanted))


def test_arctangent_is_odd():
    vectors = directions()
    np.testing.assert_array_equal(arctangents(vectors * [1, -1]), -arctangents(vectors))


def test_arctangent_of_no_vector_is_nan():
    infinite = [(x, y) for x in (math.inf, -math.inf) for y in (math.inf, -math.inf)]
    assert np.isnan(arctangents([*infinite, (math.nan, 1.0), (1.0, math.nan)])).all()


def test_arctangent_interpreted_equals_compiled():
    plain, vectors = getattr(arctangent, "py_func", arctangent), directions()[::100]
    assert [plain(y, x) for x, y in vectors] == arctangents(vectors).tolist()
