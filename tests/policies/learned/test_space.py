"""Learned policies of space: what they see of the plane that they decide in, and how they go."""

import pickle

import numpy as np
import pytest
from tanks_that_last import check_v_and_tanks

import baselines
import rendezvous_env as rv
from baselines.learned import shipped
from baselines.learned.guide import CommandedTank
from baselines.learned.policy_settings import PolicySettings
from baselines.learned.training_environment import FeatureVectorEnv
from baselines.steady_planes import SteadyPlanes
from rendezvous_env.safety.tank import certain_descent

POINTS = rv.scenarios.get("clutter-3d-32")
UAV = rv.scenarios.get("uav-clutter-16").replace(max_turn_rate=1.0)
TANK = PolicySettings(
    8, (16,), clearance=0.2, persistence=0.5, min_alignment=0.05, max_turn_rate=1.2,
    decision_time=0.6, guarantee="tank", memory="features",
)  # fmt: skip
BOTH = pytest.mark.parametrize("scenario", [POINTS, UAV], ids=["points", "nonholonomic"])
EVERY = np.arange(1)


def robots_that_see(bearings):
    """One team of which all see these neighbours and nothing else."""
    scenario = POINTS.replace(n_robots=len(bearings) + 1, obstacles=(), obstacle_slots=0)
    rows = np.zeros((1, scenario.n_robots, *scenario.observation_layout.shape), np.float32)
    rows[..., : len(bearings), :] = bearings
    return scenario, rows


def test_what_lies_in_the_plane_stays_where_it_is_while_f_turns_there():
    """Gains change, so f turns between two bearings; theirs stay what they were."""
    first, second = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
    scenario, _ = robots_that_see([first, second])
    planes, found = SteadyPlanes(scenario, 1, 0.1), []
    for gain in np.linspace(0.1, 0.9, 9):
        _, rows = robots_that_see([gain * first, (1 - gain) * second])
        seen = planes.seen(rows, EVERY)[0, 0].astype(float)
        np.testing.assert_allclose(np.linalg.norm(seen, axis=1), [gain, 1 - gain], atol=1e-6)
        found.append(seen / np.linalg.norm(seen, axis=1, keepdims=True))
    np.testing.assert_allclose(found, [found[0]] * 9, atol=1e-6)
    assert abs(np.linalg.det(found[0])) == pytest.approx(1.0, abs=1e-6)  # at a right angle, too


def test_f_in_the_plane_is_f_whatever_lies_outside_it():
    random = np.random.default_rng(0)
    bearings = random.normal(size=(4, 3))
    scenario, rows = robots_that_see(bearings)
    planes = SteadyPlanes(scenario, 1, 0.1)
    for _ in range(5):
        rows = (rows + random.normal(0.0, 0.2, rows.shape)).astype(np.float32)
        seen = planes.seen(rows, EVERY)[..., :4, :].sum(axis=-2)
        f = scenario.observation_layout.net_bearing(rows)
        np.testing.assert_allclose(
            np.linalg.norm(seen, axis=-1), np.linalg.norm(f, axis=-1), atol=1e-5
        )


def test_a_plane_is_kept_while_something_in_it_is_before_f():
    """Then the one with least to turn is taken."""
    scenario, rows = robots_that_see([[1.0, 0.0, 0.0]])
    scenario = scenario.replace(obstacle_slots=1, obstacles=())
    around = np.arange(8)[:, None] * np.pi / 4 + 0.1
    ring = np.cos(around) * [0.0, 1.0, 0.0] + np.sin(around) * [0.0, 0.0, 1.0]
    planes, found = SteadyPlanes(scenario, 1, 0.1), []
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


@BOTH
@pytest.mark.parametrize("share", [1.0, 0.25])
def test_a_frame_does_not_turn_with_the_body(scenario, share):
    """A robot that hardly moves and turns at any rates sees its plane where it was; ticks that come
    early are told.
    """
    scenario = scenario.replace(obstacles=(), obstacle_slots=1)
    simulator = rv.Simulator(scenario.replace(time_step=share * scenario.tau), 4)
    planes, random = SteadyPlanes(scenario, 4, 0.1), np.random.default_rng(0)
    seen, teams = simulator.reset(1), np.arange(4)
    first = planes.seen(seen, teams).copy()
    for _ in range(30):
        actions = random.uniform(-1.0, 1.0, (4, scenario.n_robots, 3)) * scenario.action_bounds
        actions *= [1e-4, 1.0, 1.0] if scenario is not POINTS and planes._robot.turns else 1e-4
        planes.turn((0, 4, 0), actions.astype(np.float32))
        seen = simulator.step(actions.astype(np.float32)).observations
        planes.settle(share)
        np.testing.assert_allclose(planes.seen(seen, teams), first, atol=2e-3)


@BOTH
def test_v_and_the_tanks_together_never_rise(scenario):
    rises, apart = check_v_and_tanks(scenario, PolicySettings(**TANK.__dict__ | {"budget": 5.0}))
    assert apart > 4 and rises > 20


def test_an_arc_that_is_cut_short_books_no_more_than_it_earned():
    """Of space: against the displacement that the simulator makes in a share of the step."""
    scenario = UAV.replace(obstacles=())
    tank = CommandedTank(scenario, 50, budget=100.0)
    planes, random = SteadyPlanes(scenario, 50, 0.1), np.random.default_rng(3)
    for share in (0.1, 0.5, 0.9):
        short = rv.Simulator(scenario.replace(time_step=share * scenario.tau), 50)
        seen = short.reset(2)
        actions, started = np.zeros((50, scenario.n_robots, 3), np.float32), short.positions.copy()
        frames, f = short.frames.copy(), scenario.observation_layout.net_bearing(seen)
        tank.forget()
        tank.hold(random.uniform(-1, 1, actions.shape))
        planes.seen(seen, np.arange(50))
        tank.act_of((0, 50, 0), seen, actions)
        planes.turn((0, 50, 0), actions)
        tank.settle(share, planes.settle(share))
        short.step(actions)
        moved = short.positions - started
        local = np.einsum("bnji,bnj->bni", frames, moved)
        for team, robot in np.argwhere(short.active & (short.merged_into == np.arange(4))):
            net, way = tuple(f[team, robot]), tuple(local[team, robot])
            exact = certain_descent(net, 3.0, way, scenario.merge_radius)
            booked = tank.levels[team, robot] - 100.0
            assert exact - 0.08 <= booked <= exact + 1e-6


@BOTH
def test_running_teams_can_be_taken_out_and_put_back(scenario):
    one, other = (FeatureVectorEnv(rv.make_vec(scenario, 3), TANK) for _ in range(2))
    one.reset(seed=3)
    other.reset(seed=9)
    chosen = np.random.default_rng(0).integers(14, size=(30, 3, scenario.n_robots))
    for choices in chosen[:10]:
        one.step(choices)
    other.set_state(pickle.loads(pickle.dumps(one.get_state())))
    for choices in chosen[10:20]:
        for a, b in zip(one.step(choices)[:4], other.step(choices)[:4], strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("name", "least"), [("slab-3d", 29), ("clutter-3d-32", 29), ("uav-clutter-16", 28)]
)
def test_the_shipped_weights_serve_space(name, least):
    scenario = rv.scenarios.get(name)
    assert shipped.folder("learned-tank", scenario) != shipped.folder("learned-tank")
    policy = baselines.make("learned-tank", scenario)
    found = rv.rollout(scenario, policy, seed=2000, num_envs=30, record=())
    assert (found.success & ~found.contacts.any(axis=(0, 2))).sum() >= least
