"""Means of the body axis over an arc, and the gate around turn rates."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tuples import body_frame

from rendezvous_env.safety.turning import (
    gated_turn_rate,
    mean_body_axis_2d,
    mean_body_axis_3d,
    yaw_rate_law,
)

GATE = {"min_alignment": 0.1, "dead_zone": 0.05, "duration": 0.5}
rates = st.floats(-20, 20)
bearings = st.floats(-3, 3)


def axis(yaw, pitch):
    """The body axis h in the global frame."""
    return np.array(
        [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch) + 0 * yaw]
    )


def mean_by_quadrature(yaw_rate, pitch_rate, pitch, duration):
    """Mean of h by Gauss-Legendre, turned into the body frame at the start."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    t = 0.5 * duration * (nodes + 1)
    mean = axis(yaw_rate * t, pitch + pitch_rate * t) @ weights / 2
    return body_frame(3, 0.0, pitch).T @ mean


def test_mean_axis_of_a_unicycle_by_hand():
    m = mean_body_axis_2d([0.0, 1e-12, math.pi, -math.pi, math.tau], 1.0)
    expected = [[1, 0], [1, 0], [0, 2 / math.pi], [0, -2 / math.pi], [0, 0]]
    np.testing.assert_allclose(m, expected, atol=1e-12)
    assert mean_body_axis_2d(np.zeros((2, 3)), 0.1).shape == (2, 3, 2)
    np.testing.assert_allclose(mean_body_axis_2d(3e-8, 1.0), [1, 1.5e-8], rtol=1e-15)


@settings(max_examples=200, deadline=None)
@given(rates, rates, st.floats(-math.pi, math.pi), st.floats(0.01, 1))
def test_mean_axis_in_space_is_the_integral(yaw_rate, pitch_rate, pitch, duration):
    m = mean_body_axis_3d(yaw_rate, pitch_rate, pitch, duration)
    np.testing.assert_allclose(
        m, mean_by_quadrature(yaw_rate, pitch_rate, pitch, duration), atol=1e-12
    )
    assert np.linalg.norm(m) <= 1 + 1e-12


def test_a_level_robot_that_only_yaws_is_a_unicycle():
    omega = np.linspace(-5, 5, 11)
    flat = mean_body_axis_3d(omega, 0.0, 0.0, 0.3)
    np.testing.assert_allclose(flat[:, :2], mean_body_axis_2d(omega, 0.3), atol=1e-15)
    np.testing.assert_array_equal(flat[:, 2], 0)


@settings(max_examples=100, deadline=None)
@given(bearings, bearings, bearings, st.floats(-1.4, 1.4), st.floats(-3, 3))
def test_law_17_turns_the_axis_like_the_equation_without_singularity(f_x, f_y, f_z, pitch, yaw):
    """ḣ = (I − h hᵀ) f  (eqs. 14, 15)."""
    f = body_frame(3, yaw, pitch) @ [f_x, f_y, f_z]
    h, dt = axis(yaw, pitch), 1e-6
    turn = yaw_rate_law(f_y, pitch) * dt
    forward, back = (axis(yaw + s * turn, pitch + s * f_z * dt) for s in (0.5, -0.5))
    np.testing.assert_allclose((forward - back) / dt, f - h * (h @ f), atol=1e-6)


def test_law_17_is_huge_not_infinite_at_the_singularity():
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
def test_gate_of_a_unicycle_by_hand(requested, net_bearing, expected):
    rate = gated_turn_rate([requested], net_bearing, **GATE, max_rate=2.0)
    np.testing.assert_allclose(rate, [expected])


@settings(max_examples=300, deadline=None)
@given(rates, bearings, bearings, st.floats(0.01, 0.9), st.floats(0.01, 2), st.floats(0.1, 9))
def test_gate_of_a_unicycle(requested, f_x, f_y, epsilon, duration, limit):
    f = np.array([f_x, f_y])
    options = {"min_alignment": epsilon, "dead_zone": 0.05, "duration": duration}
    (rate,) = gated_turn_rate([requested], f, **options, max_rate=limit)
    free = min(max(requested, -limit), limit)
    needed, in_dead_zone = epsilon * np.linalg.norm(f), np.linalg.norm(f) <= 0.05
    left = abs(math.atan2(f_y, f_x)) / duration
    law = min(max(f_y, -limit, -left), limit, left)
    if rate != free:
        assert rate == law
        mean = abs(mean_body_axis_2d(free, duration) @ f)
        assert not in_dead_zone and (abs(f_x) < needed or mean < needed / 2)
    elif not in_dead_zone and rate != law:
        assert abs(f_x) >= needed and abs(mean_body_axis_2d(rate, duration) @ f) >= needed / 2


@settings(max_examples=300, deadline=None)
@given(st.tuples(rates, rates), st.tuples(bearings, bearings, bearings), st.floats(-3, 3))
def test_gate_in_space(requested, net_bearing, pitch):
    f, limits = np.array(net_bearing), np.array([20.0, 2.0])
    rate = gated_turn_rate(requested, f, pitch, **GATE, max_rate=limits)
    free = np.clip(requested, -limits, limits)
    needed = 0.1 * np.linalg.norm(f)
    m = mean_body_axis_3d(*free, pitch, GATE["duration"])
    keeps = abs(f[0]) >= needed and abs(m @ f) >= needed / 2
    if keeps or np.linalg.norm(f) <= 0.05:
        np.testing.assert_allclose(rate, free, rtol=1e-12)
        return
    errors = line_errors(f, pitch)
    assume((np.abs(errors) < math.pi / 2 - 1e-6).all())  # of two that are as near either will do
    np.testing.assert_allclose(rate, np.clip(errors / GATE["duration"], -limits, limits))


def line_errors(f, pitch):
    """The least yaw and pitch, each within ±π/2, that bring h onto the line of f."""
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
def test_the_gate_brings_a_body_onto_a_fixed_line_and_no_farther(net_bearing, pitch, most):
    """In as many steps as its slower coordinate needs for a quarter turn, poles or not."""
    world, yaw = body_frame(3, 0.0, pitch) @ np.array(net_bearing), 0.0
    strength = np.linalg.norm(world)
    assume(strength > 0.06)
    options = {**GATE, "min_alignment": 0.999999, "duration": 1.0}
    steps, errors = math.ceil(math.pi / 2 / most), []
    for _ in range(steps + 1):
        h = axis(yaw, pitch)
        errors.append(strength - abs(h @ world))
        f = body_frame(3, yaw, pitch).T @ world
        rate = gated_turn_rate([0.0, 0.0], f, pitch, **options, max_rate=[10 * most, most])
        yaw, pitch = yaw + rate[0], pitch + rate[1]
    assert errors[-1] <= 2e-6 * strength


@pytest.mark.parametrize("net_bearing", [(0.2, 1.0), (-0.3, 2.0), (0.15, -1.0)])
def test_the_gate_closes_exactly_where_the_mean_axis_loses_half_the_margin(net_bearing):
    f, requested = np.array(net_bearing), np.linspace(-6, 6, 4001)
    mean = np.abs(mean_body_axis_2d(requested, GATE["duration"]) @ f)
    expected = np.where(mean >= 0.05 * np.linalg.norm(f), requested, f[1])
    every_f = np.broadcast_to(f, (4001, 2))
    rate = gated_turn_rate(requested[:, None], every_f, **GATE, max_rate=6.0)[:, 0]
    np.testing.assert_array_equal(rate, expected)
    assert 50 < np.sum(rate == f[1]) < 2000


def test_an_orthogonal_unicycle_is_freed_and_only_by_the_gate():
    """An adversary that holds h ⟂ f for ever is turned towards f until it has the margin."""
    angle, strength = math.pi / 2, 1.0
    for _ in range(30):
        f = strength * np.array([math.cos(angle), math.sin(angle)])
        (rate,) = gated_turn_rate([0.0], f, **{**GATE, "duration": 0.05}, max_rate=1.0)
        angle -= 0.05 * rate
    assert math.cos(angle) >= 0.1


def test_gate_batches_and_limits():
    random = np.random.default_rng(0)
    requested, f, pitch = (
        random.normal(size=(3, 4, 2)),
        random.normal(size=(3, 4, 3)),
        random.normal(size=(3, 4)),
    )
    both = gated_turn_rate(requested, f, pitch, **GATE, max_rate=[10.0, 1.0])
    single = gated_turn_rate(requested[1, 2], f[1, 2], pitch[1, 2], **GATE, max_rate=[10.0, 1.0])
    assert both.shape == (3, 4, 2)
    np.testing.assert_array_equal(both[1, 2], single)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"requested": np.zeros((2, 2))}, r"requested has shape \(2, 2\)"),
        ({"requested": [[np.inf], [0.0]]}, "requested must be finite"),
        ({"pitch": np.zeros(2)}, "pitch must be left out"),
        ({"min_alignment": 1.5}, "min_alignment is 1.5"),
        ({"duration": 0.0}, "duration is 0.0"),
        ({"max_rate": -1.0}, "max_rate is -1.0"),
    ],
)
def test_gate_refusals_name_the_argument(change, message):
    good = {"requested": np.zeros((2, 1)), "net_bearing": np.ones((2, 2)), "max_rate": 1.0}
    with pytest.raises(ValueError, match=message):
        gated_turn_rate(**{**good, **GATE, **change})
    with pytest.raises(ValueError, match="pitch must be given"):
        gated_turn_rate(np.zeros(2), np.ones(3), **GATE, max_rate=1.0)
