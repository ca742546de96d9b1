"""Equations of imperfect sensing: missed detections and bearing errors."""

import math

import numpy as np
import pytest
from geometry import triple, world
from shapely.geometry import LineString, Point, Polygon

import rendezvous_env as rv
from rendezvous_env.physics.hull_perimeter import size
from rendezvous_env.physics.worst_bias import outward_directions
from rendezvous_env.sensors.imperfections import (
    in_sectors,
    is_hidden_by_obstacles,
    is_hidden_by_robot,
    turned,
    turned_towards,
)

pytestmark = pytest.mark.kernels

Z_AXIS = (0.0, 0.0, 1.0)


def angle_between(a, b):
    return math.atan2(np.linalg.norm(np.cross(triple(a), triple(b))), np.dot(a, b))


def vectors(d: int, count: int, seed: int = 0) -> list[tuple[float, ...]]:
    table = np.random.default_rng(seed).normal(size=(count, d))
    return [tuple(row) for row in table.tolist()]


def test_positive_angle_rotates_counter_clockwise():
    assert turned((2.0, 0.0), math.pi / 2, Z_AXIS) == pytest.approx((0.0, 2.0))
    assert turned((0.0, 1.0), 0.3, Z_AXIS) == pytest.approx((-math.sin(0.3), math.cos(0.3)))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.4, 3.0])
def test_rotation_has_angle_and_keeps_length(d, angle):
    for row, axis in zip(vectors(d, 50), vectors(3, 50, seed=1), strict=True):
        found = turned(row, angle, axis)
        assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(row), rel=1e-14)
        assert angle_between(row, found) == pytest.approx(angle, abs=1e-12)


def test_rotation_in_3d_is_about_perpendicular_axis():
    assert turned((1.0, 0.0, 0.0), math.pi / 2, (5.0, 0.0, 2.0)) == pytest.approx((0.0, 1.0, 0.0))
    for row, axis in zip(vectors(3, 50), vectors(3, 50, seed=1), strict=True):
        about = np.cross(row, turned(row, 0.5, axis))
        about /= np.linalg.norm(about)
        across = np.array(axis) - np.dot(axis, row) / np.dot(row, row) * np.array(row)
        assert about == pytest.approx(across / np.linalg.norm(across), abs=1e-9)


def test_parallel_axis_is_replaced_and_zero_row_stays_zero():
    for row in ((1.0, 0.0, 0.0), (0.0, -2.0, 0.0), (0.0, 0.0, 1e-9)):
        assert angle_between(row, turned(row, 0.7, row)) == pytest.approx(0.7)
    for zero in ((0.0, 0.0), (0.0, 0.0, 0.0)):
        assert turned(zero, 0.7, Z_AXIS) == zero


@pytest.mark.parametrize("d", [2, 3])
def test_turned_towards_is_optimal(d):
    angle = 0.3
    for k, (row, target) in enumerate(zip(vectors(d, 40), vectors(d, 40, seed=2), strict=True)):
        found = turned_towards(row, angle, target)
        assert angle_between(row, found) == pytest.approx(angle, abs=1e-12)
        others = [turned(row, s * angle, a) for a in vectors(3, 40, seed=k) for s in (-1, 1)]
        best = max(np.dot(other, target) for other in others)
        assert np.dot(found, target) >= best - 1e-12


@pytest.mark.parametrize("sectors", [2, 4, 6, 8, 15])
def test_sectors_quantise_yaw_and_elevation(sectors):
    width = 2 * math.pi / sectors
    for row in vectors(3, 300):
        x, y, z = in_sectors(row, sectors)
        assert math.hypot(x, y, z) == pytest.approx(np.linalg.norm(row))
        pitch = math.atan2(z, math.hypot(x, y)) / width
        assert pitch == pytest.approx(round(pitch), abs=1e-9)
        wanted = math.atan2(row[2], math.hypot(row[0], row[1])) / width
        assert abs(pitch - wanted) <= 0.5 + 1e-9 or abs(wanted) > math.floor(sectors / 4)
        if math.hypot(x, y) > 1e-9:
            yaw = math.atan2(y, x) / width
            assert yaw == pytest.approx(round(yaw), abs=1e-9)
            turn = (yaw - math.atan2(row[1], row[0]) / width) % sectors
            assert min(turn, sectors - turn) <= 0.5 + 1e-9


def test_robots_occlude_as_discs():
    random, hidden, radius = np.random.default_rng(3), [], 0.3
    for _ in range(2000):
        offset, other = random.normal(size=(2, 2))
        apart = LineString([(0.0, 0.0), offset]).distance(Point(other)) - radius
        if np.linalg.norm(other) < radius or abs(apart) < 1e-9:
            continue
        hidden.append(apart < 0 and np.linalg.norm(other) < np.linalg.norm(offset))
        assert is_hidden_by_robot(triple(offset), triple(other), radius) == hidden[-1]
    assert 100 < sum(hidden) < len(hidden) - 100


def test_nearest_robot_is_always_visible():
    for first, second in zip(vectors(3, 200), vectors(3, 200, seed=1), strict=True):
        near, far = sorted((first, second), key=np.linalg.norm)
        assert not is_hidden_by_robot(near, far, 5.0)


def test_overlapping_robot_does_not_occlude():
    assert is_hidden_by_robot((2.0, 0.0, 0.0), (0.05, 0.0, 0.0), 0.1)
    assert not is_hidden_by_robot((-2.0, 0.0, 0.0), (0.05, 0.0, 0.0), 0.1)
    assert not is_hidden_by_robot((0.0, 0.0, 0.0), (0.05, 0.0, 0.0), 0.1)


CORNERS = ((-1.5, -0.5), (-0.4, -0.8), (-0.6, 0.7))
SHAPES = (
    rv.Disc((1.0, 0.5), 0.5),
    rv.Polygon(CORNERS),
    rv.Capsule(((0.5, -1.2), (1.6, -0.9)), 0.2),
)
OUTLINES = (
    Point(1.0, 0.5).buffer(0.5, quad_segs=512),
    Polygon(CORNERS),
    LineString([(0.5, -1.2), (1.6, -0.9)]).buffer(0.2, quad_segs=512),
)


@pytest.mark.parametrize("m", range(3))
def test_obstacles_occlude_line_of_sight(m):
    random, hidden = np.random.default_rng(4), []
    for _ in range(1500):
        start, end = random.uniform(-2.5, 2.5, size=(2, 2))
        inside = LineString([start, end]).intersection(OUTLINES[m]).length
        if 0.0 < inside < 1e-2:
            continue
        hidden.append(inside > 0.0)
        way = triple(end - start)
        assert is_hidden_by_obstacles(world([SHAPES[m]]), triple(start), way) == hidden[-1]
    assert 100 < sum(hidden) < len(hidden) - 100


def test_touching_obstacle_occludes_only_through_it():
    disc = world([rv.Disc((0.0, 0.0), 1.0)])
    assert not is_hidden_by_obstacles(disc, (1.0, 0.0, 0.0), (0.0, 3.0, 0.0))
    assert is_hidden_by_obstacles(disc, (1.0, 0.0, 0.0), (-3.0, 0.5, 0.0))


def test_absent_obstacle_does_not_occlude():
    absent = world([rv.Sphere((0.0, 0.0, 0.0), 1.0)], slots=2)
    absent.kinds[0] = absent.kinds[1]
    assert not is_hidden_by_obstacles(absent, (-2.0, 0.0, 0.0), (4.0, 0.0, 0.0))


def outward(positions, merged_into=None):
    out = np.zeros_like(positions)
    everyone = np.arange(len(positions)) if merged_into is None else merged_into
    outward_directions(positions, everyone, out)
    return out


def gradient_of_size(positions, i, step=1e-6):
    """Gradient by central differences."""
    gradient = []
    for shift in np.eye(positions.shape[1]) * step:
        there, back = positions.copy(), positions.copy()
        there[i], back[i] = there[i] + shift, back[i] - shift
        gradient.append((size(there) - size(back)) / (2 * step))
    return np.array(gradient)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [2, 3, 4, 7, 12])
def test_outward_direction_is_perimeter_gradient(d, n):
    random, inside = np.random.default_rng(n), 0
    for _ in range(5):
        positions = random.normal(size=(n, d))
        found = outward(positions)
        for i in range(n):
            gradient = gradient_of_size(positions, i)
            length = np.linalg.norm(gradient)
            if 1e-6 < length < 1e-2:
                continue  # too short for its direction to be found by differences
            if length < 1e-6:
                gradient, inside = positions[i] - positions.mean(axis=0), inside + 1
            assert found[i] == pytest.approx(gradient / np.linalg.norm(gradient), abs=2e-4)
    assert inside > 0 or n < 7


@pytest.mark.parametrize("d", [2, 3])
def test_outward_of_collinear_team_is_along_line(d):
    along = np.array([0.6, 0.8, 0.0])[:d]
    found = outward(np.array([0.0, 2.0, 0.5, 5.0])[:, None] * along)
    assert found[0] == pytest.approx(-along) and found[3] == pytest.approx(along)


def test_outward_of_grid_counts_edges_once():
    """Corners of a cube with the midpoints of its edges and faces, and its centre."""
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    found = outward(grid)
    for place, direction in zip(grid, found, strict=True):
        if place.any():
            assert direction == pytest.approx(place / np.linalg.norm(place), abs=1e-9)
        else:
            assert not direction.any()


def test_merged_robots_are_ignored():
    positions = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 3.0], [9.0, 9.0]])
    found = outward(positions, np.array([0, 1, 2, 0]))
    assert found[:3] == pytest.approx(outward(positions[:3])) and not found[3].any()
