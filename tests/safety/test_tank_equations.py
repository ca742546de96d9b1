"""The equations of the energy tank, by hand."""

import math

import numpy as np
import pytest
from tuples import triple

from rendezvous_env.safety.settings import error_chord
from rendezvous_env.safety.tank import (
    certain_descent,
    descending_velocity,
    descent_scale,
    promised_descent,
)


@pytest.mark.parametrize(
    ("strength", "degree", "radius", "duration", "limit", "expected"),
    [
        (1.0, 2.0, 0.4, 0.1, 5.0, 1.0),  # the certified step, slow enough
        (1.0, 2.0, 0.4, 0.3, 5.0, 1 / 3),  # three times as long
        (4.0, 2.0, 0.4, 0.1, 1.0, 0.25),  # faster than the robot may go
        (0.0, 2.0, 0.4, 0.1, 1.0, 1.0),
    ],
)
def test_the_scale(strength, degree, radius, duration, limit, expected):
    found = descent_scale(strength, degree, radius, duration, limit)
    assert found == pytest.approx(expected, rel=1e-15)


def test_what_a_step_earns_and_owes():
    f, displacement = triple([3.0, 4.0]), triple([0.1, -0.2])
    # 2 (0.3 − 0.8) − (2/0.5) 6 (0.01 + 0.04)
    assert certain_descent(f, 6.0, displacement, 0.5) == pytest.approx(-1.0 - 1.2, rel=1e-15)
    assert promised_descent(5.0, 0.5, 0.2, 0.1) == pytest.approx(0.04 * 0.1 * 0.5 * 25, rel=1e-15)


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [
        ((0.0, 0.0), (1.0, 0.0)),  # nothing: law (1)
        ((5.0, 0.0), (1.0, 0.0)),
        ((-3.0, 0.0), (1.0, 0.0)),  # away: the same line
        ((1.0, 1.0), (0.5, 0.5)),
        ((-1.0, -1.0), (0.5, 0.5)),
        ((0.0, 2.0), (0.36, 0.48)),  # across: the edge of the cap, h = (0.6, 0.8)
    ],
)
def test_law_4_along_the_wanted_line(wanted, expected):
    velocity = descending_velocity(triple(wanted), triple([2.0, 0.0]), 0.5, 0.6)
    np.testing.assert_allclose(velocity, (*expected, 0.0), atol=1e-15)


def test_an_empty_tank_is_never_overdrawn():
    """G ≥ τ s ((hᵀf)² − ε²‖f‖²) ≥ 0 for law (4) along whatever is wanted."""
    random = np.random.default_rng(0)
    for _ in range(500):
        f, wanted = random.normal(size=3), random.normal(size=3)
        strength, margin = float(np.linalg.norm(f)), random.uniform(0.01, 0.99)
        degree, radius = strength * random.uniform(1, 4), random.uniform(0.1, 1)
        duration, limit = random.uniform(0.01, 3) * radius / degree, random.uniform(0.1, 9)
        scale = descent_scale(strength, degree, radius, duration, limit)
        error = random.choice([0.0, 1.0]) * random.uniform(0, strength)
        given = triple(wanted), triple(f), scale, margin, error
        velocity = np.array(descending_velocity(*given))
        assert np.linalg.norm(velocity) <= limit * (1 + 1e-12)
        owed = promised_descent(strength, scale, margin, duration, error)
        moved = triple(velocity * duration)
        deposit = certain_descent(triple(f), degree, moved, radius, error) - owed
        assert deposit >= -1e-12 * duration * strength**2
        if error > 0.0:
            continue
        along = f @ velocity / np.linalg.norm(velocity)
        assert along >= margin * strength * (1 - 1e-12)
        least = duration * scale * (along**2 - margin**2 * strength**2)
        assert deposit >= least - 1e-12 * duration * strength**2


def test_what_a_step_earns_and_owes_with_errors():
    f, moved = triple([3.0, 4.0]), triple([0.3, 0.4])
    free = certain_descent(f, 6.0, moved, 0.5)
    assert certain_descent(f, 6.0, moved, 0.5, 0.7) == pytest.approx(free - 2 * 0.7 * 0.5)
    assert promised_descent(5.0, 0.5, 0.2, 0.1, 0.4) == pytest.approx(0.1 * 0.5 * 0.6**2)
    assert promised_descent(5.0, 0.5, 0.2, 0.1, 1.1) == 0.0
    velocity = descending_velocity(triple([1.0, 0.0]), triple([2.0, 0.0]), 0.5, 0.6, 0.5)
    assert velocity == pytest.approx((0.75, 0.0, 0.0))
    assert error_chord(math.pi / 3) == pytest.approx(1.0)
