"""Images compared with data: colours at the positions of robots and obstacles."""

import numpy as np
import pytest
from conftest import five
from drawing import at, drawn, near, still

import baselines
import rendezvous_env as rv
from rendezvous_env.obstacles.obstacle_set import outlines, pack
from rendezvous_env.render.camera import PixelArea, fit, nice_step
from rendezvous_env.render.palette import OBSTACLE, ROBOTS, robot_colour
from rendezvous_env.render.scene import ended, in_contact, outermost, sights, ways
from train.figures import path_figures, reproduce

STRIP = 600 - 118
"""First row of pixels of the strip of V(t)."""


def test_robot_has_its_colour_at_its_position(kind):
    env, _ = drawn(five(kind))
    law = {name: np.full(env.action_space(name).shape, 0.4, np.float32) for name in env.agents}
    for _ in range(5):
        env.step(law)
    frame = env.render()
    assert frame.shape == (600, 600, 3) and frame.dtype == np.uint8
    places = env.renderer.pixels(env.simulator.positions[0])
    assert (places >= 0).all() and (places[:, 0] < 600).all() and (places[:, 1] < STRIP).all()
    assert [at(frame, place) for place in places] == [list(c) for c in ROBOTS[:5]]


def test_obstacles_are_orange_at_their_position():
    env, frame = drawn("fig4")
    disc, _, polygon = env.scenario.obstacles
    for inside in (disc.centre, polygon.centroid):
        assert at(frame, env.renderer.pixels(np.array(inside))) == list(OBSTACLE)
    for angle in np.linspace(0.0, 6.0, 12):
        for reach in (-0.06, 0.06):
            along = (disc.radius + reach) * np.array([np.cos(angle), np.sin(angle)])
            place = env.renderer.pixels(np.array(disc.centre) + along)
            assert near(frame, place, OBSTACLE, 0) == (reach < 0)


def test_sphere_is_orange_and_hides_background():
    positions = np.array([[2.0, 0.0, 0.0], [-2.0, 0.0, 0.0], [0.0, 0.0, 2.5]])
    scenario = rv.Scenario(n_robots=3, dim=3, obstacles=(rv.Sphere((0.0, 0.0, 0.0), 1.0),))
    camera = fit(positions, pack(scenario.obstacles, 1), PixelArea(0, 0, 600, 450), 18)
    behind, before = -1.5 * camera.back, 1.5 * camera.back
    points = np.array([behind, before, positions[2]])
    hidden = camera.hidden(points, pack(scenario.obstacles, 1))
    assert hidden.tolist() == [True, False, False]
    env, frame = drawn(scenario, options={"positions": np.array([behind, before, [0, 0, 2.5]])})
    places = env.renderer.pixels(env.simulator.positions[0])
    assert at(frame, places[1]) == list(ROBOTS[1])
    assert np.abs(np.subtract(at(frame, places[0]), ROBOTS[0])).max() > 60
    right = env.renderer.pixels(0.8 * camera.right)
    assert near(frame, right, (233, 171, 31), 3) > 40  # orange through which white shines


def test_axes_have_equal_scale():
    env, _ = drawn("fig3")
    origin, x, y = env.renderer.pixels(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    assert x - origin == pytest.approx([(x - origin)[0], 0.0], abs=1e-9)
    assert y - origin == pytest.approx([0.0, -(x - origin)[0]], abs=1e-9)


def test_scene_3d_has_perspective():
    camera = fit(np.eye(3) * 4, np.zeros((0, 5)), PixelArea(0, 0, 600, 400), 20)
    near, far = (camera.nearness(camera.centre + sign * camera.back) for sign in (1, -1))
    assert near > 1 > far
    up = camera.directions(camera.centre, np.array([0.0, 0.0, 1.0]))
    assert up[0] == pytest.approx(0.0, abs=1e-9) and -1 < up[1] < -0.8
    assert camera.directions(camera.centre, camera.back) == pytest.approx([0, 0], abs=1e-9)


def test_path_is_drawn_and_view_is_fixed():
    env, before = drawn("fig3", local_frames="global")
    fixed = np.array([[-1.0, 2.0], [3.0, 0.5]])
    view, start = env.renderer.pixels(fixed), env.simulator.positions[0].copy()
    for _ in range(20):
        env.step(still(env) | {"robot_0": np.array([1.0, 0.0], np.float32)})
    after = env.render()
    assert np.array_equal(env.renderer.pixels(fixed), view)
    assert at(before, env.renderer.pixels(start[0])) == list(ROBOTS[0])
    assert near(after, env.renderer.pixels(start[0]), ROBOTS[0], 1) == 0
    moved = env.simulator.positions[0, 0]
    assert np.linalg.norm(moved - start[0]) > 0.5
    path = at(after, env.renderer.pixels((start[0] + moved) / 2))
    assert path[2] > path[0] + 40  # a bluish line half way
    assert at(after, env.renderer.pixels(start[1])) == list(ROBOTS[1])


def test_headings_and_bearings_are_drawn():
    options = {"positions": [[0.0, 0.0], [4.0, 0.0]], "headings": [np.pi / 2, 0.0]}
    env, frame = drawn(rv.Scenario(n_robots=2, robot_model="unicycle"), options=options)
    place = env.renderer.pixels(np.zeros(2))
    up, right = np.array([0, -10]), np.array([18, 0])
    nose = np.array(at(frame, place + up))
    assert nose.max() < 160 and at(frame, place - up) != nose.tolist()
    assert near(frame, place + right, ROBOTS[0], 3) > 3  # its bearing points to the other
    assert near(frame, place - right, ROBOTS[0], 3) == 0


def test_links_are_drawn():
    options = {"positions": [[-3.1, 0.0], [0.0, 4.1], [3.1, 0.0]]}
    env, frame = drawn(rv.Scenario(n_robots=3, graph="path"), options=options)
    places = env.renderer.pixels(env.simulator.positions[0])
    assert near(frame, places[:2].mean(axis=0), (205, 205, 205), 1) > 0
    assert near(frame, places[::2].mean(axis=0), (205, 205, 205), 1) == 0


def test_merge_has_cross_and_count():
    options = {"positions": [[0.0, 0.0], [0.3, 0.0], [4.0, 4.0]]}
    env, _ = drawn(rv.Scenario(n_robots=3, local_frames="global"), options=options)
    while env.simulator.active.all():
        env.step(still(env) | {"robot_1": np.array([-1.0, 0.0], np.float32)})
    merged_at = env.simulator.positions[0, 0].copy()
    for _ in range(60):
        env.step(still(env) | {"robot_0": np.array([0.0, 1.0], np.float32)})
    frame = env.render()
    assert near(frame, env.renderer.pixels(merged_at), (0, 0, 0), 5) > 4
    survivor = env.renderer.pixels(env.simulator.positions[0, 0])
    assert near(frame, survivor, (255, 255, 255), 3) > 3  # the 2
    assert near(frame, survivor, ROBOTS[0], 6) > 40


def test_contact_is_ringed_and_marked():
    scenario = rv.Scenario(
        n_robots=2, obstacles=(rv.Disc((0.0, 0.0), 1.0),), local_frames="global", max_speed=1.0
    )
    env, _ = drawn(scenario, options={"positions": [[-1.5, 0.0], [3.0, 3.0]]})
    ahead = np.array([1.0, 0.0], np.float32)
    while env.simulator.contacts[0] == 0:
        env.step(still(env) | {"robot_0": ahead})
    touching = env.renderer.pixels(env.simulator.positions[0, 0])
    assert near(env.render(), touching, (0, 0, 0), 11) > 20
    for _ in range(6):
        env.step(still(env) | {"robot_0": -ahead})
    frame = env.render()
    assert near(frame, touching, (0, 0, 0), 6) > 8
    assert near(frame, env.renderer.pixels(env.simulator.positions[0, 0]), (0, 0, 0), 11) == 0


def test_strip_shows_decreasing_v():
    env = rv.parallel_env("duo", render_mode="rgb_array")
    policy = baselines.make("bearing-only", env.scenario)
    observations, _ = env.reset(seed=0)
    heights = []
    for _ in range(2):
        for _ in range(12):
            actions = {name: policy(observations[name], 0.0) for name in env.agents}
            observations, *_ = env.step(actions)
        rows, columns = np.nonzero((env.render()[STRIP:] == ROBOTS[0]).all(axis=-1))
        heights.append((columns.max(), rows[columns > columns.max() - 4].mean()))
    assert heights[1][0] > heights[0][0] and heights[1][1] > heights[0][1]


def test_robot_colours_cycle():
    assert robot_colour(7) == robot_colour(0) == ROBOTS[0]
    assert len(set(ROBOTS)) == len(ROBOTS) and OBSTACLE not in ROBOTS


def test_grid_steps_are_round():
    assert [nice_step(span, 8) for span in (1.0, 9.0, 16.0, 20.0, 39.0)] == [0.2, 2, 2, 5, 5]


LOG = rv.Scenario(
    n_robots=2, obstacles=(rv.Capsule(((-2.0, -1.0), (2.0, 1.0)), 0.5),), time_limit=20.0
)
BESIDE = {"positions": [[0.0, 3.0], [0.5, -3.0]]}


def test_capsule_is_drawn():
    _, frame = drawn(LOG, options=BESIDE)
    rows, columns = np.nonzero(np.abs(frame.astype(int) - OBSTACLE).max(axis=-1) < 40)
    # metres per pixel from the height of the shape, which is 3 m; its area is 4.472 · 1 + π/4
    scale = 3.0 / (np.ptp(rows) + 1)
    assert len(rows) * scale**2 == pytest.approx(2 * np.hypot(2, 1) + np.pi / 4, rel=0.05)
    assert (np.ptp(columns) + 1) * scale == pytest.approx(5.0, rel=0.05)


@pytest.mark.parametrize(("radius", "count"), [(0.001, 99), (0.5, 37)])
def test_capsule_in_3d_is_drawn_as_balls(radius, count):
    """The minimum number of balls for a very thin one."""
    beads = outlines(pack((rv.Capsule(((0.0, 0.0, 0.0), (9.0, 0.0, 0.0)), radius),), 1), 3)
    assert len(beads) == count and beads[-1].centre.tolist() == [9.0, 0.0, 0.0]
    assert {bead.radius for bead in beads} == {radius}


def test_figure_shows_capsule():
    found = rv.rollout(LOG, baselines.make("tangent-merged", LOG), options=BESIDE)
    recording = reproduce.one_team(found)
    path_figures.team_figure(LOG, recording, "tangent-merged").canvas.draw()
    (part,) = outlines(recording["obstacles"], 2)
    assert len(part.vertices) == 34 and part.centre.tolist() == [0.0, 0.0]
    assert np.hypot(*part.vertices.T).max() == pytest.approx(np.hypot(2, 1) + 0.5)


def test_outermost_contains_scene():
    table = pack((rv.Disc((3.0, 0.0), 1.0), rv.Polygon(((0, 0), (0, 5), (-2, 0)))), 2)
    points = outermost(np.array([[0.0, -1.5]]), table)
    assert points.min(axis=0).tolist() == [-2.0, -1.5] and points.max(axis=0).tolist() == [4.0, 5.0]


def test_path_ends_at_merge():
    positions = np.arange(8.0).reshape(4, 2, 1)
    active = np.array([[1, 1], [1, 1], [1, 0], [1, 0]], dtype=bool)
    assert ended(active).tolist() == [[2, 1]]
    assert [way.ravel().tolist() for way in ways(positions, active)] == [[0, 2, 4, 6], [1, 3, 5]]


def test_contacts_text_counts_robot_steps():
    assert in_contact(1) == "1 robot-step in contact" and in_contact(0).startswith("0 robot-steps")


def grey_between(frame, one, other):
    """Points among 40 between two pixels that have the grey of links."""
    shares = np.linspace(0.15, 0.85, 40)[:, None]
    return [near(frame, place, (205, 205, 205), 1) > 0 for place in one + shares * (other - one)]


def test_only_robots_that_see_each_other_are_joined():
    options = {"positions": [[-3.1, 0.4], [0.0, 4.1], [3.1, 0.0]]}
    sighted = rv.Scenario(n_robots=3, sensing=rv.Sensing(range=5.5))
    env, frame = drawn(sighted, options=options)
    places = env.renderer.pixels(env.simulator.positions[0])
    assert np.mean(grey_between(frame, places[0], places[1])) > 0.9
    assert np.mean(grey_between(frame, places[0], places[2])) < 0.2


def test_half_a_line_starts_at_who_sees_another():
    options = {"positions": [[-3.1, 0.4], [0.0, 4.1], [3.1, 0.0]]}
    env, frame = drawn(rv.Scenario(n_robots=3, graph=rv.graphs.directed_cycle()), options=options)
    weights = env.simulator.weights[0]
    places = env.renderer.pixels(env.simulator.positions[0])
    for i, j in np.argwhere(weights > 0).tolist():
        found = grey_between(frame, places[i], places[j])
        assert np.mean(found[:18]) > 0.8 and np.mean(found[22:]) < 0.4


def test_sights_follow_rows_in_order_and_nearest_directions():
    random = np.random.default_rng(0)
    positions = random.normal(size=(5, 2))
    linked = random.random((5, 5)) < 0.7
    np.fill_diagonal(linked, False)
    offsets = positions[None] - positions[:, None]
    own, packed = np.zeros((5, 4, 2)), np.zeros((5, 4, 2))
    for i in range(5):
        others = [j for j in range(5) if linked[i, j]]
        for k, j in enumerate(others):
            own[i, j - (j > i)] = packed[i, k] = offsets[i, j] / np.linalg.norm(offsets[i, j])
    assert np.array_equal(sights(own, positions, linked, True), linked)
    assert np.array_equal(sights(packed, positions, linked, False), linked)
    packed[0] = 0.0
    assert not sights(packed, positions, linked, False)[0].any()


def test_fields_of_view_and_ranges_are_drawn():
    options = {"positions": [[0.0, 0.0], [4.0, 0.0]], "headings": [np.pi / 2, 0.0]}
    scenario = rv.Scenario(n_robots=2, robot_model="unicycle")
    (_, plain), (env, seen) = (
        drawn(scenario.replace(sensing=rv.Sensing(**fields)), options=options)
        for fields in ({}, {"range": 2.0, "field_of_view": np.pi / 2})
    )
    ahead, behind = env.renderer.pixels(np.array([[0.3, 1.3], [0.3, -1.3]]))
    tinted = np.array(at(seen, ahead))
    assert at(plain, ahead) == at(seen, behind) == [255, 255, 255]
    assert tinted[2] > tinted[0] + 10  # a little blue
    circle, whole = drawn(scenario.replace(sensing=rv.Sensing(range=2.0)), options=options)
    edge, inside = circle.renderer.pixels(np.array([[1.0, 1.0], [0.9, 0.9]]) * 2**0.5)
    assert near(whole, edge, (255, 255, 255), 1) < 9
    assert near(whole, inside, (255, 255, 255), 1) == 9


def test_numbers_stand_beside_robots():
    options = {"positions": [[0.0, 0.0], [4.0, 0.0], [2.0, 3.0]]}
    env, frame = drawn(rv.Scenario(n_robots=3), options=options)
    for i, place in enumerate(env.renderer.pixels(env.simulator.positions[0])):
        dark = tuple(round(0.6 * part) for part in ROBOTS[i])
        assert near(frame, place - np.array([9, 12]), dark, 5) > 4


def test_the_header_names_the_policy_and_the_legend_explains_marks():
    env, bare = drawn("fig4")
    env.renderer.policy = "tangent-merged"
    named = env.render()
    changed = np.argwhere((bare != named).any(axis=-1))
    assert len(changed) > 100 and changed[:, 0].max() < 30  # in the header alone
    legend = named[30:50]
    assert (legend == ROBOTS[0]).all(axis=-1).sum() > 20
    assert near(legend, (300, 10), (0x8A, 0x5F, 0x00), 300) > 10  # to an obstacle's edge
    _, free = drawn("duo")
    assert near(free[30:50], (300, 10), (0x8A, 0x5F, 0x00), 300) == 0


def test_a_long_name_leaves_room_for_the_marks():
    env, _ = drawn("fig4")
    env.renderer.policy = "learned:" + 20 * "a-long-path/"
    frame = env.render()
    short, _ = drawn("fig4")
    assert np.array_equal(frame[:30, 480:], short.render()[:30, 480:])
