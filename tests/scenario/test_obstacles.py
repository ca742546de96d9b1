"""Obstacles as data: accepted and rejected values, and random scenarios."""

import math

import numpy as np
import pytest
import shapely
from conftest import started

from rendezvous_env import Scenario
from rendezvous_env.obstacles.capsule import CAPSULE, Capsule
from rendezvous_env.obstacles.disc import BALL, Disc, Sphere
from rendezvous_env.obstacles.fields import ObstacleField, draw_field
from rendezvous_env.obstacles.obstacle_set import (
    check_outside,
    outlines,
    pack,
    table_of,
    world_of,
)
from rendezvous_env.obstacles.parsing import max_count, parse, row_width, to_plain
from rendezvous_env.obstacles.polygon import POLYGON, Polygon
from rendezvous_env.obstacles.shape import ABSENT, CENTRE, KIND, RADIUS
from rendezvous_env.physics.random_streams import OBSTACLES, stream_key

pytestmark = pytest.mark.kernels

TRIANGLE = ((0, 0), (3, 0), (0, 3))
FIELD = ObstacleField(count=(2, 5), radius=(0.5, 1.5), region=12.0, keep_out=0.4, overlap=False)

LOG = Capsule(((-1.0, 0.0), (1.0, 2.0)), 0.5)
TRUNK = Capsule(((-1.0, 0.0, 1.0), (1.0, 2.0, 3.0)), 0.5)


class TestValidation:
    def test_clockwise_vertices_are_reversed(self):
        assert Polygon(TRIANGLE[::-1]) == Polygon(((0, 3), (0, 0), (3, 0)))
        assert Polygon(((0, 0), (0, 3), (3, 0))) == Polygon(TRIANGLE)

    def test_rounding_does_not_make_polygon_concave(self):
        """A long, thin, rotated rectangle, whose area is known to fewer digits."""
        long = np.array([(-1000.0, -0.005), (1000.0, -0.005), (1000.0, 0.005), (-1000.0, 0.005)])
        along = np.array([(-1.0, -1.0), (0.3, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
        rng = np.random.default_rng(0)
        for k in range(300):
            angle = 0.3 if k == 0 else rng.uniform(-math.pi, math.pi)
            c, s = math.cos(angle), math.sin(angle)
            turn = np.array([(c, -s), (s, c)])
            size, away = 10.0 ** rng.uniform(-2, 4, 2), rng.normal(0, 1000, 2)
            for corners in (long, along * size):  # the second with a corner on a straight edge
                Polygon(corners @ turn.T)
                Polygon(corners @ turn.T + away)

    @pytest.mark.parametrize("scale", [1e-2, 1.0, 1e3])
    def test_small_dent_is_rejected(self, scale):
        corners = np.array([(0.0, 0.0), (1.0, 1e-10), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)])
        with pytest.raises(ValueError, match="not convex"):
            Polygon(scale * corners)

    def test_centroid_equals_shapely(self):
        rng = np.random.default_rng(0)
        for _ in range(100):
            hull = shapely.MultiPoint(rng.normal(100, 2, (9, 2))).convex_hull
            polygon = Polygon(tuple(hull.exterior.coords)[:-1])
            np.testing.assert_allclose(polygon.centroid, hull.centroid.coords[0], atol=1e-9)


class TestPlainData:
    @pytest.mark.parametrize(
        ("value", "dim"),
        [
            ((), 2),
            ((Disc((0.1, 1 / 3), 0.7), Polygon(TRIANGLE)), 2),
            ((Sphere((0.1, 2, 3), 0.7), Capsule(((0.1, 2, 3), (3, 1 / 3, 3)), 0.7)), 3),
            ((Capsule(((0.1, 2), (3, 1 / 3)), 0.7),), 2),
            (FIELD, 2),
            (ObstacleField(4, (1, 1), 8, 0), 3),
        ],
    )
    def test_plain_data_round_trip_is_exact(self, value, dim):
        assert parse(to_plain(value), dim) == value
        assert parse(value, dim) == value

    @pytest.mark.parametrize("one", [LOG, TRUNK, Disc((1, 2), 3), Sphere((1, 2, 0), 3)])
    def test_single_obstacle_and_keys_are_parsed(self, one):
        (plain,) = to_plain((one,))
        plain.pop("kind", None)
        assert parse(plain, one.dim) == parse(one, one.dim) == (one,)


class TestPacking:
    def test_packing_matches_hand_computation(self):
        rows = pack([Polygon(TRIANGLE), Disc((5, 6), 7)], 3)
        polygon = [POLYGON, 3, math.sqrt(5), 1, 1, 0, 0, 0, 3, 0, 0, 3]
        np.testing.assert_allclose(rows[0], polygon, atol=1e-15)
        assert rows[1].tolist() == [BALL, 0, 7, 5, 6, 0, 0, 0, 0, 0, 0, 0]
        assert rows[2].tolist() == [ABSENT] + [0] * 11
        assert pack([Sphere((1, 2, 3), 4)], 1).tolist() == [[BALL, 0, 4, 1, 2, 3]]
        flat = pack([Capsule(((1, 0), (5, 0)), 0.5)], 1)
        assert flat.tolist() == [[CAPSULE, 0, 2.5, 3, 0, 0, 2, 0, 0, 0.5]]
        upright = pack([Capsule(((1, 2, 0), (1, 2, 4)), 0.5)], 1)
        assert upright.tolist() == [[CAPSULE, 0, 2.5, 1, 2, 2, 0, 0, 2, 0.5]]

    def test_world_and_table_round_trip(self):
        table = pack([Polygon(TRIANGLE), Disc((5, 6), 7), Capsule(((1, 0), (5, 0)), 0.5)], 4)
        tables = np.stack([table, table[[2, 0, 3, 1]]])
        np.testing.assert_array_equal(table_of(world_of(tables)), tables)

    def test_width_and_count_are_bounds(self):
        few = (Disc((0, 0), 1), Polygon(TRIANGLE))
        assert (row_width(few), max_count(few)) == (12, 2)
        assert (row_width(()), max_count(())) == (6, 0)
        assert (row_width(FIELD), max_count(FIELD)) == (6, 5)

    def test_missing_slots_are_rejected(self):
        with pytest.raises(ValueError, match="2 given, but the scenario has 1 obstacle slots; set"):
            pack([Disc((0, 0), 1)] * 2, 1)
        with pytest.raises(ValueError, match=r"obstacles\[0\] is .*a polygon of no more corners"):
            pack([Polygon(TRIANGLE)], 1, width=8)

    def test_positions_inside_obstacles_are_named(self):
        check_outside("positions", np.array([[2.0, 0.0], [0.0, 3.0]]), (Disc((0, 0), 2),))
        with pytest.raises(ValueError, match=r"positions: robot_1 at \[0.0, 1.5\] is 0.5 m inside"):
            check_outside("positions", np.array([[2.0, 0.0], [0.0, 1.5]]), (Disc((0, 0), 2),))


def draw(field, episode, starts):
    """Whether an obstacle field was sampled, and its table (6, width)."""
    key = np.uint64(stream_key(11, episode, OBSTACLES))
    table = np.full((6, row_width(field)), 77.0)
    obstacles = world_of(table, only_balls=True)
    drawn = draw_field(key, field.rules, starts, len(starts), obstacles)
    return drawn, table_of(obstacles)


class TestDrawField:
    @pytest.mark.parametrize("dim", [2, 3])
    def test_random_field_respects_constraints(self, dim):
        starts = np.random.default_rng(dim).uniform(-6, 6, (4, dim))
        counts = []
        for episode in range(300):
            drawn, rows = draw(FIELD, episode, starts)
            count = int((rows[:, KIND] == BALL).sum())
            counts.append(count)
            assert drawn and np.all(rows[count:, KIND] == ABSENT)
            radii, centres = rows[:count, RADIUS], rows[:count, CENTRE : CENTRE + dim]
            assert not rows[:count, CENTRE + dim :].any()
            assert np.all((radii >= 0.5) & (radii < 1.5))
            assert np.all(np.abs(centres) <= 6)
            gaps = np.linalg.norm(centres[:, None] - starts, axis=2) - radii[:, None]
            assert gaps.min() >= 0.4
            between = np.linalg.norm(centres[:, None] - centres, axis=2) + 99 * np.eye(count)
            assert np.all(between >= radii[:, None] + radii)
        assert np.all(np.bincount(counts, minlength=6)[2:] > 40)
        assert set(counts) == {2, 3, 4, 5}

    def test_only_given_number_of_starts_counts(self):
        starts, key = np.array([[9.0, 9.0], [0.0, 0.0]]), np.uint64(stream_key(0, 0, OBSTACLES))
        rules = ObstacleField(1, (1.0, 1.0), 0.1, 0.5).rules
        obstacles = world_of(pack([], 6), only_balls=True)
        assert draw_field(key, rules, starts, 1, obstacles)
        assert not draw_field(key, rules, starts, 2, obstacles)

    def test_full_region_fails_and_keeps_placed_obstacles(self):
        drawn, rows = draw(ObstacleField(6, (1, 1), 2.5, 0, False), 0, np.empty((0, 2)))
        assert not drawn
        count = int((rows[:, KIND] == BALL).sum())
        assert 1 <= count < 6
        assert np.all(rows[count:, KIND] == ABSENT)


def test_capsule_outline_is_exact():
    (outline,) = outlines(pack((LOG,), 1), 2)
    away = [distance(corner, LOG) for corner in outline.vertices]
    np.testing.assert_allclose(away, 0.5)
    edges = np.roll(outline.vertices, -1, axis=0) - outline.vertices
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    assert (turns > -1e-12).all()  # convex, counter-clockwise
    beads = outlines(pack((TRUNK,), 1), 3)
    np.testing.assert_allclose([distance(bead.centre, TRUNK) for bead in beads], 0, atol=1e-12)
    np.testing.assert_allclose(beads[0].centre, TRUNK.ends[0])
    np.testing.assert_allclose(beads[-1].centre, TRUNK.ends[1])
    assert np.linalg.norm(beads[1].centre - beads[0].centre) <= 0.5


def distance(point, capsule: Capsule) -> float:
    first, second = np.array(capsule.ends)
    along = second - first
    share = np.clip((point - first) @ along / (along @ along), 0, 1)
    return float(np.linalg.norm(point - first - share * along))


def test_obstacles_can_be_given_at_reset():
    moved, disc = Capsule(((5.0, 5.0), (6.0, 5.0)), 0.25), Disc((0.0, 0.0), 1.0)
    scenario = Scenario(n_robots=2, obstacles=[LOG], obstacle_slots=2, spawn_size=20.0)
    sim = started(scenario, obstacles=[moved, disc])
    np.testing.assert_array_equal(sim.obstacles[0], pack((moved, disc), 2, 10))
    with pytest.raises(ValueError, match=r"obstacles\[0\] is Capsule.* needs a longer row"):
        started(scenario.replace(obstacles=[disc]), obstacles=[moved])
    square = Polygon(((0, 0), (1, 0), (1, 1), (0, 1)))
    started(Scenario(n_robots=2, obstacles=[square], spawn_size=20.0), obstacles=[square])
    with pytest.raises(ValueError, match=r"obstacles\[0\] is Capsule"):
        started(Scenario(n_robots=2, dim=3, obstacles=[Sphere((0.0,) * 3, 1.0)]), obstacles=[TRUNK])
