"""V, its rate and gradient, and the enclosing ball."""

import numpy as np
import pytest
from conftest import UNEQUAL, five
from hypothesis import given
from hypothesis import strategies as st

from baselines.references.enclosing_ball import smallest_enclosing_ball
from rendezvous_env import Simulator
from rendezvous_env.safety.lyapunov import lyapunov, lyapunov_rate, net_bearings

PLACES = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 0.0]])
WEIGHTS = np.array([[0, 2.0, 0.5], [2.0, 0, 0], [0.5, 0, 0]])


def test_v_and_net_bearings_by_hand():
    """V counts every edge twice; leading axes broadcast."""
    places, scales = PLACES, np.arange(1.0, 7.0).reshape(2, 3)
    f = [[2 * 0.6 + 0.5, 2 * 0.8], [-1.2, -1.6], [-0.5, 0]]
    assert lyapunov(places, WEIGHTS) == 2 * (2 * 5 + 0.5 * 3)
    np.testing.assert_allclose(net_bearings(places, WEIGHTS), f, atol=1e-15)
    places = PLACES * scales[..., None, None]
    np.testing.assert_allclose(lyapunov(places, WEIGHTS), 23.0 * scales)
    found = net_bearings(places, WEIGHTS)
    np.testing.assert_allclose(found, np.broadcast_to(f, (2, 3, 3, 2)), atol=1e-15)
    with pytest.raises(ValueError, match=r"positions \(3, 2\) and weights \(5, 5\)"):
        lyapunov(PLACES, UNEQUAL)


def test_the_rate_by_hand():
    f = np.array([[3.0, 4.0], [0.0, 0.0], [1.0, 0.0]])
    assert lyapunov_rate([[1.0, 1.0], [5.0, 5.0], [2.0, 2.0]], f) == -2 * (7 + 2)


def test_the_simulator_agrees_with_these_formulas(kind):
    sim = Simulator(five(kind), 20)
    observations = sim.reset(3)
    for _ in range(5):
        np.testing.assert_allclose(sim.lyapunov(), lyapunov(sim.positions, sim.weights), rtol=1e-13)
        neighbours = sim.scenario.observation_layout.neighbours
        f_local = observations[..., neighbours, :].sum(axis=-2, dtype=float)
        f = np.einsum("bnij,bnj->bni", sim.frames, f_local)
        np.testing.assert_allclose(f, net_bearings(sim.positions, sim.weights), atol=2e-6)
        observations = sim.step(np.ones((20, 5, sim.scenario.action_size))).observations


@given(st.integers(1, 12), st.integers(2, 3), st.integers(0, 10**6), st.booleans())
def test_the_ball_encloses_and_none_is_smaller(count, d, seed, on_a_grid):
    """A convex function that no small step lessens is at its least."""
    points = np.random.default_rng(seed).normal(size=(count, d)) * 4
    points = np.round(points) if on_a_grid else points
    centre, radius = smallest_enclosing_ball(points)
    assert np.linalg.norm(points - centre, axis=1).max() <= radius * (1 + 1e-9) + 1e-12
    for nudge in np.random.default_rng(0).normal(size=(200, d)) * 1e-3:
        assert np.linalg.norm(points - centre - nudge, axis=1).max() >= radius - 1e-9


@pytest.mark.parametrize("points", [np.zeros((0, 2)), np.zeros(3), [[np.nan, 0.0]]])
def test_no_ball(points):
    with pytest.raises(ValueError, match="points have shape"):
        smallest_enclosing_ball(points)
