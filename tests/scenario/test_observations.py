"""Observation rows, by hand, and their layout."""

import math

import numpy as np
import pytest
from conftest import UNEQUAL, five, started

from rendezvous_env import Disc, ObservationLayout, Scenario, Simulator, Sphere

START = np.array([[0.0, 0.0], [3.0, 4.0], [-1.0, 2.0], [5.0, -2.0], [-4.0, -3.0]])


def test_rows_match_hand_computation_in_index_order():
    sim = Simulator(five("single_integrator-2d", local_frames="global"))
    seen = sim.reset(0, {"positions": START})[0]
    assert seen.dtype == np.float32 and seen.shape == (5, 4, 2)
    for i in range(5):
        others = [j for j in range(5) if j != i]
        for row, j in zip(seen[i], others, strict=True):
            way = (START[j] - START[i]) / math.dist(START[j], START[i])
            np.testing.assert_allclose(row, UNEQUAL[i, j] * way, atol=1e-7)
    assert not seen[0, 1].any()  # no edge between 0 and 2
    np.testing.assert_allclose(seen[0, 0], [1.2, 1.6], rtol=1e-6)  # 2 · (3, 4)/5


def test_frame_rotates_rows():
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])  # local x axis along global y
    ahead = np.array([math.atan2(4, 3), 0.0, 1.0, 2.0, 3.0])
    for kind, given, rows in (
        ("single_integrator-2d", {"frames": np.tile(turn, (5, 1, 1))}, {0: [1.6, -1.2]}),
        ("unicycle", {"headings": ahead}, {0: [2.0, 0.0], 1: [-1.2, -1.6]}),
    ):
        seen = Simulator(five(kind)).reset(0, {"positions": START, **given})[0]
        for robot, row in rows.items():
            np.testing.assert_allclose(seen[robot, 0], row, atol=1e-6)


def test_gravity_row_matches_attitude():
    scenario = five("nonholonomic_3d")
    pitch = np.array([0.0, 0.3, -0.7, 1.2, -1.5])
    headings = np.stack([np.linspace(-2, 2, 5), pitch], axis=1)
    sim = Simulator(scenario)
    seen = sim.reset(0, {"positions": np.pad(START, ((0, 0), (0, 1))), "headings": headings})[0]
    layout = scenario.observation_layout
    assert layout.gravity == slice(4, 5) and layout.rows == 5
    expected = np.stack([-np.sin(pitch), 0 * pitch, -np.cos(pitch)], axis=1)
    np.testing.assert_allclose(seen[:, 4], expected, atol=1e-7)
    np.testing.assert_allclose(layout.split(seen).gravity, expected, atol=1e-7)


def test_merged_robots_are_invisible_and_see_nothing(kind):
    scenario = five(kind)
    start = np.pad(START, ((0, 0), (0, scenario.dim - 2)))
    start[1] = start[0] + 0.05  # 0 and 1 are neighbours and merge at once
    sim = started(scenario, positions=start)
    seen = sim.step(np.zeros((1, 5, scenario.action_size))).observations[0]
    assert sim.active[0].tolist() == [True, False, True, True, True]
    assert not seen[1].any()  # gravity included
    assert not seen[0, 0].any() and not seen[[2, 3, 4], 1].any()
    # robot 2 had an edge to 1 of weight 1.3 and now has it to 0, whose row it sees instead
    assert np.linalg.norm(seen[2, 0]) == pytest.approx(1.3, rel=1e-6)
    assert np.linalg.norm(seen[0, 1]) == pytest.approx(1.3, rel=1e-6)


@pytest.mark.parametrize(("graph", "slots"), [(UNEQUAL, 3), ("path", 2), ("path", 3)])
def test_few_rows_hold_neighbours_in_order(graph, slots):
    """Rows of complete observations without the empty ones, then zeros."""
    few = five("single_integrator-2d", graph=graph, neighbour_slots=slots, local_frames="global")
    wide = few.replace(neighbour_slots=4)
    seen, by_index = (Simulator(s).reset(0, {"positions": START})[0] for s in (few, wide))
    for robot in range(5):
        rows = by_index[robot][by_index[robot].any(axis=-1)]
        np.testing.assert_array_equal(seen[robot, : len(rows)], rows)
        assert len(rows) >= 1 and not seen[robot, len(rows) :].any()


def test_obstacles_are_visible_within_range():
    world = [Disc((0.0, 9.0), 1.0), Disc((0.0, 2.0), 1.0)]
    scenario = Scenario(n_robots=2, obstacles=world, local_frames="global", obstacle_range=2.0)
    seen = started(scenario, positions=[[0.0, 0.0], [30.0, 0.0]]).observe()[0]
    points = scenario.observation_layout.split(seen).obstacles
    assert points.shape == (2, 2, 2, 2)
    assert not points[0, 0].any() and not points[1].any()
    up = math.sqrt(0.75)  # half angle asin(1/2) = 30°
    np.testing.assert_allclose(points[0, 1], [[-0.5, up], [0.5, up]], atol=1e-6)


def test_zero_rows_have_positive_zeros(kind):
    scenario = five(kind)
    if not scenario.model.nonholonomic:  # bodies among discs are kinds that no other test needs
        scenario = scenario.replace(obstacle_slots=1)
    sim = started(scenario, 30)
    for _ in range(40):
        seen = sim.step(np.zeros((30, 5, scenario.action_size))).observations
    neighbours = seen[..., scenario.observation_layout.neighbours, :]
    assert not np.signbit(neighbours[neighbours == 0]).any()


@pytest.mark.parametrize(
    ("layout", "neighbours", "obstacles", "gravity", "shape"),
    [
        (ObservationLayout(2, 4), (0, 4), (4, 4), (4, 4), (4, 2)),
        (ObservationLayout(2, 4, 3), (0, 4), (4, 10), (10, 10), (10, 2)),
        (ObservationLayout(3, 2, 2), (0, 2), (2, 18), (18, 18), (18, 3)),
        (ObservationLayout(3, 2, 1, True), (0, 2), (2, 10), (10, 11), (11, 3)),
    ],
)
def test_layouts_match_hand_computation(layout, neighbours, obstacles, gravity, shape):
    assert layout.neighbours == slice(*neighbours)
    assert layout.obstacles == slice(*obstacles)
    assert layout.gravity == slice(*gravity)
    assert layout.shape == shape


def test_split_returns_views_and_checks_shape():
    layout = ObservationLayout(3, 2, 1, True)
    table = np.arange(2 * 11 * 3.0).reshape(2, 11, 3)
    split = layout.split(table)
    assert split.neighbours.shape == (2, 2, 3) and split.obstacles.shape == (2, 1, 8, 3)
    np.testing.assert_array_equal(split.gravity, table[:, 10])
    assert split.velocity is None
    assert all(np.shares_memory(part, table) for part in split if part is not None)
    np.testing.assert_array_equal(layout.net_bearing(table), table[:, 0] + table[:, 1])
    assert ObservationLayout(2, 4).split(np.zeros((4, 2))).gravity is None
    flat = table.reshape(2, -1)
    for part, other in zip(layout.split(flat)[:3], split[:3], strict=True):
        np.testing.assert_array_equal(part, other)
    for given in (flat, table):
        np.testing.assert_array_equal(layout.unflattened(given), table)
    one_row = np.ones((5, 1, 2))  # a table, though its rows are as long as a flat one
    assert ObservationLayout(2, 1).unflattened(one_row) is one_row
    for call, given, said in (
        (layout.split, table[:, :10], r"shape \(2, 10, 3\); this layout needs \(\.\.\., 11, 3\)"),
        (layout.split, flat[:, 1:], "this layout needs"),
        (layout.net_bearing, flat, "``unflattened`` converts flat ones"),
    ):
        with pytest.raises(ValueError, match=said):
            call(given)


def test_scenario_has_layout():
    scenario = Scenario(n_robots=3, dim=3, obstacles=[Sphere((9.0, 0, 0), 1.0)], obstacle_slots=2)
    assert scenario.observation_layout == ObservationLayout(3, 2, 2, False)
    assert five("nonholonomic_3d").observation_layout == ObservationLayout(3, 4, 0, True)
    path = five("single_integrator-2d", graph="path")  # nobody on it has more than two neighbours
    assert path.observation_layout == ObservationLayout(2, 2)
