"""One exact step of each robot model, against formulas by hand and fine numerical integration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from tuples import arc, body_frame

from rendezvous_env.robots.unicycle import mean_cos_sin

angles = st.floats(-3.2, 3.2)
rates = st.floats(-6.0, 6.0)


@given(st.floats(-3, 3), angles, rates, st.floats(0.01, 1.0))
def test_a_unicycle_in_the_plane(v, yaw, yaw_rate, duration):
    if abs(yaw_rate) < 1e-6:
        expected = v * duration * np.array([math.cos(yaw), math.sin(yaw)])
    else:
        end, radius = yaw + yaw_rate * duration, v / yaw_rate
        expected = radius * np.array([math.sin(end) - math.sin(yaw), math.cos(yaw) - math.cos(end)])
    np.testing.assert_allclose(arc(2, v, yaw, 0, yaw_rate, 0, duration), expected, atol=1e-5)


@given(st.floats(-3, 3), angles, angles, rates, rates, st.floats(0.01, 1.0))
def test_a_robot_in_space_follows_equation_9(v, yaw, pitch, yaw_rate, pitch_rate, duration):
    def velocity(t, _):
        a, b = yaw + yaw_rate * t, pitch + pitch_rate * t
        return v * np.array([math.cos(b) * math.cos(a), math.cos(b) * math.sin(a), math.sin(b)])

    solution = solve_ivp(velocity, (0, duration), np.zeros(3), rtol=1e-10, atol=1e-12)
    moved = arc(3, v, yaw, pitch, yaw_rate, pitch_rate, duration)
    np.testing.assert_allclose(moved, solution.y[:, -1], atol=1e-9)
    assert np.linalg.norm(moved) <= abs(v) * duration * (1 + 1e-12)


@pytest.mark.parametrize("rate", [1e-3, 1e-6, 1e-7, 1e-9, 1e-12, 1e-300, 0.0])
def test_no_digits_are_lost_as_the_rate_vanishes(rate):
    """Against the Taylor series, whose next term is below the last digit."""
    x = rate * 1.0
    mean_cos, mean_sin = mean_cos_sin(0.0, x)
    assert mean_sin == pytest.approx(x / 2 - x**3 / 24, rel=1e-14, abs=1e-320)
    assert mean_cos == pytest.approx(1 - x**2 / 6 + x**4 / 120, rel=1e-15)


@given(angles, angles)
def test_the_body_frame_is_a_rotation_with_the_heading_first_and_left_level(yaw, pitch):
    R = body_frame(3, yaw, pitch)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1)
    heading = [math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), math.sin(pitch)]
    np.testing.assert_allclose(R[:, 0], heading, atol=1e-15)
    assert R[2, 1] == 0
    np.testing.assert_allclose(
        R.T @ [0, 0, -1], [-math.sin(pitch), 0, -math.cos(pitch)], atol=1e-15
    )
    flat = body_frame(2, yaw, 0.0)
    np.testing.assert_allclose(flat, body_frame(3, yaw, 0.0)[:2, :2], atol=1e-15)
