"""Cosine and sine of kernels, against those of the C library."""

import math

import numpy as np
import pytest

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.trigonometry import cos_sin

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
