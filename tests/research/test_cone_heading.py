"""Headings among the bearings: the projection, the margin, and the hull under law (4)."""

import math

import numpy as np
import pytest
from conftest import five
from scipy.optimize import nnls

from rendezvous_env import Scenario, Sensing, Simulator
from rendezvous_env.engine.memory import RENDEZVOUS, RUNNING
from rendezvous_env.safety.links import least_norm_points
from research.cone_heading import cone_heading, cone_velocity
from train.verify.monitors import unit

TEAMS = 6
ROUNDING = 1e-6
"""Of float32 actions, m."""


def reach(simulator, u):
    """max_i u·p_i over the robots that are left, (B, directions)."""
    along = simulator.positions @ u.T
    return np.where(simulator.active[..., None], along, -np.inf).max(axis=1)


@pytest.mark.parametrize("dim", [2, 3])
def test_it_is_the_projection_onto_the_cone_and_the_cap(dim):
    random, kept, turned = np.random.default_rng(dim), 0, 0
    for _ in range(200):
        count, spread = random.integers(1, 7), random.choice([0.2, 1.0, 3.0])
        rows = np.eye(dim)[0] + spread * random.normal(size=(count, dim))
        raw, margin = random.normal(size=dim), random.uniform(0.01, 0.9)
        h = cone_heading(raw, rows, min_alignment=margin)
        f = rows.sum(axis=0)
        assert np.linalg.norm(h) == pytest.approx(1.0)
        assert h @ f >= (margin - 1e-12) * np.linalg.norm(f)
        assert nnls(rows.T, h)[1] < 1e-9  # in the cone
        weights, _ = nnls(rows.T, raw)
        nearest = rows.T @ weights
        if np.linalg.norm(nearest) < 1e-6:
            np.testing.assert_allclose(h, f / np.linalg.norm(f))
            continue
        nearest = unit(nearest)
        if nearest @ f >= margin * np.linalg.norm(f):
            np.testing.assert_allclose(h, nearest, atol=1e-8)
            kept += 1
        else:
            assert h @ f == pytest.approx(margin * np.linalg.norm(f))
            turned += 1
    assert kept > 30 and turned > 3


def test_headings_by_hand():
    rows = np.array([[2.0, 0.0], [0.0, 2.0], [0.0, 0.0]])
    half = math.sqrt(0.5)
    for raw, expected in (
        ([3.0, 4.0], [0.6, 0.8]),
        ([1.0, -0.2], [1.0, 0.0]),
        ([-1.0, 0.5], [0.0, 1.0]),
        ([-1.0, -1.0], [half, half]),
        ([0.0, 0.0], [half, half]),
    ):
        h = cone_heading(raw, rows, min_alignment=0.1)
        np.testing.assert_allclose(h, expected, atol=1e-12)
    np.testing.assert_array_equal(cone_heading([1.0, 0.0], 0 * rows, min_alignment=0.1), [0, 0])
    f, q = np.array([2.0, 2.0]), np.array([0.5, 0.5])
    given = {"merge_radius": 0.2, "duration": 0.1}
    velocity = cone_velocity([1.0, 0.0], f, q, **given)
    np.testing.assert_allclose(velocity, [2.0 * half, 0.0])  # r ‖q‖/τ, less than hᵀf = 2


def headed(scenario, *, projected=True, steps=None):
    """How far the hull grows at most in a step under adversarial raw vectors, m; who has met."""
    random, simulator = np.random.default_rng(0), Simulator(scenario, TEAMS)
    layout = scenario.observation_layout
    u = random.normal(size=(60, scenario.dim))
    frozen = random.normal(size=(TEAMS, scenario.n_robots, scenario.dim))
    observations, step, growth = simulator.reset(0), 0, -np.inf
    limits = {"merge_radius": scenario.merge_radius, "duration": scenario.tau}
    while (on := simulator.status == RUNNING).any() and step != steps:
        rows, f = observations[..., layout.neighbours, :], layout.net_bearing(observations)
        raw = frozen if step % 2 else random.normal(size=frozen.shape)
        h = cone_heading(raw, rows, min_alignment=0.1)
        velocity = cone_velocity(h, f, least_norm_points(rows), **limits)
        if not projected:
            velocity = unit(raw) * np.sum(unit(raw) * f, axis=-1, keepdims=True)
        before = reach(simulator, u)
        observations = simulator.step(velocity.astype(np.float32)).observations
        growth, step = max(growth, (reach(simulator, u) - before)[on].max()), step + 1
    return growth, simulator.status == RENDEZVOUS


def test_the_hull_is_nested_and_all_meet():
    growth, met = headed(five("single_integrator-3d", spawn_size=3.0, time_limit=300.0))
    assert growth < 10 * ROUNDING and met.all()


def test_the_hull_is_nested_whoever_is_seen():
    sensing = Sensing(range=2.5, field_of_view=2.0, dropout=0.3, occlusion="robots")
    scenario = Scenario(n_robots=7, spawn_size=4.0, time_limit=20.0, sensing=sensing)
    assert headed(scenario)[0] < 10 * ROUNDING
    assert headed(scenario, projected=False, steps=100)[0] > 0.01
