"""Growth under law (4) on a switching graph, and its remedies (guarantees, section 10)."""

import numpy as np
import pytest

import rendezvous_env as rv
from rendezvous_env.safety.heading import flexible_velocity
from rendezvous_env.safety.lyapunov import net_bearings

SCENARIO = rv.scenarios.get("rotating-paths").replace(local_frames="global")
MARGINS = np.array([0.1, 0.3, 0.26, 0.29])
SCALES = np.array([1.0, 1.0, 10.0, 10.0])
"""Relative effect of a held step; it decreases with the perimeter, so the team must be large near
the threshold."""


class Growing:
    """Certified headings with hᵀf = ε‖f‖, on the side with faster growth of L."""

    def watch(self, simulator):
        self.simulator, self.previous = simulator, np.zeros_like(simulator.positions)

    def __call__(self, observations, time):
        p, f = self.simulator.positions, SCENARIO.observation_layout.net_bearing(observations)
        f = f.astype(float)
        desired = growing_side(f, outward(p), MARGINS[:, None, None])
        for team, margin in enumerate(MARGINS):
            self.previous[team] = rv.certified_heading(
                desired[team],
                f[team],
                self.previous[team],
                min_alignment=margin,
                dead_zone=SCENARIO.dead_zone,
                max_turn=np.inf,
            )
        return flexible_velocity(f, self.previous)


def outward(p):
    """∂L/∂p_i of triangles, (B, 3, 2): minus the bearings of the two others."""
    complete = 1.0 - np.eye(3)
    return -net_bearings(p + 1e-9 * np.arange(3)[:, None], complete)


def growing_side(f, gradient, margin):
    length = np.linalg.norm(f, axis=-1, keepdims=True)
    along = f / np.where(length > 0, length, 1.0)
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    left, right = (margin * along + s * np.sqrt(1 - margin**2) * across for s in (1, -1))
    better = np.sum((left - right) * gradient, axis=-1, keepdims=True) >= 0
    return np.where(better, left, right)


@pytest.fixture(scope="module")
def sizes():
    """L of each team over time, (T + 1, B), m."""
    starts = SCALES[:, None, None] * np.array(SCENARIO.start_positions)
    policy = Growing()
    found = rv.rollout(SCENARIO, policy, 0, num_envs=4, options={"positions": starts})
    sides = found.positions - np.roll(found.positions, 1, axis=2)
    return np.linalg.norm(sides, axis=-1).sum(axis=-1)


@pytest.mark.slow
def test_small_margin_grows_at_triangle_rate(sizes):
    """L grows 9.7-fold in 400 s, and in every cycle of three dwell times."""
    margin = MARGINS[0]
    rate = np.sqrt(3) * margin * np.sqrt(1 - margin**2) - 6 * margin**2
    assert (sizes[-1, 0] - sizes[0, 0]) / 400.0 == pytest.approx(rate, rel=0.01)
    assert sizes[-1, 0] / sizes[0, 0] == pytest.approx(9.7, abs=0.05)
    assert (np.diff(sizes[::60, 0]) > 0).all()


@pytest.mark.slow
def test_margin_above_threshold_does_not_grow(sizes):
    """The threshold is 1/√13 = 0.277."""
    assert sizes[:, 1].max() == sizes[0, 1] and sizes[-1, 1] < 0.3 * sizes[0, 1]
    assert sizes[-1, 2] > 1.05 * sizes[0, 2], "just below it"
    assert sizes[-1, 3] < 0.95 * sizes[0, 3], "just above it"
