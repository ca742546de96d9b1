"""Headings in the cone of bearings: projection, minimum alignment, hull under law (4)."""

import math
from itertools import count

import numpy as np
import pytest
from conftest import five
from scipy.optimize import nnls

from rendezvous_env import Scenario, Sensing, rollout
from rendezvous_env.safety.links import min_norm_points
from research.cone_heading import cone_heading, cone_velocity
from train.verify.monitors import unit

ROUNDING = 1e-6
"""Rounding of float32 actions, m."""


@pytest.mark.parametrize("dim", [2, 3])
def test_cone_heading_is_projection_onto_cone_and_cap(dim):
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


def test_headings_match_hand_computation():
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


def headed(scenario, *, projected=True):
    """Largest growth of the hull in a step under adversarial raw vectors, m; and rendezvous."""
    random, layout, calls = np.random.default_rng(0), scenario.observation_layout, count()
    u = random.normal(size=(60, scenario.dim))
    frozen = random.normal(size=(6, scenario.n_robots, scenario.dim))
    limits = {"merge_radius": scenario.merge_radius, "duration": scenario.tau}

    def law(observations, time):
        rows, f = observations[..., layout.neighbours, :], layout.net_bearing(observations)
        raw = frozen if next(calls) % 2 else random.normal(size=frozen.shape)
        if not projected:
            return unit(raw) * np.sum(unit(raw) * f, axis=-1, keepdims=True)
        h = cone_heading(raw, rows, min_alignment=0.1)
        return cone_velocity(h, f, min_norm_points(rows), **limits)

    found = rollout(scenario, law, num_envs=6)
    growth = np.diff((found.positions @ u.T).max(axis=2), axis=0)
    return growth[found.running].max(), found.success


def test_hull_is_nested_and_team_meets():
    growth, met = headed(five("single_integrator-3d", spawn_size=3.0, time_limit=300.0))
    assert growth < 10 * ROUNDING and met.all()


def test_hull_is_nested_with_any_visibility():
    sensing = Sensing(range=2.5, field_of_view=2.0, dropout=0.3, occlusion="robots")
    scenario = Scenario(n_robots=7, spawn_size=4.0, time_limit=20.0, sensing=sensing)
    assert headed(scenario)[0] < 10 * ROUNDING
    brief = scenario.replace(time_limit=100 * scenario.tau)
    assert headed(brief, projected=False)[0] > 0.01
