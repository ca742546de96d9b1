"""Obstacle geometry compared with shapely, trigonometry and brute force."""

import math

import numpy as np
import pytest
import shapely
from geometry import along, separate, triple, world
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import minimize_scalar

from rendezvous_env.obstacles.capsule import CAPSULES
from rendezvous_env.obstacles.disc import Disc, Sphere
from rendezvous_env.obstacles.obstacle_set import (
    clear_of_obstacles,
    distance_to,
    silhouette_2d,
    silhouette_3d,
    surface,
)
from rendezvous_env.obstacles.polygon import Polygon
from rendezvous_env.obstacles.shape import MIDDLE, OWN, azimuth_axes, centre_direction
from rendezvous_env.physics.crossings import first_crossing
from rendezvous_env.physics.vectors import ORIGIN

pytestmark = pytest.mark.kernels

N_VIEWS = 10_000
SQUARE = Polygon(((0, 0), (2, 0), (2, 2), (0, 2)))


def views(obstacles, positions):
    """Distances (V,), normals (V, d) and silhouettes (V, 2, d) for positions and obstacles.

    Position k belongs to obstacle k of a world, cyclically.
    """
    count, d = positions.shape
    distances, normals = np.empty(count), np.empty((count, 3))
    silhouettes = np.empty((count, 2, d))
    for k in range(count):
        m, point = k % len(obstacles.kinds), triple(positions[k])
        distances[k], normals[k] = surface(obstacles, m, point)
        if d == 2:
            silhouette_2d(obstacles, m, point, silhouettes[k])
    return distances, normals[:, :d], silhouettes


def random_polygon(rng):
    """Vertices on an ellipse, hence convex; 3 to 8 of them, at least 0.2 rad apart."""
    gaps = rng.uniform(0.2, 1.0, rng.integers(3, 9))
    angles = np.cumsum(gaps) / gaps.sum() * 2 * math.pi + rng.uniform(0, 7)
    axes, centre = rng.uniform(0.3, 3.0, 2), rng.uniform(-10, 10, 2)
    return Polygon(tuple(map(tuple, centre + axes * np.c_[np.cos(angles), np.sin(angles)])))


@pytest.fixture(scope="module")
def polygon_views():
    """Random polygons, each with a viewpoint anywhere near it."""
    rng = np.random.default_rng(1)
    polygons = [random_polygon(rng) for _ in range(N_VIEWS // 10)] * 10
    obstacles = separate(polygons[: N_VIEWS // 10])
    positions = np.array([p.centroid for p in polygons]) + rng.normal(0, 3, (N_VIEWS, 2))
    shapes = np.array([shapely.Polygon(p.vertices) for p in polygons])
    return obstacles, positions, shapes


def direction(angles):
    """Unit vectors (..., 2) at angles (...)."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


class TestDistanceAndNormal:
    def test_polygon_distance_equals_shapely(self, polygon_views):
        obstacles, positions, shapes = polygon_views
        distances, normals, _ = views(obstacles, positions)
        points = shapely.points(positions)
        to_boundary = shapely.distance(shapely.boundary(shapes), points)
        inside = shapely.contains(shapes, points)
        assert 500 < inside.sum() < N_VIEWS - 500
        np.testing.assert_allclose(distances, np.where(inside, -1, 1) * to_boundary, atol=1e-9)
        feet = shapely.points(positions - distances[:, None] * normals)
        assert shapely.distance(shapely.boundary(shapes), feet).max() < 1e-9
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)

    @pytest.mark.parametrize(("dim", "kind"), [(2, Disc), (3, Sphere)])
    def test_ball_distance_is_centre_distance_minus_radius(self, dim, kind):
        rng = np.random.default_rng(2)
        centres, radii = rng.normal(0, 5, (1000, dim)), rng.uniform(0.1, 5, 1000)
        positions = rng.normal(0, 5, (1000, dim))
        obstacles = separate([kind(tuple(c), r) for c, r in zip(centres, radii, strict=True)])
        distances, normals, _ = views(obstacles, positions)
        offsets = positions - centres
        lengths = np.linalg.norm(offsets, axis=1)
        np.testing.assert_allclose(distances, lengths - radii, atol=1e-12)
        np.testing.assert_allclose(normals, offsets / lengths[:, None], atol=1e-12)

    def test_distances_match_hand_computation(self):
        square = world([SQUARE])
        table = [  # position, distance, normal
            ((1.0, 1.5), -0.5, (0, 1)),
            ((3.0, 1.0), 1.0, (1, 0)),
            ((5.0, 6.0), 5.0, (0.6, 0.8)),
            ((2.0, 0.7), 0.0, (1, 0)),
            ((-1e-17, 0.7), 0.0, (-1, 0)),
        ]
        for position, distance, expected in table:
            found, normal = surface(square, 0, triple(position))
            assert found == pytest.approx(distance, abs=1e-15)
            np.testing.assert_allclose(normal, triple(expected), atol=1e-15)

    def test_normal_at_vertex_is_edge_normal(self):
        square = world([SQUARE])
        for x in (2.0, 2.0 + 1e-16, 2.0 - 4e-16, 2.0 + 4e-16):
            _, normal = surface(square, 0, (x, 2.0 + 4e-16, 0.0))
            assert normal[:2] in {(1.0, 0.0), (-0.0, 1.0), (0.0, 1.0), (1.0, -0.0)}
            assert normal[2] == 0

    def test_clear_of_obstacles_applies_margin_to_all(self):
        absent = world([], 2)
        assert distance_to(absent, 0, ORIGIN) == np.inf
        assert clear_of_obstacles(ORIGIN, absent, 1e9)
        discs = world([Disc((3, 0), 1), Disc((0, 5), 1)], 3)
        assert clear_of_obstacles(ORIGIN, discs, 2.0)
        assert not clear_of_obstacles(ORIGIN, discs, 2.0 + 1e-9)
        assert not clear_of_obstacles((0.0, 4.5, 0.0), discs, -0.25)
        assert clear_of_obstacles((0.0, 4.5, 0.0), discs, -0.75)


class TestSilhouette2d:
    def test_disc_edges_are_at_half_angle(self):
        rng = np.random.default_rng(3)
        centres, radii = rng.uniform(-10, 10, (N_VIEWS, 2)), rng.uniform(0.05, 5, N_VIEWS)
        discs = separate([Disc(tuple(c), r) for c, r in zip(centres, radii, strict=True)])
        turn, distance = rng.uniform(0, 7, N_VIEWS), radii * rng.uniform(1.001, 30, N_VIEWS)
        _, _, seen = views(discs, centres - distance[:, None] * direction(turn))
        half = np.arcsin(radii / distance)
        np.testing.assert_allclose(seen[:, 0], direction(turn + half), atol=1e-9)
        np.testing.assert_allclose(seen[:, 1], direction(turn - half), atol=1e-9)

    def test_polygon_edges_are_extreme_vertices(self, polygon_views):
        obstacles, positions, shapes = polygon_views
        outside = ~shapely.contains(shapes, shapely.points(positions))
        _, _, seen = views(obstacles, positions)
        for k in np.flatnonzero(outside):
            m = k % len(obstacles.kinds)
            row, count = obstacles.shapes[m], obstacles.corners[m]
            corners = row[OWN : OWN + 2 * count].reshape(-1, 2) - positions[k]
            angles = np.arctan2(corners[:, 1], corners[:, 0])
            middle = math.atan2(*(row[MIDDLE : MIDDLE + 2] - positions[k])[::-1])
            turns = np.angle(np.exp(1j * (angles - middle)))
            expected = direction(middle + np.array([turns.max(), turns.min()]))
            np.testing.assert_allclose(seen[k], expected, atol=1e-9)
        assert outside.sum() > 5000

    def test_edges_on_surface_are_tangent(self):
        both = world([SQUARE, Disc((0.3, -0.1), 0.7)])
        seen = np.empty((2, 2))
        for x in (-1e-16, 0.0, 1e-16):
            silhouette_2d(both, 0, (x, 0.6, 0.0), seen)  # on the left edge, looking right
            np.testing.assert_allclose(seen, [(0, 1), (0, -1)], atol=1e-12)
            silhouette_2d(both, 0, (x, x, 0.0), seen)  # on a corner
            np.testing.assert_allclose(seen, [(0, 1), (1, 0)], atol=1e-12)
            silhouette_2d(both, 1, (-0.4 + x, -0.1, 0.0), seen)
            np.testing.assert_allclose(seen, [(0, 1), (0, -1)], atol=1e-7)

    @pytest.mark.parametrize("radius", [1e-5, 0.7, 3.0, 1e9])
    def test_edges_at_disc_centre_are_across_x_axis(self, radius):
        seen = np.empty((2, 2))
        silhouette_2d(world([Disc((0.5, 0.5), radius)]), 0, (0.5, 0.5, 0.0), seen)
        np.testing.assert_allclose(seen, [(0, 1), (0, -1)], atol=1e-15)


class TestSilhouette3d:
    def rays(self, sphere, position, net_bearing, axis_x=(1, 0, 0), axis_y=(0, 1, 0)):
        out = np.full((8, 3), np.nan)
        vectors = map(triple, (position, net_bearing, axis_x, axis_y))
        silhouette_3d(world([sphere]), 0, *vectors, out)
        return out

    def test_sphere_rays_are_tangent_and_45_degrees_apart(self):
        rng = np.random.default_rng(4)
        for _ in range(300):
            centre, position, f = rng.normal(0, 4, (3, 3))
            o = centre - position
            distance = np.linalg.norm(o)
            radius = distance * rng.uniform(0.01, 0.999)
            rays = self.rays(Sphere(tuple(centre), radius), position, f)
            along = rays @ o
            np.testing.assert_allclose(along, math.sqrt(distance**2 - radius**2), atol=1e-9)
            feet = along[:, None] * rays
            np.testing.assert_allclose(np.linalg.norm(feet - o, axis=1), radius, atol=1e-9)
            u = o / distance
            spokes = rays - np.outer(rays @ u, u)
            spokes /= np.linalg.norm(spokes, axis=1, keepdims=True)
            e = f - (f @ u) * u
            np.testing.assert_allclose(spokes[0], e / np.linalg.norm(e), atol=1e-9)
            following = np.roll(spokes, -1, axis=0)
            np.testing.assert_allclose(np.sum(spokes * following, axis=1), 0.5**0.5, atol=1e-9)
            assert np.all(np.cross(spokes, following) @ u > 0)  # right-handed about u

    def test_azimuth_falls_back_to_local_axes(self):
        sphere, c, s = Sphere((2, 0, 0), 1.0), math.sqrt(0.75), 0.5
        table = [  # net bearing, local x, local y, azimuth-0 ray
            ((1, 1, 0), (0, 0, 1), (0, 1, 0), (c, s, 0)),
            ((1, 0, 0), (0, 0, 1), (0, 1, 0), (c, 0, s)),
            ((0, 0, 0), (0, 0, -1), (0, 1, 0), (c, 0, -s)),
            ((-3, 0, 0), (-1, 0, 0), (0, -1, 0), (c, -s, 0)),
        ]
        for net_bearing, axis_x, axis_y, expected in table:
            rays = self.rays(sphere, (0, 0, 0), net_bearing, axis_x, axis_y)
            np.testing.assert_allclose(rays[0], expected, atol=1e-15)

    def test_rays_are_unit_vectors(self):
        for u in np.random.default_rng(5).normal(size=(50, 3)):
            rays = self.rays(Sphere(tuple(2 * u), np.linalg.norm(u)), (0, 0, 0), 1e9 * u)
            np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-12)
        rays = self.rays(Sphere((2, 0, 0), 2.0), (1e-17, 0, 0), (0, 1, 0))
        np.testing.assert_allclose(rays[:, 0], 0, atol=1e-7)  # in the tangent plane
        np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-12)


class TestFirstCrossing:
    @pytest.mark.parametrize(
        ("offset", "velocity", "radius", "expected"),
        [
            ((3, 0), (-4, 0), 1, 0.5),
            ((3, 1), (-4, 0), 1, 0.75),  # grazing
            ((3, 1.001), (-4, 0), 1, np.inf),
            ((3, 0), (-2, 0), 1, 1.0),
            ((3, 0), (-1.99, 0), 1, np.inf),
            ((3, 0), (4, 0), 1, np.inf),
            ((3, 0), (0, 0), 1, np.inf),
            ((0.5, 0), (4, 0), 1, 0.0),
            ((1, 0), (0, 0), 1, 0.0),
            ((3, 4), (-3, -4), 0, 1.0),
            ((3, 4), (-3, -4), -1, np.inf),
        ],
    )
    def test_first_crossing_matches_hand_computation(self, offset, velocity, radius, expected):
        found = first_crossing(triple(offset), triple(velocity), float(radius))
        assert found == pytest.approx(expected, abs=1e-15)

    def test_first_crossing_is_accurate_far_away(self):
        s = first_crossing((1e6, 0.2, 0.0), (-2e6, 0.0, 0.0), 0.2 + 1e-9)
        assert s == pytest.approx(0.5, abs=1e-10)
        assert first_crossing((1e6, 0.2, 0.0), (-2e6, 0.0, 0.0), 0.2 - 1e-9) == np.inf


ZERO = (0.0, 0.0, 0.0)
HALF = (2.0, 0.0, 0.0)
"""End points of a capsule from (−2, 0) to (2, 0)."""
numbers = st.floats(-4, 4).map(lambda x: round(x, 3))
points = arrays(np.float64, 3, elements=numbers)
radii = st.floats(0.05, 1.5)


def row(half, radius) -> np.ndarray:
    """Capsule about the origin, as kernel argument."""
    return np.array([np.linalg.norm(half) + radius, *ZERO, *half, radius])


def of_capsule(point, half, radius):
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
def test_distance_and_normal_match_hand_computation(point, distance, normal):
    found, out = of_capsule(point, HALF, 0.5)
    assert found == pytest.approx(distance)
    np.testing.assert_allclose(out, normal, atol=1e-12)


def test_vertical_capsule_has_normal():
    found, normal = of_capsule((0.0, 0.0, 0.4), (0.0, 0.0, 1.0), 0.5)
    assert found == -0.5 and np.dot(normal, (0, 0, 1)) == 0 and np.linalg.norm(normal) == 1


@given(points, points, radii)
def test_distance_matches_sampling(point, half, radius):
    found, normal = of_capsule(point, half, radius)
    places = np.linspace(-1, 1, 4001)[:, None] * half
    wanted = np.linalg.norm(point - places, axis=1).min() - radius
    assert wanted - 1e-3 * (1 + np.linalg.norm(half)) <= found <= wanted + 1e-12
    assert np.linalg.norm(normal) == pytest.approx(1)
    if found > 1e-6:  # a step along the normal leads away, one against it to the surface
        on, _ = of_capsule(point - found * np.array(normal), half, radius)
        assert abs(on) < 1e-12


@given(points, points, points, radii)
def test_entry_matches_sampling(point, way, half, radius):
    distance, _ = of_capsule(point, half, radius)
    assume(distance > 0 and np.linalg.norm(way) > 0.01)
    shares = np.linspace(0, 1, 2001)
    along = [of_capsule(point + s * way, half, radius)[0] for s in shares[::20]]
    found = CAPSULES.entry(row(half, radius), 0, tuple(point), tuple(way), 1e-6)
    if found > 1:
        assert found == math.inf and min(along) > -2e-6
        return
    there, _ = of_capsule(point + found * way, half, radius)
    assert abs(there) < 1e-9
    before = [of_capsule(point + s * way, half, radius)[0] for s in np.linspace(0, found, 50)[:-1]]
    assert min(before) > -1e-9


def test_entry_matches_hand_computation():
    enter = lambda point, way, depth=1e-6: CAPSULES.entry(row(HALF, 0.5), 0, point, way, depth)  # noqa: E731
    assert enter((0.0, 2.5, 0.0), (0.0, -4.0, 0.0)) == pytest.approx(0.5)
    assert enter((5.5, 0.0, 0.0), (-6.0, 0.0, 0.0)) == pytest.approx(0.5)
    assert enter((0.0, 2.5, 0.0), (4.0, 0.0, 0.0)) == math.inf
    assert enter((-9.0, 0.5, 0.0), (18.0, 0.0, 0.0)) == math.inf  # grazing is no contact
    assert enter((-9.0, 0.5, 0.0), (18.0, 0.0, 0.0), -0.1) < 0.5  # but it is for a fatter one
    assert enter((0.0, 0.5, 0.0), (0.0, 1.0, 0.0)) == math.inf  # leaving


@pytest.mark.slow
@given(points, points, radii)
def test_capsule_edges_match_fine_polygon(point, half, radius):
    point[2] = half[2] = 0.0
    distance, _ = of_capsule(point, half, radius)
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


@pytest.mark.slow
@given(points, points, points, radii)
def test_every_ray_is_tangent_in_3d(point, half, net_bearing, radius):
    point, half = tuple(point), tuple(half)
    distance, _ = of_capsule(point, half, radius)
    assume(distance > 0.02)
    towards = centre_direction(point, ZERO)
    e, w = azimuth_axes(towards, tuple(net_bearing), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    rays = np.empty((8, 3))
    CAPSULES.cone(row(half, radius), 0, point, (towards, e, w), rays)
    for k, ray in enumerate(rays):
        assert np.linalg.norm(ray) == pytest.approx(1)
        to_axis = lambda t, ray=ray: of_capsule(np.add(point, t * ray), half, 0.0)[0]  # noqa: E731
        nearest = minimize_scalar(to_axis, bounds=(0.0, 40.0), method="bounded")  # convex
        assert nearest.fun == pytest.approx(radius, abs=1e-6)
        aside = math.cos(k * math.pi / 4) * np.array(e) + math.sin(k * math.pi / 4) * np.array(w)
        across = ray - np.dot(ray, towards) * np.array(towards)
        assert np.linalg.norm(across - np.dot(across, aside) * aside) < 1e-9  # at its azimuth
        assert np.dot(across, aside) >= 0
