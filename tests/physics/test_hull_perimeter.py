"""Hull perimeter L, compared with its defining integral, also for flat hulls."""

import itertools
import math

import numpy as np
import pytest
from conftest import started
from hypothesis import given
from hypothesis import strategies as st

from rendezvous_env import Scenario
from rendezvous_env.physics.hull_perimeter import size

HEIGHTS, WEIGHTS = np.polynomial.legendre.leggauss(240)


def integral(points):
    """∫ max_i u·p_i du over all directions, by quadrature."""
    if points.shape[1] == 2:
        angles = 2 * np.pi * (np.arange(20_000) + 0.5) / 20_000
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return 2 * np.pi * np.max(directions @ points.T, axis=-1).mean()
    yaw = 2 * np.pi * (np.arange(480) + 0.5) / 480
    level = np.sqrt(1 - HEIGHTS**2)[:, None]
    directions = np.stack(
        np.broadcast_arrays(level * np.cos(yaw), level * np.sin(yaw), HEIGHTS[:, None]), axis=-1
    )
    return 2 * np.pi * WEIGHTS @ np.max(directions @ points.T, axis=-1).mean(axis=-1)


@pytest.mark.kernels
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 20])
@pytest.mark.parametrize("extent", [1, 2, 3])
def test_size_is_integral_of_support_function(dim, count, extent):
    """Points that extend in 1, 2 or 3 directions: on a line, in a plane, solid."""
    random = np.random.default_rng([dim, count, extent])
    span = random.normal(size=(min(extent, dim), dim))
    points = random.normal(size=(count, len(span))) @ span
    assert size(points) == pytest.approx(integral(points), rel=2e-5, abs=1e-12)


def test_hull_sizes_match_hand_computation():
    square = np.array([[0, 0], [3.0, 0], [3, 3], [0, 3], [1, 1]])
    assert size(square) == pytest.approx(12)
    assert size(square[:2]) == pytest.approx(6)  # there and back
    flat = np.column_stack([square, np.full(5, 7.0)])
    assert size(flat) == pytest.approx(12 * math.pi / 2)
    assert size(flat[:2]) == pytest.approx(math.pi * 3)  # mean width l/2
    box = np.array(list(itertools.product((0, 1.0), (0, 2.0), (0, 3.0))))
    assert size(box) == pytest.approx(2 * math.pi * 3)  # mean width (a + b + c)/2
    side = 2.0
    tetrahedron = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]) / math.sqrt(2)
    width = 6 * side * math.acos(-1 / 3) / (4 * math.pi)
    assert size(tetrahedron) == pytest.approx(2 * math.pi * width)
    for d in (2, 3):
        assert size(np.zeros((1, d))) == size(np.full((4, d), 2.5)) == 0


@given(
    st.integers(2, 3), st.integers(1, 9), st.integers(0, 10**6), st.floats(-15, 0), st.booleans()
)
def test_nearly_flat_hulls_are_continuous(d, count, seed, thin, on_a_grid):
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, d)) * 3
    points = np.round(points) if on_a_grid else points
    points[:, random.integers(d) :] = 0.0
    nudges = 10.0**thin * random.uniform(-1, 1, size=(count, d))
    # L is a sum of maxima: it moves by no more than the integral of the nudges
    most = (2 * math.pi if d == 2 else 4 * math.pi) * np.linalg.norm(nudges, axis=-1).max()
    assert abs(size(points + nudges) - size(points)) <= most + 1e-8 * (1 + size(points))


@pytest.mark.kernels
@given(st.integers(2, 3), st.integers(2, 9), st.integers(0, 10**6))
def test_size_is_monotone_and_frame_independent(d, count, seed):
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, d))
    inside = random.dirichlet(np.ones(count), size=3) @ points
    whole = size(np.concatenate([points, inside]))
    assert whole == pytest.approx(size(points), rel=1e-9)
    assert size(inside) <= whole * (1 + 1e-9)
    turned, _ = np.linalg.qr(random.normal(size=(d, d)))
    assert size(7 * points @ turned + 100) == pytest.approx(7 * whole, rel=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_simulator_size_counts_active_robots(dim):
    scenario = Scenario(n_robots=5, dim=dim, graph="path", neighbour_slots=4)
    simulator = started(scenario, 6, seed=4)
    # the last two are neighbours closer than r, so a step makes one robot of them
    places = simulator.positions.copy()
    places[:, 4] = places[:, 3] + 0.1 * scenario.merge_radius
    simulator.reset(4, {"positions": places})
    simulator.step(np.zeros((6, 5, dim)))
    assert (simulator.active.sum(axis=-1) == 4).all()
    expected = [integral(p[a]) for p, a in zip(simulator.positions, simulator.active, strict=True)]
    np.testing.assert_allclose(simulator.size(), expected, rtol=2e-5)
