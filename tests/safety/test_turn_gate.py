"""Mean of the body axis over an arc, and the gate of turn rates."""

import math

import numpy as np
import pytest
from geometry import body_frame, mean_body_axis, triple
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rendezvous_env.safety.turning import Gate, gated_rates, mean_axis, yaw_rate_law

pytestmark = pytest.mark.kernels

GATE = Gate(True, 0.1, 0.05, 0.5, 2.0, 0.0)
IN_SPACE = GATE._replace(planar=False, yaw_limit=20.0, pitch_limit=2.0)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(80)
rates = st.floats(-20, 20)
bearings = st.floats(-3, 3)


def axis(yaw, pitch):
    """Body axis h in the global frame."""
    flat = np.cos(pitch)
    return np.array([flat * np.cos(yaw), flat * np.sin(yaw), np.sin(pitch) + 0 * yaw])


def mean_by_quadrature(yaw_rate, pitch_rate, pitch, duration):
    """Mean of h by Gauss-Legendre quadrature, in the initial body frame."""
    t = 0.5 * duration * (NODES + 1)
    mean = axis(yaw_rate * t, pitch + pitch_rate * t) @ WEIGHTS / 2
    return body_frame(3, 0.0, pitch).T @ mean


def gated(requested, net_bearing, pitch=0.0, gate=GATE):
    """Turn rates of one robot, (d − 1,)."""
    wanted = (*np.atleast_1d(requested).tolist(), 0.0)[:2]
    return np.array(gated_rates(wanted, triple(net_bearing), pitch, gate))[: len(net_bearing) - 1]


def test_mean_axis_matches_hand_computation():
    gate = GATE._replace(duration=1.0)
    m = [mean_axis((rate, 0.0), 0.0, gate)[:2] for rate in (0.0, 1e-12, math.pi, -math.pi)]
    expected = [[1, 0], [1, 0], [0, 2 / math.pi], [0, -2 / math.pi]]
    np.testing.assert_allclose(m, expected, atol=1e-12)
    np.testing.assert_allclose(mean_axis((3e-8, 0.0), 0.0, gate), [1, 1.5e-8, 0], rtol=1e-15)


@settings(max_examples=200, deadline=None)
@given(rates, rates, st.floats(-math.pi, math.pi), st.floats(0.01, 1))
def test_mean_axis_equals_integral(yaw_rate, pitch_rate, pitch, duration):
    mean = mean_by_quadrature(yaw_rate, pitch_rate, pitch, duration)
    m = mean_axis((yaw_rate, pitch_rate), pitch, IN_SPACE._replace(duration=duration))
    for found in (m, mean_body_axis(yaw_rate, pitch_rate, pitch, duration)):
        np.testing.assert_allclose(found, mean, atol=1e-12)
    assert np.linalg.norm(m) <= 1 + 1e-12
    flat = mean_axis((yaw_rate, 0.0), 0.0, GATE._replace(duration=duration))
    np.testing.assert_allclose(flat, mean_body_axis(yaw_rate, 0.0, 0.0, duration), atol=1e-14)


@given(bearings, bearings, bearings, st.floats(-1.4, 1.4), st.floats(-3, 3))
def test_law_17_matches_equation_without_singularity(f_x, f_y, f_z, pitch, yaw):
    """ḣ = (I − h hᵀ) f  (eqs. 14, 15)."""
    f = body_frame(3, yaw, pitch) @ [f_x, f_y, f_z]
    h, dt = axis(yaw, pitch), 1e-6
    turn = yaw_rate_law(f_y, pitch) * dt
    forward, back = (axis(yaw + s * turn, pitch + s * f_z * dt) for s in (0.5, -0.5))
    np.testing.assert_allclose((forward - back) / dt, f - h * (h @ f), atol=1e-6)


def test_law_17_is_finite_at_singularity():
    rate = yaw_rate_law(np.array([1.0, -1.0, 0.0]), np.full(3, math.pi / 2))
    assert np.isfinite(rate).all() and rate[0] > 1e8 and rate[1] < -1e8 and rate[2] == 0


@pytest.mark.parametrize(
    ("requested", "net_bearing", "expected"),
    [
        (0.3, [1.0, 0.0], 0.3),  # aligned and stays so: free
        (9.0, [1.0, 0.0], 2.0),  # free, but clipped
        (0.3, [0.05, 1.0], 1.0),  # |hᵀf| < ε‖f‖: law (8)
        (0.3, [-0.05, -1.0], -1.0),
        (0.3, [0.0, 5.0], 2.0),  # law (8), clipped
        (0.3, [0.0, 0.04], 0.3),  # in the dead zone: free
        (-0.8, [0.2, 1.0], 1.0),  # would swing to |mᵀf| ≈ 0
        (0.8, [0.2, 1.0], 0.8),  # would swing towards f
        (0.8, [-0.2, 1.0], 1.0),  # the back end swings away from it
    ],
)
def test_unicycle_gate_matches_hand_computation(requested, net_bearing, expected):
    np.testing.assert_allclose(gated(requested, net_bearing), [expected])


@settings(max_examples=300, deadline=None)
@given(rates, bearings, bearings, st.floats(0.01, 0.9), st.floats(0.01, 2), st.floats(0.1, 9))
def test_unicycle_gate_keeps_alignment(requested, f_x, f_y, epsilon, duration, limit):
    f = np.array([f_x, f_y])
    gate = Gate(True, epsilon, 0.05, duration, limit, 0.0)
    (rate,) = gated(requested, f, gate=gate)
    free = min(max(requested, -limit), limit)
    needed, in_dead_zone = epsilon * np.linalg.norm(f), np.linalg.norm(f) <= 0.05
    left = abs(math.atan2(f_y, f_x)) / duration
    law = min(max(f_y, -limit, -left), limit, left)
    if rate != free:
        assert rate == law
        mean = abs(mean_body_axis(free, 0.0, 0.0, duration)[:2] @ f)
        assert not in_dead_zone and (abs(f_x) < needed or mean < needed / 2)
    elif not in_dead_zone and rate != law:
        mean = abs(mean_body_axis(rate, 0.0, 0.0, duration)[:2] @ f)
        assert abs(f_x) >= needed and mean >= needed / 2


@settings(max_examples=300, deadline=None)
@given(st.tuples(rates, rates), st.tuples(bearings, bearings, bearings), st.floats(-3, 3))
def test_gate_in_3d_keeps_alignment(requested, net_bearing, pitch):
    f, limits = np.array(net_bearing), np.array([20.0, 2.0])
    rate = gated(requested, f, pitch, IN_SPACE)
    free = np.clip(requested, -limits, limits)
    needed = 0.1 * np.linalg.norm(f)
    m = mean_body_axis(*free, pitch, GATE.duration)
    keeps = abs(f[0]) >= needed and abs(m @ f) >= needed / 2
    if keeps or np.linalg.norm(f) <= 0.05:
        np.testing.assert_allclose(rate, free, rtol=1e-12)
        return
    errors = line_errors(f, pitch)
    assume((np.abs(errors) < math.pi / 2 - 1e-6).all())  # of two that are as near either will do
    np.testing.assert_allclose(rate, np.clip(errors / GATE.duration, -limits, limits))


def line_errors(f, pitch):
    """Smallest yaw and pitch, each within ±π/2, that align h with the line of f."""
    world = body_frame(3, 0.0, pitch) @ f
    found = []
    for end in (world, -world):
        yaw = math.atan2(end[1], end[0])
        if abs(yaw) <= math.pi / 2:
            rise = math.atan2(end[2], math.hypot(end[0], end[1])) - pitch
            found.append((yaw, rise - math.pi * round(rise / math.pi)))
    return np.array(found[0])


@settings(max_examples=200, deadline=None)
@given(st.tuples(bearings, bearings, bearings), st.floats(-3, 3), st.floats(0.05, 1.5))
def test_gate_turns_body_onto_line_without_overshoot(net_bearing, pitch, most):
    """The number of steps is that of a quarter turn of the slower coordinate, at poles as well."""
    world, yaw = body_frame(3, 0.0, pitch) @ np.array(net_bearing), 0.0
    strength = np.linalg.norm(world)
    assume(strength > 0.06)
    gate = Gate(False, 0.999999, 0.05, 1.0, 10 * most, most)
    steps, errors = math.ceil(math.pi / 2 / most), []
    for _ in range(steps + 1):
        h = axis(yaw, pitch)
        errors.append(strength - abs(h @ world))
        f = body_frame(3, yaw, pitch).T @ world
        rate = gated([0.0, 0.0], f, pitch, gate)
        yaw, pitch = yaw + rate[0], pitch + rate[1]
    assert errors[-1] <= 2e-6 * strength
