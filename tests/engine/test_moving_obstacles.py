"""Obstacles that move: motion, exact contact, pushing and stopping, state, batches."""

import itertools
import math

import numpy as np
import pytest
import shapely
from parameters import marked, slow
from scipy.optimize import brentq

import rendezvous_env as rv
from rendezvous_env.obstacles.obstacle_set import pack, world_of
from rendezvous_env.traffic import contact

DISC = rv.Disc((0.0, 0.0), 0.5)
TRIANGLE = rv.Polygon(((-0.6, -0.5), (0.6, -0.5), (0.0, 0.7)))
BAR = rv.Capsule(((-0.4, 0.0), (0.4, 0.2)), 0.25)
SHAPES = {"disc": DISC, "triangle": TRIANGLE, "bar": BAR}
FAR = (1e3, 1e3)


def scenario(obstacles, places=((3.0, 0.0), FAR), **fields) -> rv.Scenario:
    given = {"local_frames": "global", "time_step": 0.05, "max_speed": 1.0, "time_limit": 1e4}
    return rv.Scenario(
        n_robots=len(places),
        obstacles=obstacles,
        start_positions=places,
        allow_long_step=True,
        **{**given, **fields},
    )


def resting(scene: rv.Scenario, steps: int, batch: int = 1) -> rv.Simulator:
    sim = rv.Simulator(scene, batch)
    sim.reset(0)
    for _ in range(steps):
        sim.step(np.zeros((batch, scene.n_robots, scene.action_size)))
    return sim


class Reference:
    """Independent integrator of one robot beside one moving obstacle in the plane.

    Distances are those of shapely, contacts are found by samples and bisection.
    """

    def __init__(self, shape) -> None:
        if isinstance(shape, rv.Disc):
            self.core, self.radius = shapely.Point(shape.centre), shape.radius
        elif isinstance(shape, rv.Polygon):
            self.core, self.radius = shapely.Polygon(shape.vertices), 0.0
        else:
            self.core, self.radius = shapely.LineString(shape.ends), shape.radius
        self.offset = np.zeros(2)

    def distance(self, point) -> float:
        at = shapely.Point(point - self.offset)
        if self.radius == 0.0 and self.core.contains(at):
            return -self.core.exterior.distance(at)
        return self.core.distance(at) - self.radius

    def normal(self, point) -> np.ndarray:
        """Outward normal at a touching point."""
        here = point - self.offset
        if self.radius > 0.0:
            nearest = shapely.shortest_line(self.core, shapely.Point(here)).coords[0]
            off = here - np.array(nearest)
            return off / np.linalg.norm(off)
        corners = np.array(self.core.exterior.coords)
        best = None
        for a, b in itertools.pairwise(corners):
            out = np.array([b[1] - a[1], a[0] - b[0]])
            out /= np.linalg.norm(out)
            off = abs(out @ (here - a))
            best = min(best or (off, 0), (off, tuple(out)), key=lambda one: one[0])
        return np.array(best[1])

    def step(self, point, velocity, course, tau, samples=150) -> np.ndarray:
        start = self.offset.copy()

        def gap(t):
            self.offset = start + course * t
            found = self.distance(point + velocity * t)
            self.offset = start
            return found

        relative = velocity - course
        if gap(0.0) > 1.001 * np.linalg.norm(relative) * tau:
            self.offset = start + course * tau
            return point + velocity * tau
        times = np.linspace(0.0, tau, samples)
        gaps = np.array([gap(t) for t in times])
        touching = abs(gaps[0]) < 1e-10 and self.normal(point) @ relative < 0.0
        inside = np.flatnonzero(gaps < -1e-12)
        if touching:
            contact = 0.0
        elif len(inside):
            k = int(inside[0])
            contact = brentq(gap, times[k - 1], times[k], xtol=1e-15) if k else 0.0
        else:
            self.offset = start + course * tau
            return point + velocity * tau
        here = point + velocity * contact
        self.offset = start + course * contact
        normal = self.normal(here)
        pushed = velocity + max(0.0, normal @ (course - velocity)) * normal
        self.offset = start + course * tau
        return here + pushed * (tau - contact)


@pytest.mark.parametrize("name", marked(SHAPES, slow=["triangle", "bar"]))
@pytest.mark.parametrize("seed", range(4))
def test_contact_equals_an_independent_integrator(name, seed):
    random = np.random.default_rng(seed)
    course = random.uniform(0.5, 3.0) * np.array([1.0, 0.1 * random.uniform(-1, 1)])
    place = 2.0 * course / np.linalg.norm(course) + [0.0, random.uniform(-0.1, 0.1)]
    scene = scenario([rv.Moving(SHAPES[name], velocity=course)], (tuple(place), FAR))
    sim, reference, point = rv.Simulator(scene), Reference(SHAPES[name]), place.copy()
    sim.reset(0)
    angle, touched = random.uniform(0, 2 * math.pi), 0
    for k in range(80):
        angle += random.uniform(-0.3, 0.3)
        velocity = random.uniform(0.0, 0.4) * np.array([math.cos(angle), math.sin(angle)])
        velocity = np.float64(np.float32(velocity))
        actions = np.zeros((1, 2, 2))
        actions[0, 0] = velocity
        before = reference.offset.copy()
        touched += int(sim.step(actions).contact[0, 0])
        moved = reference.step(point, velocity, course, scene.tau)
        np.testing.assert_allclose(reference.offset, before + course * scene.tau, atol=1e-12)
        # rounded corners are passed by arcs in several pieces; a step on them is compared anew
        error = np.abs(sim.positions[0, 0] - moved).max()
        assert error < 1e-9, (k, error)
        point = sim.positions[0, 0].copy()
        assert reference.distance(point) > -1e-9
    assert touched > 0


@pytest.mark.parametrize("name", marked(SHAPES, slow=["triangle", "bar"]))
@pytest.mark.parametrize("speed", [0.5, 40.0, 1e6])
def test_push_lets_nothing_through_at_any_speed(name, speed):
    sim = resting(scenario([rv.Moving(SHAPES[name], velocity=(speed, 0.0))]), 200)
    centre = sim.obstacle_offsets[0, 0, 0]
    assert math.isclose(centre, speed * 0.05 * 200, rel_tol=1e-12)
    if name == "disc":
        np.testing.assert_allclose(sim.positions[0, 0], [centre + 0.5, 0.0], rtol=1e-12)
    assert sim.clearance[0, 0] > -1e-9 * max(1.0, speed)
    assert sim.positions[0, 0, 0] > centre or sim.positions[0, 0, 1] != 0.0


@pytest.mark.parametrize("speed", [0.5, 40.0, 1e6])
def test_stop_holds_obstacle_up_until_robot_leaves(speed):
    scene = scenario([rv.Moving(DISC, velocity=(speed, 0.0))], obstacle_push="stop")
    sim = resting(scene, 200)
    np.testing.assert_array_equal(sim.positions[0, 0], [3.0, 0.0])
    np.testing.assert_allclose(sim.obstacle_offsets[0, 0, 0], 2.5, atol=1e-6)
    for _ in range(40):
        sim.step([[[0.0, 1.0], [0.0, 0.0]]])
    assert sim.obstacle_offsets[0, 0, 0] > 2.5 + 0.4 * speed


@pytest.mark.slow
@pytest.mark.kernels
def test_squeezed_robot_stops_the_obstacle():
    wall = rv.Polygon(((4.0, -5.0), (5.0, -5.0), (5.0, 5.0), (4.0, 5.0)))
    for speed in (0.5, 1e4):
        sim = resting(scenario([rv.Moving(DISC, velocity=(speed, 0.0)), wall]), 300)
        np.testing.assert_allclose(sim.positions[0, 0], [4.0, 0.0], atol=1e-9)
        np.testing.assert_allclose(sim.obstacle_offsets[0, 0, 0], 3.5, atol=1e-6)


def test_obstacles_from_two_sides_stop_at_a_robot_in_between():
    pair = [
        rv.Moving(DISC, velocity=(1.0, 0.0)),
        rv.Moving(rv.Disc((6.0, 0.0), 0.5), velocity=(-2.0, 0.0)),
    ]
    sim = resting(scenario(pair), 200)
    left, right = sim.obstacle_offsets[0, :2, 0] + [0.5, 5.5]
    assert left <= sim.positions[0, 0, 0] + 1e-9 <= right + 2e-9
    assert right - left < 2e-6


@pytest.mark.slow
def test_pushing_in_3d_slides_along_floor_and_wall():
    floor = rv.Sphere((3.0, 0.0, -100.0), 100.0)
    ball = rv.Moving(rv.Sphere((0.0, 0.0, 0.2), 0.5), velocity=(1.0, 0.0, -0.01))
    scene = scenario([ball, floor], ((3.0, 0.05, 0.01), (1e3, 1e3, 1e3)), dim=3)
    sim = resting(scene, 120)
    assert sim.clearance[0, 0] > -1e-9
    assert sim.contacts[0] > 0


def test_waypoints_repeat_and_end():
    rows = ((0.0, 0.0, 0.0), (1.0, 2.0, 0.0), (3.0, 0.0, 0.0))
    there = {0.5: 1.0, 1.0: 2.0, 2.0: 1.0, 3.0: 0.0, 3.5: 1.0}
    scene = scenario([rv.Moving(DISC, waypoints=rows)], ((9.0, 9.0), FAR))
    sim = rv.Simulator(scene)
    sim.reset(0)
    for step in range(1, 71):
        sim.step(np.zeros((1, 2, 2)))
        if (moment := round(step * 0.05, 9)) in there:
            np.testing.assert_allclose(sim.obstacle_offsets[0, 0], [there[moment], 0.0], atol=1e-9)
    stays = scenario([rv.Moving(DISC, waypoints=rows[:2], repeat=False)], ((9.0, 9.0), FAR))
    np.testing.assert_allclose(resting(stays, 60).obstacle_offsets[0, 0], [2.0, 0.0])


@pytest.mark.parametrize("dim", [2, slow(3)])
def test_random_walk_stays_in_its_box_and_depends_on_the_seed(dim):
    shape = DISC if dim == 2 else rv.Sphere((0.0,) * 3, 0.5)
    box = ((-1.0,) * dim, (2.0,) * dim)
    walk = rv.Moving(shape, speed=1.5, box=box, interval=0.7)
    places = (*((9.0,) * dim, (1e3,) * dim),)
    scene = scenario([walk], places, dim=dim)
    sim = rv.Simulator(scene, 3)
    sim.reset([5, 5, 6])
    offsets = []
    for _ in range(400):
        sim.step(np.zeros((3, 2, dim)))
        offsets.append(sim.obstacle_offsets[:, 0])
    offsets = np.array(offsets)
    np.testing.assert_array_equal(offsets[:, 0], offsets[:, 1])
    assert np.abs(offsets[:, 0] - offsets[:, 2]).max() > 0.5
    assert offsets.min() >= -1.0 and offsets.max() <= 2.0
    assert np.ptp(offsets[:, 0], axis=0).min() > 1.5
    lengths = np.linalg.norm(np.diff(offsets[:, 0], axis=0), axis=-1)
    assert lengths.max() <= 1.5 * 0.05 * (1 + 1e-12) and np.median(lengths) > 0.0749


def crossing(model="single_integrator", dim=2, **fields) -> rv.Scenario:
    if dim == 2:
        obstacles = [
            rv.Moving(DISC, waypoints=((0, 0, 0), (2, 3, 0), (4, 0, 0))),
            rv.Moving(rv.Polygon(((-3, 2), (-2, 2), (-2, 3))), velocity=(0.2, -0.4)),
            rv.Moving(rv.Capsule(((0, -3), (1, -3)), 0.2), speed=2.0, box=((-4, -4), (4, 0))),
            rv.Disc((2.5, 2.0), 0.4),
        ]
    else:
        obstacles = [
            rv.Moving(rv.Sphere((0, 0, 0), 0.7), speed=2.0, box=((-3, -3, -3), (3, 3, 3))),
            rv.Moving(rv.Capsule(((1, 1, 1), (2, 1, 1)), 0.3), velocity=(-0.5, 0.1, 0.0)),
        ]
    return rv.Scenario(
        n_robots=5, robot_model=model, dim=dim, obstacles=obstacles, spawn_size=7.0, **fields
    )


def played(scene: rv.Scenario, batch: int, steps: int = 60):
    sim = rv.Simulator(scene, batch)
    sim.reset(3)
    random, found = np.random.default_rng(0), []
    for _ in range(steps):
        one = random.uniform(-1.0, 1.0, (scene.n_robots, scene.action_size))
        outcome = sim.step(np.repeat(one[None], batch, axis=0))
        state = {name: array[0].copy() for name, array in sim.get_state().items()}
        found.append(state | {"rows": outcome.observations[0].copy()})
    return found


@pytest.mark.parametrize("push", ["push", "stop"])
@pytest.mark.parametrize(
    ("model", "dim"),
    [
        pytest.param("single_integrator", 2, marks=pytest.mark.kernels),
        slow("unicycle", 2),
        slow("nonholonomic_3d", 3),
    ],
)
def test_batch_equals_singles_with_moving_obstacles(model, dim, push):
    scene = crossing(model, dim, obstacle_push=push)
    for one, other in zip(played(scene, 1), played(scene, 7), strict=True):
        for name, value in one.items():
            np.testing.assert_array_equal(value, other[name], err_msg=name)


def test_no_robot_is_ever_inside_an_obstacle():
    for mode in ("slide", "stop"):
        for push in ("push", "stop"):
            scene = crossing(obstacle_contact=mode, obstacle_push=push)
            sim = rv.Simulator(scene, 40)
            sim.reset(0)
            random = np.random.default_rng(1)
            for _ in range(150):
                sim.step(random.uniform(-1.0, 1.0, (40, 5, 2)))
                assert sim.clearance.min() > -1e-9
            assert sim.contacts.sum() > 100


def test_state_with_moving_obstacles_is_restored_bitwise():
    scene = crossing()
    sim = rv.Simulator(scene, 6)
    sim.reset(1)
    random = np.random.default_rng(2)
    actions = random.uniform(-1.0, 1.0, (60, 6, 5, 2))
    for one in actions[:30]:
        sim.step(one)
    kept = sim.get_state()
    ends = []
    for _ in range(2):
        for one in actions[30:]:
            seen = sim.step(one).observations
        ends.append((seen, sim.get_state()))
        sim.set_state(kept)
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    for name, value in ends[0][1].items():
        np.testing.assert_array_equal(value, ends[1][1][name])


def test_state_with_obstacles_elsewhere_is_refused():
    sim = resting(crossing(), 10, 2)
    state = sim.get_state()
    state["obstacles"][1, 0, 3] += 0.5
    with pytest.raises(ValueError, match=r"obstacles.*displaced by the first numbers of traffic"):
        sim.set_state(state)


def test_reset_returns_obstacles_to_their_places():
    scene = crossing()
    sim = rv.Simulator(scene, 2)
    sim.reset(1)
    first = sim.obstacles
    for _ in range(20):
        sim.step(np.zeros((2, 5, 2)))
    assert (sim.obstacles != first).any()
    sim.reset(mask=np.array([True, False]))
    np.testing.assert_array_equal(sim.obstacles[0], first[0])
    assert (sim.obstacles[1] != first[1]).any()


def test_ignored_obstacles_pass_through_robots():
    scene = scenario([rv.Moving(DISC, velocity=(1.0, 0.0))], obstacle_contact="ignore")
    sim = resting(scene, 120)
    np.testing.assert_array_equal(sim.positions[0, 0], [3.0, 0.0])
    assert sim.min_clearance[0] < -0.4


@pytest.mark.kernels
def test_merge_beside_a_fast_obstacle_stays_outside():
    """Robots merge early in a step in which an obstacle passes their place."""
    bar = rv.Polygon(((-1.0, -2.0), (-0.9, -2.0), (-0.9, 2.0), (-1.0, 2.0)))
    scene = scenario(
        [rv.Moving(bar, velocity=(60.0, 0.0))], ((0.0, 0.13), (0.0, -0.13)), max_speed=4.0
    )
    sim = rv.Simulator(scene)
    sim.reset(0)
    sim.step([[[0.0, -4.0], [0.0, 4.0]]])
    assert sim.active[0].sum() == 1
    assert sim.positions[0, 0, 0] == pytest.approx(-0.9 + 60.0 * 0.05)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "Moving has no motion; give exactly one of velocity, waypoints or speed"),
        ({"velocity": (1, 0), "speed": 1.0}, "Moving has velocity and speed; give exactly one of"),
        ({"velocity": (1, 0, 0)}, "Moving.velocity is .* 2 numbers"),
        ({"waypoints": ((0, 0, 0),)}, "Moving.waypoints is .* two or more rows"),
        ({"waypoints": ((0, 1, 0), (1, 0, 0))}, r"Moving.waypoints\[0\] is .* zeros"),
        ({"waypoints": ((0, 0, 0), (0, 1, 0))}, r"Moving.waypoints\[1\]\[0\] is 0; .* later"),
        ({"waypoints": ((0, 0, 0), (1, 1, 0))}, "displacement of zero, as the first, or pass"),
        ({"speed": 1.0}, "Moving.box is None; .* two corners"),
        ({"speed": 1.0, "box": ((1, 1), (2, 2))}, "Moving.box is .* around the centre"),
        ({"speed": -1.0, "box": ((-1, -1), (2, 2))}, "Moving.speed is -1.0; .* positive"),
        ({"velocity": (1, 0), "box": ((-1, -1), (2, 2))}, "Moving.box is .* omitted"),
    ],
)
def test_moving_refuses_wrong_fields(fields, message):
    with pytest.raises(ValueError, match=message):
        rv.Moving(DISC, **fields)


def test_moving_survives_files(tmp_path):
    scene = crossing(obstacle_push="stop").replace(name="crossing")
    scene.to_toml(tmp_path / "crossing.toml")
    assert rv.Scenario.from_toml(tmp_path / "crossing.toml") == scene
    assert "obstacle_push" not in crossing().to_plain()


def test_options_replace_no_moving_obstacles():
    with pytest.raises(ValueError, match="those given to a reset do not move"):
        rv.Simulator(crossing()).reset(0, {"obstacles": [DISC]})


X, Y, Z = np.eye(3)


@pytest.mark.kernels
@pytest.mark.parametrize(
    ("wish", "rows", "velocity"),
    [
        ((1.0, 2.0, 0.0), [(X, 0.5)], (1.0, 2.0, 0.0)),  # faster than the obstacle
        ((0.0, 2.0, 0.0), [(X, 0.5)], (0.5, 2.0, 0.0)),  # pushed, and slides
        ((-1.0, -1.0, 0.0), [(X, 0.5), (Y, 0.0)], (0.5, 0.0, 0.0)),  # pushed along a wall
        ((0.0, 0.0, 0.0), [(X, 0.5), (-X, 0.0)], None),  # between an obstacle and a wall
        ((0.0, 0.0, 0.0), [(X, 0.5), (-X, -0.7)], (0.5, 0.0, 0.0)),  # the other leaves faster
        ((-1.0, -1.0, -1.0), [(X, 0.1), (Y, 0.2), (Z, 0.3)], (0.1, 0.2, 0.3)),  # a corner
    ],
)
def test_nearest_allowed_velocity_by_hand(wish, rows, velocity):
    held = np.array([normal for normal, _ in rows for _ in range(2)])
    levels = np.array([level for _, level in rows for _ in range(2)])
    dim = 3 if len(rows) == 3 else 2
    possible, found = contact.nearest_allowed(wish, held, levels, len(held), dim)
    assert possible == (velocity is not None)
    if possible:
        np.testing.assert_allclose(found, velocity, atol=1e-12)


@pytest.mark.kernels
def test_halt_all_marks_obstacles_that_still_move():
    world = world_of(pack([DISC, DISC, DISC], 3))
    plans = np.array([[1.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.4], [0.0, 0.0, 0.0, 1.0]])
    halts = np.zeros(3, np.bool_)
    contact._halt_all((0.0, 0.0, 0.0), 0.5, world, plans, halts)
    assert halts.tolist() == [True, False, False]
