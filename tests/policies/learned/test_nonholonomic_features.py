"""Learned policies of nonholonomic and 3-D robots.

The tests cover frames and planes that do not turn with the body, and tanks on arcs.
"""

from dataclasses import replace

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines.learned import checkpoints, shipped
from baselines.learned.base_controller import BaseController, CommandedTank
from baselines.learned.policy_settings import PolicySettings
from baselines.steady_frames import OdometryFrame, OdometryPlane
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.safety.tank import certain_descent
from train.learn.settings import Config

CARS = rv.scenarios.get("clutter-12").replace(
    robot_model="unicycle", max_turn_rate=1.5, time_limit=10.0
)
POINTS = rv.scenarios.get("clutter-3d-32")
UAV = rv.scenarios.get("uav-clutter-16").replace(max_turn_rate=1.0)
HEADING = PolicySettings(
    8, (16,), clearance=0.2, persistence=0.5, min_alignment=0.1, max_turn_rate=1.2,
    decision_time=4 * CARS.tau,
)  # fmt: skip
TANK = replace(HEADING, guarantee="tank", budget=2.0, memory="features")
EVERY = np.arange(1)


def test_unicycle_features_do_not_rotate_with_body():
    """Rows in the initial frames, for 190 steps of any inputs."""
    simulator, frames = rv.Simulator(CARS, 3), OdometryFrame(CARS, 3, 0.2)
    seen, random = simulator.reset(5), np.random.default_rng(0)
    start = simulator.frames.copy()
    for _ in range(190):
        steady = frames.seen(seen, np.arange(3))
        globally = np.einsum("bnij,bnkj->bnki", simulator.frames, seen)
        from_start = np.einsum("bnji,bnkj->bnki", start, globally)
        np.testing.assert_allclose(steady, from_start, atol=2e-6)
        actions = random.uniform(-2.0, 2.0, (3, CARS.n_robots, 2)).astype(np.float32)
        actions[..., 0] *= 0.01
        before = simulator.positions.copy()
        frames.turn((0, 3, 0), actions)
        seen = simulator.step(actions).observations
        moved = np.einsum("bnij,bnj->bni", start, frames.velocities) * CARS.tau
        np.testing.assert_allclose(simulator.positions - before, moved, atol=1e-9)
    assert (simulator.contacts == 0).all()
    assert np.abs(simulator.frames - start).max() > 0.3


def robots_that_see(bearings):
    """One team with these neighbour rows for all robots and nothing else."""
    scenario = POINTS.replace(n_robots=len(bearings) + 1, obstacles=(), obstacle_slots=0)
    rows = np.zeros((1, scenario.n_robots, *scenario.observation_layout.shape), np.float32)
    rows[..., : len(bearings), :] = bearings
    return scenario, rows


def test_directions_in_plane_are_steady_while_f_rotates():
    """Changing gains rotate f between two bearings, which stay constant."""
    first, second = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
    scenario, _ = robots_that_see([first, second])
    planes, found = OdometryPlane(scenario, 1, 0.1), []
    for gain in np.linspace(0.1, 0.9, 9):
        _, rows = robots_that_see([gain * first, (1 - gain) * second])
        seen = planes.seen(rows, EVERY)[0, 0].astype(float)
        np.testing.assert_allclose(np.linalg.norm(seen, axis=1), [gain, 1 - gain], atol=1e-6)
        found.append(seen / np.linalg.norm(seen, axis=1, keepdims=True))
    np.testing.assert_allclose(found, [found[0]] * 9, atol=1e-6)
    assert abs(np.linalg.det(found[0])) == pytest.approx(1.0, abs=1e-6)  # at a right angle, too


def test_f_in_plane_ignores_outside_components():
    random = np.random.default_rng(0)
    scenario, rows = robots_that_see(random.normal(size=(4, 3)))
    planes = OdometryPlane(scenario, 1, 0.1)
    for _ in range(5):
        rows = (rows + random.normal(0.0, 0.2, rows.shape)).astype(np.float32)
        seen = planes.seen(rows, EVERY)[..., :4, :].sum(axis=-2)
        lengths = (np.linalg.norm(f, axis=-1)
                   for f in (seen, scenario.observation_layout.net_bearing(rows)))  # fmt: skip
        np.testing.assert_allclose(*lengths, atol=1e-5)


@pytest.mark.kernels
def test_plane_is_kept_while_blocked():
    """Afterwards the plane with the smallest turn is taken."""
    scenario, rows = robots_that_see([[1.0, 0.0, 0.0]])
    scenario = scenario.replace(obstacle_slots=1, obstacles=())
    around = np.arange(8)[:, None] * np.pi / 4 + 0.1
    ring = np.cos(around) * [0.0, 1.0, 0.0] + np.sin(around) * [0.0, 0.0, 1.0]
    planes, found = OdometryPlane(scenario, 1, 0.1), []
    rows = np.concatenate([rows, np.zeros((1, 2, 8, 3), np.float32)], axis=2)
    for shift in ([0.0, -0.3, 0.0], [0.0, 0.0, -0.3], None, [0.0, 0.0, -0.3]):
        rows[..., 1:, :] = 0.0
        if shift is not None:
            rays = [1.0, 0.0, 0.0] + 0.5 * ring + shift
            rows[..., 1:, :] = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        edges = planes.seen(rows, EVERY)[0, 0, 1:]
        assert edges.any() == (shift is not None)
        found.append(planes.get_state()["aside"][0, 0])
    np.testing.assert_allclose(found[1:3], [found[0]] * 2, atol=1e-12)
    assert abs(found[0][1]) > 0.9 and abs(found[3][2]) > 0.9


@pytest.mark.kernels
@pytest.mark.parametrize("scenario", [POINTS, UAV], ids=["points", "nonholonomic"])
@pytest.mark.parametrize("share", [1.0, 0.25])
def test_plane_does_not_rotate_with_body(scenario, share):
    """The plane of a nearly stationary robot is constant for any turn rates and early ticks."""
    scenario = scenario.replace(obstacles=(), obstacle_slots=1)
    simulator = rv.Simulator(scenario.replace(time_step=share * scenario.tau), 4)
    planes, random = OdometryPlane(scenario, 4, 0.1), np.random.default_rng(0)
    seen, teams = simulator.reset(1), np.arange(4)
    first = planes.seen(seen, teams).copy()
    for _ in range(30):
        actions = random.uniform(-1.0, 1.0, (4, scenario.n_robots, 3)) * scenario.action_bounds
        actions *= [1e-4, 1.0, 1.0] if scenario.model.nonholonomic else 1e-4
        planes.turn((0, 4, 0), actions.astype(np.float32))
        seen = simulator.step(actions.astype(np.float32)).observations
        planes.settle(share)
        np.testing.assert_allclose(planes.seen(seen, teams), first, atol=2e-3)


@pytest.mark.parametrize("settings", [HEADING, TANK], ids=["heading", "tank"])
def test_robots_turn_to_chosen_heading(settings):
    """Choice 0 without obstacles: the body turns along f, and the team meets."""
    free = CARS.replace(obstacles=(), time_limit=60.0)
    controller, simulator = BaseController(settings, free, 4), rv.Simulator(free, 4)
    seen = simulator.reset(1)
    for step in range(500):
        if step == 80:
            f = free.observation_layout.net_bearing(seen)
            off = np.abs(np.arctan2(f[..., 1], f[..., 0]))
        seen = simulator.step(controller.apply(seen)).observations
    assert np.median(off) < 0.1 and (simulator.status == RENDEZVOUS).all()


@pytest.mark.parametrize(
    ("scenario", "budget", "every", "least_apart", "least_rises"),
    [
        (CARS.replace(robot_model="single_integrator"), 0.0, 1, 4, 0),
        (CARS.replace(robot_model="single_integrator"), 3.0, 1, 4, 21),
        (CARS, 0.0, 20, 5, 0),
        (CARS, 3.0, 20, 5, 21),
        (POINTS, None, 20, 5, 21),
        (UAV, None, 20, 5, 21),
    ],
)
def test_v_plus_tanks_never_increases(scenario, budget, every, least_apart, least_rises):
    """Theorem D under arbitrary choices without obstacles, until the first merge."""
    settings = replace(TANK, budget=5.0 if budget is None else budget / 0.6)  # in units of r D̄
    free = scenario.replace(obstacles=(), time_step=None, time_limit=60.0)
    controller, simulator = BaseController(settings, free, 8), rv.Simulator(free, 8)
    seen, random = simulator.reset(4), np.random.default_rng(4)
    levels = controller.tank.levels.sum(axis=1)
    assert budget is None or levels == pytest.approx(free.n_robots * budget)
    before, rises, apart = simulator.lyapunov() + levels, 0, np.ones(8, bool)
    for step in range(300):
        if step % every == 0:
            controller.choose(random.integers(14, size=controller.choices.shape))
        v = simulator.lyapunov()
        seen = simulator.step(controller.apply(seen)).observations
        apart &= (simulator.merged_into == np.arange(free.n_robots)).all(axis=1)
        rises += int((simulator.lyapunov() > v)[apart].sum())
        now = simulator.lyapunov() + controller.tank.levels.sum(axis=1)
        assert (now <= before + 1e-9)[apart].all() and controller.tank.levels.min() >= 0.0
        before = now
    assert apart.sum() >= least_apart and rises >= least_rises


@pytest.mark.parametrize(
    ("scenario", "kind", "most", "shares"),
    [
        (CARS, OdometryFrame, 0.03, (0.1, 0.5, 0.9, 1.0, 2.0)),
        (UAV, OdometryPlane, 0.08, (0.1, 0.5, 0.9)),
    ],
    ids=["unicycle", "space"],
)
def test_truncated_arc_books_at_most_its_gain(scenario, kind, most, shares):
    """Compared with the simulated displacement in a fraction of the step."""
    scenario = scenario.replace(obstacles=())
    tank, bodies = CommandedTank(scenario, 50, budget=100.0), kind(scenario, 50, 0.1)
    random, tight = np.random.default_rng(3), 0
    for share in shares:
        short = rv.Simulator(scenario.replace(time_step=min(share, 1.0) * scenario.tau), 50)
        seen, started, frames = short.reset(2), short.positions.copy(), short.frames.copy()
        actions = np.zeros((50, scenario.n_robots, scenario.action_size), np.float32)
        f = scenario.observation_layout.net_bearing(seen)
        tank.forget()
        tank.hold(random.uniform(-1, 1, actions.shape))
        bodies.seen(seen, np.arange(50))
        tank.apply_calls((0, 50, 0), seen, actions)
        bodies.turn((0, 50, 0), actions)
        tank.settle(share, bodies.settle(share))
        short.step(actions)
        local = np.einsum("bnji,bnj->bni", frames, short.positions - started)
        zeros = [0.0] * (3 - scenario.dim)
        for team, robot in np.argwhere(short.merged_into == np.arange(scenario.n_robots)):
            if short.merged_into[team].tolist().count(robot) > 1:
                continue  # a merge has moved it
            net, way = ((*v[team, robot], *zeros) for v in (f, local))
            exact = certain_descent(net, 3.0, way, scenario.merge_radius)
            booked = tank.levels[team, robot] - 100.0
            assert exact - most <= booked <= exact + 1e-6
            tight += booked > exact - 1e-3
    assert tight > 200 or scenario.dim == 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "starts", "least"),
    [
        ("slab-3d", 30, 29),
        ("clutter-3d-32", 30, 29),
        ("uav-clutter-16", 30, 28),
        ("clutter-16", 60, 57),
    ],
)
def test_unicycle_weights_serve_3d_robots(name, starts, least):
    scenario = rv.scenarios.get(name)
    if scenario.dim == 2:
        scenario = scenario.replace(robot_model="unicycle", max_turn_rate=1.0)
    folder = shipped.folder("learned-tank", scenario)
    assert folder != shipped.folder("learned-tank")
    policy = baselines.make("learned-tank", scenario)
    trained = Config.from_plain(checkpoints.describe(folder)["config"])
    assert policy.settings == trained.policy_settings()
    assert trained.base_scenario().robot_model == "unicycle"
    found = rv.rollout(scenario, policy, seed=2000, num_envs=starts, record=())
    assert (found.success & ~found.contacts.any(axis=(0, 2))).sum() >= least


@pytest.mark.kernels
def test_early_tick_rotates_memory_by_actual_turn():
    """Ten ticks of τ/4: the body rotates by ω τ/4 in each."""
    robot, turned = baselines.RobotPolicy(CARS, "learned-tank"), 0.0
    for _ in range(10):
        angle = 2.0 - turned
        action = robot.act([[np.cos(angle), np.sin(angle)]], dt=CARS.tau / 4)
        bodies = robot.policy._controller.bodies
        ahead = bodies.seen(robot._team, EVERY)[0, 0, 0]  # after the step that was commanded
        turned += float(action[1]) * CARS.tau / 4
        wanted = 2.0 + float(action[1]) * CARS.tau
        assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(wanted, abs=1e-6)
    assert turned == pytest.approx(1.5 * 10 * CARS.tau / 4)
