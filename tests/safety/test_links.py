"""The projection on velocities that keep links, and what is refused."""

import numpy as np
import pytest
from tuples import triple

from rendezvous_env import Scenario
from rendezvous_env.safety.links import LinkKeeping, project_on_links


def allowed(points, bearings, radius, error):
    """Whether ‖v‖ ≤ 2 ρ cos(∠(v, g) + η) for all bearings, (N,)."""
    speed = np.linalg.norm(points, axis=-1)
    with np.errstate(invalid="ignore"):
        angles = np.arccos(np.clip(points @ bearings.T / speed[:, None], -1, 1)) + error
    most = 2 * radius * np.cos(np.minimum(angles, np.pi)).min(axis=-1)
    return (speed <= most + 1e-12 * radius) | (speed == 0)


def draw(random, dim):
    """Bearings in a narrow or wide cone, a radius and a desired velocity."""
    count, spread = random.integers(1, 7), random.choice([0.01, 0.3, 1.0, 2.0])
    bearings = np.eye(dim)[0] + spread * random.normal(size=(count, dim))
    bearings /= np.linalg.norm(bearings, axis=-1, keepdims=True)
    return bearings, random.uniform(0.3, 2), random.normal(size=dim) * random.uniform(0, 3)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("error", [0.0, 0.2])
def test_nothing_that_is_allowed_is_nearer_to_a_desired_one(dim, error):
    """(w − x)·(z − x) ≤ 0 for all z of a convex set: z drawn everywhere, and near x."""
    random, inner = np.random.default_rng(dim), 0
    for _ in range(300):
        bearings, radius, desired = draw(random, dim)
        rows = bearings * random.uniform(0.5, 2, (len(bearings), 1))
        found = project_on_links(triple(desired), rows, len(rows), radius, error)
        x = np.array(found)[:dim]
        assert allowed(x[None], bearings, radius, error).all()
        scale = random.choice([1.0, 1e-1, 1e-2, 1e-3], (600, 1))
        z = np.where(scale == 1.0, 0.0, x) + scale * radius * random.normal(size=(600, dim))
        z = z[allowed(z, bearings, radius, error)]
        assert ((z - x) @ (desired - x)).max(initial=0.0) < 1e-9
        inner += np.linalg.norm(x) > 0 and not np.array_equal(x, desired)
    assert inner > 50


def test_velocities_by_hand():
    """λ d q + (1 − λ) P(w), ρ = r/(4τ) = 1.5, with v_max = 3 and desired ones in units of it."""
    scenario = Scenario(n_robots=3, merge_radius=0.6, time_step=0.1, max_speed=3.0)
    links = LinkKeeping(scenario, 1, share=0.25, frame="local")
    rows = np.zeros((1, 3, *scenario.observation_layout.shape), np.float32)
    rows[0, 0] = [[1.0, 0.0], [0.0, 1.0]]
    rows[0, 1, 0] = [0.0, 1.0]
    rows[0, 2] = [[1.0, 0.0], [-1.0, 0.0]]
    links.hold([[[0.5, 0.5], [0.0, -1.0], [0.3, 0.4]]])
    actions = links.act(rows)[0]
    np.testing.assert_allclose(actions[0], np.array([1.0, 1.0]) * 0.25 + 0.75 * 1.5, rtol=1e-6)
    np.testing.assert_allclose(actions[1], [0.0, 0.25], atol=1e-6)  # away is not allowed at all
    assert not actions[2].any()  # between two robots nobody moves
    assert links.alignment[0, 0] == pytest.approx(1.0) and np.isnan(links.alignment[0, 2])
    assert links.lyapunov_rate[0, 1] == pytest.approx(-0.5)
