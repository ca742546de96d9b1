"""Unions of touching obstacles: no penetration, and no unreported stop."""

import math

import numpy as np
import pytest
import shapely
from geometry import triple, world
from parameters import first_fast, nightly, slow
from test_contact import move_one_curved, move_one_straight
from union_presses import MODELS, UNIONS, Count, pressed

import baselines
import rendezvous_env as rv
from rendezvous_env import Capsule, Disc, Polygon, Sphere
from rendezvous_env.obstacles.contact import IGNORE, SLIDE, STOP
from rendezvous_env.obstacles.obstacle_set import (
    clear_of_obstacles,
    close_seams,
    distance_to,
    is_hidden_by_obstacles,
    silhouette_2d,
    world_of,
)
from rendezvous_env.obstacles.shape import SKIN

ROOM = (
    ((-2, -2), (2, -2), (2, -1), (-2, -1)),
    ((-2, 1), (2, 1), (2, 2), (-2, 2)),
    ((-2, -1), (-1, -1), (-1, 1), (-2, 1)),
    ((1, -1), (2, -1), (2, 1), (1, 1)),
)
SPEEDS = (1e-3, 1.0, 1e3, 1e6)
TAU = 0.05


def tile(x, y, size=1.0):
    """A square with its lower left corner at (x, y)."""
    return Polygon(((x, y), (x + size, y), (x + size, y + size), (x, y + size)))


def skins(*obstacles):
    """Whether each obstacle has a skin."""
    return (world(obstacles).skins > 0).tolist()


def turned(obstacles, angle):
    """Polygons rotated about the origin."""
    c, s = math.cos(angle), math.sin(angle)
    return [
        Polygon(tuple((c * x - s * y, s * x + c * y) for x, y in one.vertices)) for one in obstacles
    ]


class TestTheIssue:
    """A closed room, and a wall of tiles 80 m long."""

    @pytest.mark.parametrize("angle", [0.0, 0.4, 2.0])
    @pytest.mark.parametrize("policy", ["bearing-only", slow("tangent-merged-tuned")])
    def test_a_robot_in_a_room_without_a_door_is_not_met(self, policy, angle):
        room = turned([Polygon(vertices) for vertices in ROOM], angle)
        scenario = rv.Scenario(
            n_robots=2, obstacles=room, max_speed=1.0, time_step=TAU, allow_long_step=True
        )
        random, teams = np.random.default_rng(0), 40
        bearings = random.uniform(0, 2 * math.pi, teams)
        outside = 3.5 * np.c_[np.cos(bearings), np.sin(bearings)]
        starts = np.stack([random.uniform(-0.65, 0.65, (teams, 2)), outside], axis=1)
        simulator = rv.Simulator(scenario, teams)
        observations = simulator.reset(0, {"positions": starts})
        law, contacts = baselines.make(policy, scenario), np.zeros((teams, 2), dtype=int)
        for step in range(400):
            outcome = simulator.step(law(observations, np.full(teams, step * TAU)))
            observations, contacts = outcome.observations, contacts + outcome.contact
        c, s = math.cos(angle), math.sin(angle)
        places = simulator.positions @ np.array([[c, -s], [s, c]])
        assert np.abs(places[:, 0]).max() < 1
        assert np.abs(places[:, 1]).max(axis=-1).min() > 2
        if policy == "bearing-only":
            assert (contacts[:, 0] > 200).all()

    @pytest.mark.parametrize("overlap", first_fast([1e-9, 0.0, 1e-7, 1e-6]))
    def test_a_wall_of_tiles_80_m_long_stops_law_1_with_contacts(self, overlap):
        tiles = [tile(-40 + k, 0, 1 + overlap) for k in range(80)]
        for x in (0.0, 0.3, 7.0):  # on a seam and beside it
            start, contacts = np.array([x, -0.5]), 0
            for _ in range(20):
                moved, contact = move_one_straight(start, (0.0, 0.1), world(tiles), SLIDE)
                start, contacts = start + moved, contacts + contact
            assert start[1] < 0 and contacts >= 14


class TestSkins:
    """Touching shapes, by hand."""

    @pytest.mark.parametrize("gap", [-1e-6, -1e-9, 0.0, 1e-9, 1.5e-6])
    def test_shapes_that_only_just_meet_have_one(self, gap):
        assert skins(tile(0, 0), tile(1 + gap, 0.3)) == [True, True]
        assert skins(Disc((0, 0), 1), Disc((3 + gap, 0), 2)) == [True, True]
        assert skins(Capsule(((0, 0), (0, 2)), 0.5), Disc((1.5 + gap, 1), 1)) == [True, True]
        assert skins(Disc((-1, 0.5), 1), tile(gap, 0)) == [True, True]
        assert skins(Capsule(((0, 0, 0), (0, 9, 0)), 1), Sphere((0, 4, 3 + gap), 2)) == [True] * 2

    @pytest.mark.parametrize("gap", [-1.0, -1e-3, -3e-6, 1.9e-6, 1e-5, 3.0])
    def test_others_have_none(self, gap):
        assert skins(tile(0, 0), tile(1 + gap, 0.3)) == [False, False]
        assert skins(Disc((0, 0), 1), Disc((3 + gap, 0), 2)) == [False, False]
        assert skins(Capsule(((0, 0), (0, 2)), 0.5), Disc((1.5 + gap, 1), 1)) == [False, False]

    def test_closed_form_for_discs_agrees_with_general_shapes(self):
        random, found = np.random.default_rng(5), []
        for _ in range(300):
            one, other = random.uniform(0.1, 2.0, 2)
            gap = random.choice([-3e-6, -2e-6, -1e-6, 0.0, 1.5e-6, 2e-6, 1e-3, -2.5 * one])
            c, s = math.cos(turn := random.uniform(0, 7)), math.sin(turn)
            reach = max(one + other + gap, 0.0)
            discs = [Disc((0.3, -0.2), one), Disc((0.3 + reach * c, -0.2 + reach * s), other)]
            ours, general = world(discs), world(discs)
            general.skins[:] = 0.5  # not a value of either
            close_seams(general, 2)
            np.testing.assert_array_equal(ours.skins, general.skins)
            found.append(ours.skins.all())
        assert 50 < sum(found) < 250

    def test_turned_tiles_of_any_size_have_one_if_they_meet(self):
        random = np.random.default_rng(0)
        for gap in (0.0, -1e-9, -1e-6, 1.5e-6, 2.5e-6, -3e-6, 1e-3):
            for size in 10.0 ** random.uniform(-2, 2, 20):
                shift = random.uniform(-20, 20, 2)
                other = tile(gap, size * random.uniform(-0.8, 0.8), size)
                pair = turned([tile(-size, 0, size), other], random.uniform(0, 7))
                moved = [Polygon(tuple(map(tuple, shift + one.vertices))) for one in pair]
                assert skins(*moved) == [-2.2e-6 < gap < 1.8e-6] * 2, (gap, size)

    def test_corners_that_meet_have_one_however_sharp(self):
        for half in (1e-3, 0.1, 1.0, 5.0):
            left = Polygon(((0, 0), (-1, half), (-1, -half)))
            for overlap in (0.0, 1e-7):
                right = Polygon(((-overlap, 0), (1, -half), (1, half)))
                assert skins(left, right) == [True, True]

    def test_only_who_meets_has_one(self):
        assert skins(tile(0, 0), tile(5, 5), tile(1, 0), Disc((-9, 0), 1)) == [
            True, False, True, False,
        ]  # fmt: skip

    def test_three_spheres_that_leave_nothing_between_them_have_one(self):
        random = np.random.default_rng(0)
        corners = np.array([(0, 0, 0), (1, 0, 0), (0.5, math.sqrt(0.75), 0)])
        for cover, wanted in ((0.0, True), (1e-7, True), (1e-3, False), (-1e-3, False)):
            for size in 10.0 ** random.uniform(-2, 2, 10):
                turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
                places = size * corners @ turn + random.uniform(-20, 20, 3)
                radius = size / math.sqrt(3) + cover
                assert skins(*(Sphere(tuple(p), radius) for p in places)) == [wanted] * 3

    @pytest.mark.parametrize(
        "name", first_fast(["clutter-24", "clutter-3d-32", "rooms", "trap", "window-3d"])
    )
    def test_the_named_scenarios_have_none(self, name):
        scenario = rv.scenarios.get(name)
        simulator = rv.Simulator(scenario, 50)
        simulator.reset(0)
        for table in simulator.obstacles:
            assert not world_of(table, dim=scenario.dim).skins.any()


@pytest.mark.kernels
class TestMotion:
    """Motion near a wall of two tiles with its face on y = 0, robots below it."""

    WALL = (tile(-1, 0), tile(0, 0))

    def test_a_robot_keeps_a_skin_away_and_slides_past_the_seam(self):
        start = np.array([-0.5, -0.3])
        for way, end in (((0.2, 0.5), (-0.3, -SKIN)), ((0.7, 0.1), (0.4, -SKIN))):
            moved, contact = move_one_straight(start, way, world(self.WALL), SLIDE)
            start = start + moved
            np.testing.assert_allclose(start, end, atol=1e-12)
            assert contact

    def test_along_the_wall_and_away_it_is_free_from_the_surface_too(self):
        for height in (0.0, -SKIN / 2, -SKIN):
            for way in ((0.5, 0.0), (0.5, -0.1), (0.0, -0.2)):
                moved, contact = move_one_straight((-0.2, height), way, world(self.WALL), SLIDE)
                np.testing.assert_allclose(moved, way, atol=2.01e-6)
                assert not contact and height + moved[1] <= -SKIN + 1e-13

    def test_a_robot_on_the_seam_gets_out_but_not_in(self):
        for way in ((0.0, 1e-4), (0.0, 0.1), (0.1, 0.4), (0.0, 1e5)):
            moved, contact = move_one_straight((0.0, 0.0), way, world(self.WALL), STOP)
            assert contact and moved[1] <= 0
        moved, contact = move_one_straight((0.0, 0.0), (0.0, -1.0), world(self.WALL), STOP)
        np.testing.assert_allclose(moved, (0, -1), atol=5e-6)
        assert not contact

    def test_between_tiles_there_is_no_room(self):
        for way in ((0.0, -1.0), (0.0, 1.0), (1e-3, 0.0)):
            moved, contact = move_one_straight((0.0, 0.5), way, world(self.WALL), SLIDE)
            assert contact and not moved.any()
        assert not move_one_straight((0.0, 0.5), (0.0, 0.0), world(self.WALL), SLIDE)[1]
        assert not clear_of_obstacles((0.0, 0.5, 0.0), world(self.WALL), 0.0)
        with pytest.raises(ValueError, match=r"robot_0 at .* is between obstacles without"):
            rv.Scenario(n_robots=2, obstacles=self.WALL, start_positions=[[0, 0.5], [3, 3]])

    def test_ignored_obstacles_have_no_seams(self):
        moved, contact = move_one_straight((0.0, -0.5), (0.0, 2.0), world(self.WALL), IGNORE)
        assert tuple(moved) == (0, 2) and not contact

    @pytest.mark.parametrize("mode", [SLIDE, STOP])
    @pytest.mark.parametrize("overlap", [0.0, 1e-9, 1e-8, 1e-7, 1e-6])
    def test_a_robot_held_between_two_walls_is_in_contact(self, overlap, mode):
        """Adjacent boxes, and two that form a corner; one face protrudes a little."""
        for other in (
            tile(-overlap, 1e-3),
            tile(-overlap, -1),
            Polygon(((-overlap, -2), (1, -2), (1, 3), (-overlap, 3))),
        ):
            scene = world((tile(-1, 0), other))
            for speed in SPEEDS:
                start = np.array([-1e-4, -1e-4])
                for _ in range(4):
                    moved, contact = move_one_straight(start, (0, speed * TAU), scene, mode)
                    start = start + moved
                assert contact and start[1] < 1e-3

    def test_a_robot_that_is_pressed_less_than_a_micron_at_a_time_is_in_contact(self):
        wall = world([tile(0, 0)])
        moved, contact = move_one_straight((0.5, 0.0), (0.0, 3e-7), wall, SLIDE)
        assert contact and np.abs(moved).max() < 1e-12
        for way in ((1e-3, 3e-7), (1e-7, 3e-7)):
            assert not move_one_straight((0.5, 0.0), way, wall, SLIDE)[1]
        corner = world([tile(0, 0), tile(0.9, -0.9)])
        assert move_one_straight((0.9, 0.0), (1e-7, 3e-7), corner, SLIDE)[1]

    @pytest.mark.parametrize("rate", [0.0, 2.0, -0.5])
    @pytest.mark.parametrize("speed", SPEEDS)
    def test_unicycles_do_not_pass_a_seam(self, speed, rate):
        wall = world([tile(-20 + k, 0) for k in range(40)])
        for x in (0.0, 0.2):
            way, contact = move_one_curved(
                (x, -1e-5), (speed, math.pi / 2, 0, rate, 0, TAU), wall, SLIDE
            )
            assert -1e-5 + way[1] < 0 or abs(x + way[0]) > 20
            assert contact


PAIRS = [(dim, model) for dim in MODELS for model in MODELS[dim]]
OF_EVERY_MODEL = [pair if pair == (3, "nonholonomic_3d") else nightly(*pair) for pair in PAIRS]


class TestPresses:
    """Robots of every model against random unions, see ``research/union_presses.py``."""

    @staticmethod
    def count(dim, model, seed):
        """In each mode; double integrators, which take longest, in one mode for each union."""
        random, total, modes = np.random.default_rng(seed), Count(), ("slide", "stop")
        for k, make in enumerate(UNIONS[dim]):
            for mode in modes[k % 2 :: 2] if model == "double_integrator" else modes:
                found = pressed(make(random), dim, model, mode, random)
                assert found.presses > 1000, make.__name__
                assert found[1:] == (0, 0), (make.__name__, mode)
                total = Count(*map(sum, zip(total, found, strict=True)))
        return total

    @pytest.mark.slow
    @pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
    def test_of_points_in_the_plane(self, seed):
        self.count(2, "single_integrator", seed)

    @pytest.mark.slow
    @pytest.mark.parametrize(("dim", "model"), OF_EVERY_MODEL)
    def test_of_every_model(self, dim, model):
        self.count(dim, model, 10)


class TestAgainstShapely:
    """Unions of shapes that overlap, touch or lie apart."""

    @staticmethod
    def shapes(random):
        """Shapes with their regions; round ones as fine polygons, for bearings."""
        out = [tile(0, 0), tile(1, 0), tile(1 - 1e-7, 1), tile(3, 0.5)]
        for _ in range(4):
            centre, size = random.uniform(-4, 4, 2), random.uniform(0.3, 1.0)
            angles = random.uniform(0, 2 * math.pi) + np.arange(5) * 2 * math.pi / 5
            corners = centre + size * np.c_[np.cos(angles), np.sin(angles)]
            out.append(Polygon(tuple(map(tuple, corners))))
        return out, shapely.union_all([shapely.Polygon(one.vertices) for one in out])

    def test_clearance_is_the_distance_to_the_union(self):
        random = np.random.default_rng(0)
        for _ in range(20):
            shapes, union = self.shapes(random)
            axis = random.uniform(-4, 4, (2, 2))
            round_ones = [Disc(tuple(axis[0]), 0.7), Capsule(tuple(map(tuple, axis)), 0.2)]
            cores = shapely.Point(axis[0]), shapely.LineString(axis)
            scene = world([*shapes, *round_ones])
            for point in random.uniform(-6, 6, (200, 2)):
                there = shapely.Point(point)
                wanted = min(
                    union.distance(there), cores[0].distance(there) - 0.7,
                    cores[1].distance(there) - 0.2,
                )  # fmt: skip
                if wanted > 1e-6:
                    found = min(
                        distance_to(scene, m, triple(point)) for m in range(len(scene.kinds))
                    )
                    assert found == pytest.approx(wanted, abs=1e-9)

    @pytest.mark.slow
    def test_silhouettes_cover_the_angular_extent_of_the_union(self):
        """As in tangent-merged: ends of the merged intervals."""
        random = np.random.default_rng(1)
        for _ in range(20):
            shapes, union = self.shapes(random)
            scene, seen = world(shapes), np.empty((2, 2))
            for point in random.uniform(-6, 6, (100, 2)):
                if union.distance(shapely.Point(point)) < 1e-3:
                    continue
                spans = []
                for m in range(len(shapes)):
                    silhouette_2d(scene, m, triple(point), seen)
                    left, right = np.arctan2(seen[:, 1], seen[:, 0])
                    spans.append((right, (left - right) % (2 * math.pi)))
                found = joined(spans)
                wanted = joined([extent(part, point) for part in getattr(union, "geoms", [union])])
                assert len(found) == len(wanted)
                for one, other in zip(found, wanted, strict=True):
                    assert abs(math.remainder(one[0] - other[0], 2 * math.pi)) < 1e-9
                    assert one[1] == pytest.approx(other[1], abs=1e-9)


def extent(region, point):
    """Interval of angles, (first, width), covered by a connected region."""
    around = shapely.get_coordinates(region.exterior) - point
    angles = np.unwrap(np.arctan2(around[:, 1], around[:, 0]))
    return float(angles.min()), min(float(np.ptp(angles)), 2 * math.pi)


def joined(spans):
    """Merged intervals (first, width) of angles, sorted by their first angle."""
    if any(width > 2 * math.pi - 1e-9 for _, width in spans):
        return [(0.0, 2 * math.pi)]
    spans = sorted((first % (2 * math.pi), width) for first, width in spans)
    out = []
    for first, width in spans:
        if out and first <= out[-1][0] + out[-1][1] + 1e-12:
            begun = out[-1][0]
            out[-1] = begun, max(out[-1][1], first + width - begun)
        else:
            out.append((first, width))
    while len(out) > 1 and out[-1][0] + out[-1][1] >= out[0][0] + 2 * math.pi - 1e-12:
        begun, width = out[-1]
        first, more = out.pop(0)
        out[-1] = begun, max(width, first + 2 * math.pi + more - begun)
    if len(out) == 1 and out[0][1] >= 2 * math.pi - 1e-9:
        return [(0.0, 2 * math.pi)]
    return out


class TestSight:
    def test_a_seam_hides_what_is_behind_it(self):
        wall = world(TestMotion.WALL)
        assert is_hidden_by_obstacles(wall, (0.0, -0.5, 0.0), (0.0, 2.0, 0.0))
        assert not is_hidden_by_obstacles(wall, (-0.5, -SKIN, 0.0), (1.0, 0.0, 0.0))


class TestMergeThroughObstacles:
    """Two robots on both sides of a thin wall."""

    THIN = Polygon(((-5, 0), (5, 0), (5, 0.02), (-5, 0.02)))

    def simulator(self, through, starts, **more):
        scenario = rv.Scenario(
            n_robots=2,
            obstacles=[self.THIN],
            start_positions=starts,
            local_frames="global",
            max_speed=1.0,
            time_step=TAU,
            allow_long_step=True,
            merge_through_obstacles=through,
            **more,
        )
        simulator = rv.Simulator(scenario, 1)
        simulator.reset(0)
        return simulator

    @pytest.mark.parametrize("through", [True, False])
    def test_decides_whether_they_merge_there(self, through):
        simulator = self.simulator(through, [[0.0, -0.3], [0.01, 0.3]])
        for _ in range(20):
            outcome = simulator.step([[[0.0, 0.3], [0.0, -0.3]]])
        assert bool(outcome.active.all()) == (not through)
        if not through:
            assert np.ptp(simulator.positions[0, :, 1]) == pytest.approx(0.02, abs=1e-12)

    def test_false_lets_them_merge_beside_it(self):
        simulator = self.simulator(False, [[4.95, -0.05], [4.95, 0.07]])
        assert simulator.step([[[0.0, 0.0], [0.0, 0.0]]]).active.all()
        outcome = simulator.step([[[1.0, 0.0], [1.0, 0.0]]])
        outcome = simulator.step([[[1.0, 0.0], [1.0, 0.0]]])
        assert outcome.active.sum() == 1

    def test_has_no_effect_without_walls(self):
        assert rv.Scenario(merge_through_obstacles=False).merges_through
        ignored = self.simulator(False, [[0.0, -0.2], [0.0, 0.2]], obstacle_contact="ignore")
        for _ in range(4):
            outcome = ignored.step([[[0.0, 1.0], [0.0, -1.0]]])
        assert outcome.active.sum() == 1

    def test_the_field_is_plain_data_only_if_it_is_false(self):
        assert "merge_through_obstacles" not in rv.Scenario().to_plain()
        changed = rv.Scenario(merge_through_obstacles=False)
        assert rv.Scenario.from_plain(changed.to_plain()) == changed

    def test_bodies_need_it(self):
        with pytest.raises(ValueError, match="merge_through_obstacles is False; it must be True"):
            rv.Scenario(
                n_robots=2, obstacles=[self.THIN], body_radius=0.05, merge_through_obstacles=False
            )

    @pytest.mark.parametrize(("by", "margin"), [("law", 1.0), ("heading", 0.2), ("tank", 0.2)])
    def test_false_withdraws_the_bounds_on_v(self, by, margin):
        scenario = rv.Scenario(n_robots=3, obstacles=[Disc((9, 9), 1.0)])
        assert math.isfinite(rv.certificate(scenario, margin, by=by).lyapunov_bound)
        apart = scenario.replace(merge_through_obstacles=False)
        found = rv.certificate(apart, margin, by=by)
        assert not found.promises and "V still" not in found.theorem
        passed = apart.replace(obstacle_contact="ignore")
        assert rv.certificate(passed, margin, by=by).guaranteed
