"""Random walls and discs without enclosed robots."""

import numpy as np
import pytest
import shapely
from conftest import started
from parameters import needed

import rendezvous_env as rv
from rendezvous_env import ObstacleField, Scenario, WallField
from rendezvous_env.obstacles.obstacle_set import world_of
from rendezvous_env.obstacles.parsing import max_count, only_balls, parse, row_width, to_plain
from rendezvous_env.obstacles.reachability import all_reachable
from rendezvous_env.obstacles.shape import CENTRE, DETAILS, KIND, RADIUS

LAYOUTS = {"trap": 3, "corridor": 2, "rooms": 8}


def field(layout, **changes):
    given = {"size": (6, 8), "opening": (1, 2), "thickness": 0.5, "region": 2, "keep_out": 0.4}
    return WallField(layout, **{**given, **changes})


def drawn(name, count):
    simulator = started(rv.scenarios.get(name), count)
    return simulator.obstacles, simulator.positions


def solids(table, wider=0.0):
    """Shapely's obstacles of one team, (M,)."""
    return np.array(
        [
            shapely.Polygon(row[DETAILS : DETAILS + 8].reshape(4, 2))
            if row_width(()) < len(row)
            else shapely.Point(row[CENTRE : CENTRE + 2]).buffer(row[RADIUS] + wider, quad_segs=64)
            for row in table[table[:, KIND] >= 1]
        ]
    )


def together(table, positions, wider=0.0):
    """Whether all robots are in one component of the free space, by shapely."""
    walls = shapely.union_all(solids(table, wider))
    free = shapely.box(-99, -99, 99, 99).difference(walls)
    parts = shapely.get_parts(free)
    inside = shapely.contains_xy(parts[:, None], positions[:, 0], positions[:, 1])
    assert (inside.sum(axis=0) == 1).all()  # nobody starts in an obstacle
    return bool(inside.all(axis=1).any())


class TestField:
    @pytest.mark.parametrize(("layout", "boxes"), LAYOUTS.items())
    def test_wall_field_round_trips(self, layout, boxes):
        walls = field(layout)
        assert parse(to_plain(walls), 2) == walls == parse(walls, 2)
        assert (max_count(walls), row_width(walls), only_balls(walls)) == (boxes, 14, False)
        scenario = Scenario(obstacles=walls)
        assert scenario.observation_layout.obstacle_slots == boxes
        assert Scenario.from_plain(scenario.to_plain()) == scenario

    @pytest.mark.kernels
    def test_walls_avoid_given_positions(self):
        walls = field("rooms", region=10.0)
        starts = np.array([[0.0, 0.0], [3.0, 1.0], [-2.0, 4.0]])
        simulator = started(Scenario(n_robots=3, obstacles=walls), 200, positions=starts)
        assert (simulator.positions == starts).all()
        assert simulator.clearance.min() >= 0.4

    def test_impossible_walls_are_error(self):
        crowd = np.stack(np.meshgrid(*2 * [np.linspace(-9, 9, 10)]), axis=-1).reshape(-1, 2)
        walls = field("trap", keep_out=2.0)
        with pytest.raises(RuntimeError, match="no room for initial positions in environment 0"):
            started(Scenario(n_robots=100, obstacles=walls), positions=crowd)


class TestLayouts:
    """Measured in the frame of the first box, with its first edge along its length."""

    @pytest.mark.parametrize("layout", LAYOUTS)
    def test_boxes_have_given_size(self, layout):
        simulator = started(Scenario(n_robots=2, obstacles=field(layout)), 300)
        corners = simulator.obstacles[..., DETAILS:].reshape(300, -1, 4, 2)
        edges = np.roll(corners, -1, axis=2) - corners
        lengths = np.linalg.norm(edges, axis=-1)
        np.testing.assert_allclose(lengths[..., :2], lengths[..., 2:], atol=1e-12)
        np.testing.assert_allclose(lengths.min(axis=-1), 0.5, atol=1e-12)  # thickness
        turns = edges[..., 0] * np.roll(edges, -1, axis=2)[..., 1]
        turns -= edges[..., 1] * np.roll(edges, -1, axis=2)[..., 0]
        assert (turns > 0).all()  # counter-clockwise
        centres = simulator.obstacles[..., CENTRE : CENTRE + 2]
        np.testing.assert_allclose(corners.mean(axis=2), centres, atol=1e-12)
        reach = np.linalg.norm(corners - centres[:, :, None], axis=-1)
        np.testing.assert_allclose(reach, simulator.obstacles[..., [RADIUS]] + 0 * reach)

    def test_trap_is_u_shaped(self):
        table, _ = drawn("trap", 300)
        for rows in table:
            bottom, one, other = solids(rows)
            mouth = shapely.distance(one, other)
            assert 5.0 - 1e-9 <= mouth <= 8.0
            for arm in (one, other):
                assert 7.0 * 0.5 <= arm.area - bottom.intersection(arm).area <= 10.0 * 0.5 + 1e-9
            assert bottom.area == pytest.approx(0.5 * (mouth + 1.0))
            assert shapely.union_all([bottom, one, other]).geom_type == "Polygon"

    def test_corridor_has_given_width(self):
        table, _ = drawn("corridor", 300)
        widths = [shapely.distance(*solids(rows)) for rows in table]
        assert 2.0 - 1e-9 <= min(widths) < 2.1 and 3.9 < max(widths) <= 4.0
        lengths = [wall.area / 0.5 for rows in table for wall in solids(rows)]
        assert 16.0 - 1e-9 <= min(lengths) < 16.2 and 19.8 < max(lengths) <= 20.0 + 1e-9

    def test_rooms_have_four_doors(self):
        table, _ = drawn("rooms", 300)
        for rows in table:
            boxes = solids(rows)
            doors = [shapely.distance(boxes[2 * k], boxes[2 * k + 1]) for k in range(4)]
            assert 0.8 - 1e-9 <= min(doors) and max(doors) <= 1.2
            parts = shapely.get_parts(shapely.union_all(boxes))
            assert len(parts) == 5  # the cross in the middle, and a piece beyond each door
            for near, far, door in zip(boxes[::2], boxes[1::2], doors, strict=True):
                assert 10.0 <= (near.area + far.area) / 0.5 + door - 0.25 <= 14.0


class TestNobodyIsWalledIn:
    @pytest.mark.kernels
    @pytest.mark.parametrize("name", ["trap", needed("corridor"), needed("rooms")])
    def test_no_robot_is_enclosed_in_thousand_starts(self, name):
        tables, positions = drawn(name, 1000)
        assert all(map(together, tables, positions))

    @pytest.mark.slow
    def test_gaps_have_promised_width(self):
        """Discs enlarged by half a passage still enclose no robot."""
        tables, positions = drawn("clutter-32", 200)
        assert all(together(*start, wider=0.0999) for start in zip(tables, positions, strict=True))

    @pytest.mark.slow
    @pytest.mark.kernels
    def test_reachability_agrees_with_shapely(self):
        """Two nearly closed concentric rings of discs with a robot inside and two outside.

        Cases count only if slightly smaller and larger discs give the same answer.
        """
        random = np.random.default_rng(0)
        answers, chains = [], np.empty((34, 2), np.int64)
        for _ in range(200):
            around = 2 * np.pi * (np.arange(34) + random.uniform(-0.3, 0.3, 34))
            around /= np.repeat([12, 22], [12, 22])
            far = np.repeat([3.0, 6.0], [12, 22]) + random.uniform(-0.5, 0.5, 34)
            table = np.zeros((34, 6))
            table[:, KIND], table[:, RADIUS] = 1, random.uniform(0.95, 1.2, 34)
            table[:, CENTRE] = far * np.cos(around)
            table[:, CENTRE + 1] = far * np.sin(around)
            positions = np.array([[0.0, 0.0], [9.0, 1.0], [-8.0, 5.0]])
            found = all_reachable(world_of(table, only_balls=True), positions, 0.0, chains)
            one, other = (together(table, positions, wider) for wider in (-0.005, 0.005))
            if one == other:
                answers.append(found)
                assert found == one
        assert len(answers) > 180 and 0.2 < np.mean(answers) < 0.8

    def test_ring_of_discs_matches_hand_computation(self):
        around = 2 * np.pi * np.arange(8) / 8
        table = np.zeros((8, 6))
        table[:, KIND], table[:, RADIUS] = 1, 1.0
        table[:, CENTRE : CENTRE + 2] = 2.5 * np.stack([np.cos(around), np.sin(around)], axis=-1)
        chains = np.empty((8, 2), np.int64)  # neighbours are 1.913 m apart: they overlap
        split, out = np.array([[0.0, 0.0], [5.0, 5.0]]), np.array([[5.0, 5.0], [-5.0, 4.0]])
        ring = world_of(table, only_balls=True)
        assert not all_reachable(ring, split, 0.0, chains)
        assert all_reachable(ring, out, 0.0, chains)
        table[3, KIND] = 0  # a gap of 3.536 − 2 = 1.536 m
        gap = world_of(table, only_balls=True)
        assert all_reachable(gap, split, 1.53, chains)
        assert not all_reachable(gap, split, 1.54, chains)

    def test_hopeless_field_is_error(self):
        """One robot amid many discs, and one outside."""
        closed = ObstacleField(400, (0.8, 0.9), 12, 0.3, passage=0.6)
        with pytest.raises(RuntimeError, match="no room for initial positions"):
            started(Scenario(n_robots=2, obstacles=closed), positions=[[0.0, 0.0], [0.0, 20.0]])
