"""Capsules: distance, normal, way in and silhouette, by hand and against sampling."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import minimize_scalar
from tuples import along

from rendezvous_env.obstacles.capsule import CAPSULES
from rendezvous_env.obstacles.shape import azimuth_axes, centre_direction

ZERO = (0.0, 0.0, 0.0)
HALF = (2.0, 0.0, 0.0)
"""Of a capsule from (−2, 0) to (2, 0)."""
numbers = st.floats(-4, 4).map(lambda x: round(x, 3))
points = arrays(np.float64, 3, elements=numbers)
radii = st.floats(0.05, 1.5)


def row(half, radius) -> np.ndarray:
    """Of a capsule about the origin, as kernels take it."""
    return np.array([np.linalg.norm(half) + radius, *ZERO, *half, radius])


def surface(point, half, radius):
    return CAPSULES.surface(row(half, radius), 0, tuple(point))


@pytest.mark.parametrize(
    ("point", "distance", "normal"),
    [
        ((0.0, 1.5, 0.0), 1.0, (0, 1, 0)),  # beside it
        ((2.0, -0.75, 0.0), 0.25, (0, -1, 0)),  # beside its very end
        ((5.0, 4.0, 0.0), 4.5, (0.6, 0.8, 0)),  # beyond an end
        ((-2.4, 0.0, 0.0), -0.1, (-1, 0, 0)),  # inside a round end
        ((1.0, 0.0, 0.3), -0.2, (0, 0, 1)),  # inside, above the segment
        ((1.0, 0.0, 0.0), -0.5, (0, 1, 0)),  # on the segment: some direction across it
    ],
)
def test_distance_and_normal_by_hand(point, distance, normal):
    found, out = surface(point, HALF, 0.5)
    assert found == pytest.approx(distance)
    np.testing.assert_allclose(out, normal, atol=1e-12)


def test_a_segment_along_z_has_a_normal_too():
    found, normal = surface((0.0, 0.0, 0.4), (0.0, 0.0, 1.0), 0.5)
    assert found == -0.5 and np.dot(normal, (0, 0, 1)) == 0 and np.linalg.norm(normal) == 1


@given(points, points, radii)
def test_distance_against_sampling(point, half, radius):
    found, normal = surface(point, half, radius)
    places = np.linspace(-1, 1, 4001)[:, None] * half
    wanted = np.linalg.norm(point - places, axis=1).min() - radius
    assert wanted - 1e-3 * (1 + np.linalg.norm(half)) <= found <= wanted + 1e-12
    assert np.linalg.norm(normal) == pytest.approx(1)
    if found > 1e-6:  # a step along the normal leads away, one against it to the surface
        on, _ = surface(point - found * np.array(normal), half, radius)
        assert abs(on) < 1e-12


@given(points, points, points, radii)
def test_way_in_against_sampling(point, way, half, radius):
    distance, _ = surface(point, half, radius)
    assume(distance > 0 and np.linalg.norm(way) > 0.01)
    shares = np.linspace(0, 1, 2001)
    along = [surface(point + s * way, half, radius)[0] for s in shares[::20]]
    found = CAPSULES.entry(row(half, radius), 0, tuple(point), tuple(way), 1e-6)
    if found > 1:
        assert found == math.inf and min(along) > -2e-6
        return
    there, _ = surface(point + found * way, half, radius)
    assert abs(there) < 1e-9
    before = [surface(point + s * way, half, radius)[0] for s in np.linspace(0, found, 50)[:-1]]
    assert min(before) > -1e-9


def test_way_in_by_hand():
    enter = lambda point, way, depth=1e-6: CAPSULES.entry(row(HALF, 0.5), 0, point, way, depth)  # noqa: E731
    assert enter((0.0, 2.5, 0.0), (0.0, -4.0, 0.0)) == pytest.approx(0.5)
    assert enter((5.5, 0.0, 0.0), (-6.0, 0.0, 0.0)) == pytest.approx(0.5)
    assert enter((0.0, 2.5, 0.0), (4.0, 0.0, 0.0)) == math.inf
    assert enter((-9.0, 0.5, 0.0), (18.0, 0.0, 0.0)) == math.inf  # grazing is no contact
    assert enter((-9.0, 0.5, 0.0), (18.0, 0.0, 0.0), -0.1) < 0.5  # but it is for a fatter one
    assert enter((0.0, 0.5, 0.0), (0.0, 1.0, 0.0)) == math.inf  # leaving


@given(points, points, radii)
def test_silhouette_against_a_fine_polygon(point, half, radius):
    point[2] = half[2] = 0.0
    distance, _ = surface(point, half, radius)
    assume(distance > 0.05)
    left, right = CAPSULES.edges(row(half, radius), 0, tuple(point))
    circle = radius * along(*np.linspace(0, 360, 20_000)) - point[:2]
    rays = np.concatenate([circle + half[:2], circle - half[:2]])
    middle = math.atan2(-point[1], -point[0])
    turned = np.angle(np.exp(1j * (np.arctan2(rays[:, 1], rays[:, 0]) - middle)))
    for edge, extreme in ((left, turned.max()), (right, turned.min())):
        angle = np.angle(np.exp(1j * (math.atan2(edge[1], edge[0]) - middle)))
        assert angle == pytest.approx(extreme, abs=1e-3)
        assert abs(angle) >= abs(extreme) - 1e-12  # the polygon's corners lie on the surface
        assert math.hypot(edge[0], edge[1]) == pytest.approx(1) and edge[2] == 0


@given(points, points, points, radii)
def test_every_ray_in_space_grazes(point, half, net_bearing, radius):
    point, half = tuple(point), tuple(half)
    distance, _ = surface(point, half, radius)
    assume(distance > 0.02)
    towards = centre_direction(point, ZERO)
    e, w = azimuth_axes(towards, tuple(net_bearing), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    rays = np.empty((8, 3))
    CAPSULES.cone(row(half, radius), 0, point, (towards, e, w), rays)
    for k, ray in enumerate(rays):
        assert np.linalg.norm(ray) == pytest.approx(1)
        to_axis = lambda t, ray=ray: surface(np.add(point, t * ray), half, 0.0)[0]  # noqa: E731
        nearest = minimize_scalar(to_axis, bounds=(0.0, 40.0), method="bounded")  # convex
        assert nearest.fun == pytest.approx(radius, abs=1e-6)
        aside = math.cos(k * math.pi / 4) * np.array(e) + math.sin(k * math.pi / 4) * np.array(w)
        across = ray - np.dot(ray, towards) * np.array(towards)
        assert np.linalg.norm(across - np.dot(across, aside) * aside) < 1e-9  # at its azimuth
        assert np.dot(across, aside) >= 0
