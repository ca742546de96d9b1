"""Exact step of each robot model: compared with formulas and numerical integration."""

import math

import numpy as np
import pytest
from geometry import arc, body_frame
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad, solve_ivp

from rendezvous_env.robots import motion
from rendezvous_env.robots.double_integrator import DoubleIntegrator, final_velocity, mean_speed
from rendezvous_env.robots.single_integrator import SingleIntegrator
from rendezvous_env.robots.unicycle import mean_cos_sin

pytestmark = pytest.mark.kernels

angles = st.floats(-3.2, 3.2)
rates = st.floats(-6.0, 6.0)


@pytest.mark.parametrize("d", [2, 3])
@given(st.floats(-3, 3), angles, angles, rates, rates, st.floats(0.01, 1.0))
def test_nonholonomic_3d_follows_equation_9(d, v, yaw, pitch, yaw_rate, pitch_rate, duration):
    """A unicycle has the same equation without a pitch."""

    def velocity(t, _):
        a, b = yaw + yaw_rate * t, (pitch + pitch_rate * t) * (d == 3)
        return v * np.array([math.cos(b) * math.cos(a), math.cos(b) * math.sin(a), math.sin(b)])

    solution = solve_ivp(velocity, (0, duration), np.zeros(3), rtol=1e-10, atol=1e-12)
    moved = arc(d, v, yaw, pitch, yaw_rate, pitch_rate, duration)
    np.testing.assert_allclose(moved, solution.y[:d, -1], atol=1e-9)
    assert np.linalg.norm(moved) <= abs(v) * duration * (1 + 1e-12)


@pytest.mark.parametrize("rate", [1e-3, 1e-6, 1e-7, 1e-9, 1e-12, 1e-300, 0.0])
def test_small_turn_rates_are_accurate(rate):
    """Compared with the Taylor series, whose next term is below the last digit."""
    x = rate * 1.0
    mean_cos, mean_sin = mean_cos_sin(0.0, x)
    assert mean_sin == pytest.approx(x / 2 - x**3 / 24, rel=1e-14, abs=1e-320)
    assert mean_cos == pytest.approx(1 - x**2 / 6 + x**4 / 120, rel=1e-15)


@given(angles, angles)
def test_body_frame_is_rotation_with_heading_first(yaw, pitch):
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


TAU, V_MAX, A_MAX = 0.4, 2.0, 5.0


def test_default_equations_describe_straight_motion_without_memory():
    model, frame, action = SingleIntegrator(0.1, 1.0), (0.6, -0.8, 0.8, 0.6), (3.0, 4.0)
    defaults = motion.motion_of(SingleIntegrator)
    way, _ = defaults.propose(model, action, frame, ())
    half = defaults.displacement_at(model, action, frame, (), 0.05)
    np.testing.assert_allclose(half, np.array(way) / 2.0, rtol=1e-15)
    assert math.hypot(*way) == pytest.approx(0.1)
    assert defaults.chord_error_bound(model, action, ()) == 0.0
    assert defaults.update(model, action, frame, (1.5,), way, motion.FREE) == (1.5,)
    assert defaults.frame(model, frame, ()) == frame and defaults.sense(model, frame, ()) == ()
    assert defaults.init(model, 1, 0) == () and defaults.period(model, action, ()) == math.inf


MODEL = DoubleIntegrator(TAU, V_MAX, A_MAX, (0.0, 0.0))
GLOBAL = (1.0, 0.0, 0.0, 1.0)
numbers = st.floats(-3, 3).map(lambda x: round(x, 4))
pairs = arrays(np.float64, 2, elements=numbers).map(lambda v: tuple(v.tolist()))
triples = arrays(np.float64, 3, elements=numbers).map(lambda v: tuple(v.tolist()))


def within(v, limit):
    return tuple(np.array(v) * min(1.0, limit / max(np.linalg.norm(v), 1e-300)))


def test_action_is_rotated_and_limited():
    quarter = (0.0, -1.0, 1.0, 0.0)  # local x is global y
    np.testing.assert_allclose(final_velocity(MODEL, (3.0, 0.0), quarter, (0.0, 0.0)), (0, 1.2))
    limited = final_velocity(MODEL, (30.0, 40.0), GLOBAL, (-1.0, -1.0))
    np.testing.assert_allclose(limited, (-1 + 0.6 * 2, -1 + 0.8 * 2))  # 5 m/s², direction kept
    fastest = final_velocity(MODEL, (5.0, 0.0), GLOBAL, (1.9, 0.0))
    np.testing.assert_allclose(fastest, (2.0, 0.0))


@given(triples, triples, st.floats(0, 1))
def test_motion_matches_numerical_integration(action, velocity, share):
    """p̈ = a with the applied acceleration, by scipy."""
    model = DoubleIntegrator(TAU, V_MAX, A_MAX, (0.0,) * 3)
    frame = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    velocity = within(velocity, V_MAX)
    after = np.array(final_velocity(model, action, frame, velocity))
    acceleration = (after - velocity) / TAU
    assert np.linalg.norm(acceleration) <= A_MAX * (1 + 1e-12)
    unlimited = np.array(velocity) + TAU * np.array(within(action, A_MAX))
    np.testing.assert_allclose(after, within(unlimited, V_MAX), atol=1e-12)
    time = share * TAU
    exact = solve_ivp(
        lambda t, y: [*y[3:6], *acceleration, np.linalg.norm(y[3:6])],
        (0, TAU),
        [0, 0, 0, *velocity, 0],
        t_eval=sorted({time, TAU}),
        rtol=1e-10,
        atol=1e-12,
    )
    along = motion.displacement_at(model, action, frame, velocity, time)
    np.testing.assert_allclose(along, exact.y[:3, 0], atol=1e-9)
    way, length = motion.propose(model, action, frame, velocity)
    np.testing.assert_allclose(way, exact.y[:3, -1], atol=1e-9)
    assert length == pytest.approx(exact.y[6, -1], abs=1e-6)
    assert (np.linalg.norm(exact.y[3:6], axis=0) <= V_MAX * (1 + 1e-9)).all()


@given(pairs, pairs)
def test_path_length_matches_quadrature(before, after):
    def speed(s):
        return math.hypot(*(b + s * (a - b) for b, a in zip(before, after, strict=True)))

    change = np.subtract(after, before)
    turn = -np.dot(before, change) / max(np.dot(change, change), 1e-300)
    wanted, _ = quad(speed, 0, 1, points=[min(max(turn, 0.0), 1.0)], limit=200, epsabs=1e-12)
    assert mean_speed(before, after) == pytest.approx(wanted, abs=1e-9)


def test_path_length_matches_hand_computation():
    assert mean_speed((1.0, 0.0), (-1.0, 0.0)) == pytest.approx(0.5)  # there and back
    assert mean_speed((0.0, 0.0), (0.0, 3.0)) == pytest.approx(1.5)
    assert mean_speed((0.0, 0.0), (0.0, 0.0)) == 0.0
    assert mean_speed((3.0, 4.0), (3.0, 4.0)) == 5.0
    for small in (0.9e-3, 1.1e-3):  # both ways of computing it agree where they meet
        b = (2.0 + 2 * small, small)
        wanted, _ = quad(lambda s, b=b: math.hypot(2 + s * (b[0] - 2), s * b[1]), 0, 1)
        assert mean_speed((2.0, 0.0), b) == pytest.approx(wanted, rel=1e-13)


@given(pairs, pairs, st.floats(0, 1), st.floats(0, 1))
def test_chord_error_is_within_bound(action, velocity, start, share):
    velocity = within(velocity, V_MAX)
    end = start + share * (1 - start)
    times = TAU * np.linspace(start, end, 41)
    path = np.array([motion.displacement_at(MODEL, action, GLOBAL, velocity, t) for t in times])
    shares = np.linspace(0, 1, 41)[:, None]
    gap = np.linalg.norm(path - (path[0] + shares * (path[-1] - path[0])), axis=1).max()
    allowed = motion.chord_error_bound(MODEL, action, velocity) * (TAU * (end - start)) ** 2
    assert gap <= allowed * (1 + 1e-9) + 1e-12


@given(pairs, pairs, st.floats(0, 2 * math.pi), st.floats(0, 1))
def test_contact_removes_normal_velocity_only(action, velocity, angle, kept):
    """A flat wall with normal n removed all but a fraction of the normal component."""
    velocity = within(velocity, V_MAX)
    normal = np.array([math.cos(angle), math.sin(angle)])
    way, _ = motion.propose(MODEL, action, GLOBAL, velocity)
    into = -min(0.0, float(np.dot(way, normal)))
    assume((1 - kept) * into > 1e-6)
    executed = tuple(np.array(way) + (1 - kept) * into * normal)
    free = np.array(motion.update_memory(MODEL, action, GLOBAL, velocity, way, motion.FREE))
    np.testing.assert_array_equal(free, final_velocity(MODEL, action, GLOBAL, velocity))
    slid = np.array(motion.update_memory(MODEL, action, GLOBAL, velocity, executed, motion.SLID))
    np.testing.assert_allclose(slid, free - min(0.0, free @ normal) * normal, atol=1e-7)
    assert np.linalg.norm(slid) <= np.linalg.norm(free) * (1 + 1e-12)
    stopped = motion.update_memory(MODEL, action, GLOBAL, velocity, executed, motion.STOPPED)
    assert np.array_equal(np.abs(stopped), (0.0, 0.0))
