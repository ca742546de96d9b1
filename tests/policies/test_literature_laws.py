"""Laws from the literature: compared with NumPy, full episodes, supported scenarios."""

import math

import numpy as np
import pytest
from geometry import along, body_frame
from parameters import slow

import baselines
import rendezvous_env as rv
from baselines.laws.literature_laws import (
    nearest_pursuit_law,
    rounded_bearings,
    rows_from_nearest,
    rows_from_next,
    smallest_sector_law,
    unit_mean_law,
)
from baselines.laws.pursuit import Pursuit, yaw_and_pitch
from rendezvous_env import Scenario, Simulator, graphs
from rendezvous_env.trajectory import run
from research.time_bounds import pursuit_bound
from train import policies
from train.verify.monitors import unit

TEAM = rv.Scenario(n_robots=6, max_speed=1.0, time_limit=60.0)


def bearings(positions):
    """Bearings (n, n, d), zero on the diagonal."""
    return unit(positions[None] - positions[:, None])


def mean(g):
    return unit(g.sum(axis=1))


def sector(g):
    """Narrowest sector that contains all neighbours, by trying every pair as its ends."""
    velocities = np.zeros((len(g), 2))
    for i, rows in enumerate(g):
        others = np.delete(rows, i, axis=0)
        (x, y), (u, v) = others.T[:, :, None], others.T[:, None]
        turn = np.arctan2(x * v - y * u, x * u + y * v)
        right = np.flatnonzero((turn >= 0).all(axis=1))  # all others lie to its left
        left = np.flatnonzero((turn <= 0).all(axis=1))
        if len(right) and len(left):
            velocities[i] = others[right[0]] + others[left[0]]
    return velocities


def rounded(g, sectors=8):
    angles = np.round(np.arctan2(g[..., 1], g[..., 0]) / (2 * np.pi / sectors))
    turned = np.stack([np.cos(angles * 2 * np.pi / sectors), np.sin(angles * 2 * np.pi / sectors)])
    velocity = np.where(g.any(axis=-1), turned, 0.0).sum(axis=-1).T
    return velocity / np.maximum(np.linalg.norm(velocity, axis=-1, keepdims=True), 1.0)


def chase(*targets):
    return lambda g: g[np.arange(len(g)), targets]


LAWS = {
    "unit-mean": mean,
    "smallest-sector": sector,
    "quantised": rounded,
    "cyclic-pursuit": chase(1, 2, 3, 4, 5, 0),
    "nearest-pursuit": chase(1, 0, 1, 2, 3, 4),  # by index, one below
}


@pytest.mark.parametrize(("name", "law"), LAWS.items(), ids=LAWS)
def test_law_matches_numpy_reference(name, law):
    """In the global frame, as sectors start at each robot's own x axis."""
    simulator = rv.Simulator(TEAM.replace(local_frames="global"), 100)
    found = baselines.make(name, simulator.scenario)(simulator.reset(3), 0.0)
    for positions, actions in zip(simulator.positions, found, strict=True):
        velocities = law(bearings(positions))
        speed = np.linalg.norm(velocities, axis=-1, keepdims=True)
        np.testing.assert_allclose(actions, velocities / np.maximum(speed, 1.0), atol=1e-6)


@pytest.mark.parametrize("graph", ["path", "star", "random_tree"])
def test_unit_mean_law_meets_within_bound(graph):
    """T ≤ V0⁺/(4 v a*), twice that for held steps."""
    team = TEAM.replace(graph=graph, n_robots=5)
    found = rv.rollout(team, baselines.make("unit-mean", team), 0, num_envs=40)
    n, links = 5, 4
    bound = (found.lyapunov[0] + (n - 1) * team.merge_radius * links) / (4 * team.speed_limit)
    assert (found.rendezvous_time <= 2 * bound).all()


@pytest.mark.parametrize("name", ["cyclic-pursuit", slow("nearest-pursuit")])
def test_pursuit_meets_within_theorem_g_bound(name):
    """The target of a robot changes at merges; the sum of its gains is always v."""
    team = TEAM.replace(time_step=0.005)
    found = rv.rollout(team, baselines.make(name, team), 0, num_envs=30)
    simulator = rv.Simulator(team, 30)
    simulator.reset(0)
    one_gain = team.replace(graph=graphs.complete(0.2), max_speed=1.0)  # D_i = v
    own = (one_gain.replace(start_positions=start) for start in simulator.positions)
    bounds = [rv.certificate(start).continuous_time_bound for start in own]
    assert (found.rendezvous_time <= bounds).all()


class TestSmallestSector:
    @pytest.mark.parametrize(
        ("degrees", "narrowest"),
        [
            ((170, -170), (170, 190)),  # least and largest of atan2 would be the wide sector
            ((-100, 100, 180), (100, 260)),
            ((10, 20, 70), (10, 70)),
            ((45,), (45, 45)),
            ((-179, 1.5, 60), (1.5, 181)),
        ],
    )
    def test_smallest_sector_matches_hand_computation(self, degrees, narrowest):
        wanted = along(*narrowest).sum(axis=0)
        np.testing.assert_allclose(smallest_sector_law(along(*degrees)), wanted, atol=1e-12)

    def test_surrounded_robot_stops_regardless_of_lengths(self):
        assert smallest_sector_law(along(0, 120, 240)).tolist() == [0, 0]
        assert smallest_sector_law(np.zeros((3, 2))).tolist() == [0, 0]
        rows = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 0.0], [0.0, 0.1]])
        np.testing.assert_allclose(smallest_sector_law(rows), [1, 1], atol=1e-12)

    def test_smallest_sector_never_lengthens_links(self):
        """As proven in the source, for a step of r/2 at speeds of up to 2 m/s."""
        team = TEAM.replace(graph="path", max_speed=None, merge_radius=0.2, time_step=0.05)
        found = rv.rollout(team, baselines.make("smallest-sector", team), 2, num_envs=30)
        whole = found.active.all(axis=-1)
        links = np.linalg.norm(np.diff(found.positions, axis=2), axis=-1)
        rises = np.diff(links, axis=0)[whole[1:]]
        assert rises.max() < 1e-6 and len(rises) > 400


def test_equations_match_hand_computation():
    assert unit_mean_law(np.zeros((2, 3)), speed=2.0).tolist() == [[0] * 3] * 2
    np.testing.assert_allclose(unit_mean_law(np.array([3.0, 4.0]), speed=2.0), [1.2, 1.6])
    row = 3 * np.array([math.cos(0.2), math.sin(0.2)])
    assert rounded_bearings(row, 4).tolist() == [pytest.approx(3), 0]
    finer, turned = rounded_bearings(np.stack([row, 0 * row]), 16), 2 * math.pi / 16
    np.testing.assert_allclose(finer, [[3 * math.cos(turned), 3 * math.sin(turned)], [0, 0]])


def test_too_few_sectors_fail():
    """An error of π/k < π/n is tolerated (theorem N); half-turns give no direction."""
    team = TEAM.replace(time_limit=20.0)
    coarse = rv.rollout(team, baselines.make("quantised", team, sectors=2), 0, num_envs=20)
    fine = rv.rollout(team, baselines.make("quantised", team, sectors=7), 0, num_envs=20)
    assert coarse.success.mean() < 0.5 and fine.success.all()
    with pytest.raises(ValueError, match="sectors is 1; it must be"):
        baselines.make("quantised", team, sectors=1)


def test_row_orders_follow_indices():
    assert rows_from_next(4, 3).tolist() == [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 1, 2]]
    assert rows_from_nearest(4, 3).tolist() == [[0, 1, 2], [0, 1, 2], [1, 2, 0], [2, 1, 0]]
    assert rows_from_nearest(4, 1).tolist() == [[0]] * 4
    rows = np.eye(3)[None].repeat(4, axis=0)
    rows[1, 0] = rows[2, 1] = 0.0  # robot 1 does not see robot 0, nor robot 2 robot 1
    towards = nearest_pursuit_law(rows, speed=2.0)
    assert towards.tolist() == [[2, 0, 0], [0, 2, 0], [0, 0, 2], [0, 0, 2]]


def test_few_rows_do_not_identify_robots():
    ring = rv.Scenario(n_robots=6, graph="cycle")
    for name in ("cyclic-pursuit", "nearest-pursuit"):
        with pytest.raises(ValueError, match=f"'{name}' does not fit"):
            baselines.make(name, ring)
    every_row = ring.replace(neighbour_slots=5)
    found = rv.rollout(every_row, baselines.make("cyclic-pursuit", every_row), num_envs=5)
    assert found.success.all()


def test_a_comparison_takes_them_wherever_they_fit():
    assert {"bearing-only", "link-keeping", *LAWS} <= set(policies.fitting(TEAM, ()))
    assert policies.fitting(TEAM, list(LAWS)) == list(LAWS)
    assert {"pursuit", "windshield"} <= set(policies.fitting(rv.scenarios.get("fov-8"), ()))


def test_a_brief_comparison_leaves_them_out_among_obstacles():
    field = rv.scenarios.get("clutter-8")
    brief = policies.fitting(field, (), brief=True)
    left_out = set(policies.fitting(field, ())) - set(brief)
    assert left_out == {"link-keeping", "learned-tank-noise", *LAWS}
    free = set(policies.fitting(TEAM, (), brief=True))
    assert {*LAWS, "link-keeping"} <= free and "learned-tank-noise" not in free


CARS = Scenario(
    n_robots=4, robot_model="unicycle", max_turn_rate=4.0, max_speed=0.3, time_step=0.0125,
    allow_long_step=True, time_limit=90.0,
)  # fmt: skip


def view(scenario, *rows):
    """One team with the same rows for all robots."""
    shape = (scenario.n_robots, *scenario.observation_layout.shape)
    return np.broadcast_to(np.array(rows, dtype=np.float32), shape)


class TestPursuitByRobotsWithATurnLimit:
    """Robots pursue one target at a time, and align before they drive."""

    @pytest.mark.slow
    @pytest.mark.parametrize(("model", "dim"), [("unicycle", 2), ("nonholonomic_3d", 3)])
    def test_pursuit_meets_within_bound(self, model, dim):
        scenario = CARS.replace(robot_model=model, dim=dim)
        found = rv.rollout(scenario, baselines.make("pursuit", scenario, speed=0.3), 0, num_envs=40)
        simulator = Simulator(scenario, 40)
        simulator.reset(0)
        assert (found.rendezvous_time <= pursuit_bound(scenario, simulator.size(), 0.3)).all()

    def test_turns_match_hand_computation(self):
        """At most ω_max, and only the remaining angle in the last step before driving."""
        cars = CARS.replace(n_robots=2, time_step=0.1)
        policy = baselines.make("pursuit", cars)
        assert policy.speed == pytest.approx(0.3)  # the limit, less than 0.8 · 4 · 0.2/2
        for angle, wanted in [
            (1.0, (0, 4)), (-3.0, (0, -4)), (0.45, (0, 4)), (0.3, (0.3, 3)), (-0.05, (0.3, -0.5)),
        ]:  # fmt: skip
            seen = view(cars, [math.cos(angle), math.sin(angle)])
            np.testing.assert_allclose(policy(seen, 0.0), [wanted] * 2, rtol=1e-5)
        assert policy(view(cars, [0, 0]), 0.0).tolist() == [[0, 4]] * 2  # looks for somebody
        quick = CARS.replace(max_speed=5.0)  # no faster than its target can turn round it
        assert baselines.make("pursuit", quick).speed == pytest.approx(0.8 * 4.0 * 0.1)

    @pytest.mark.parametrize("name", ["pursuit", "windshield"])
    def test_target_is_kept_while_visible(self, name):
        policy = baselines.make(name, CARS)
        left, right, none = [0, 1], [0, -1], [0, 0]

        def turns(*rows):
            return np.sign(policy(view(CARS, *rows), 0.0)[:, 1]).tolist()

        assert turns(none, left, right) == [1, 1, -1, 1]  # the next by row that is seen
        assert turns(left, right, left) == [-1, -1, 1, -1]  # kept
        assert turns(none, none, right) == [-1] * 4
        policy.reset()
        assert turns(left, right, left) == [1, -1, 1, 1]

    @pytest.mark.slow
    def test_windshield_matches_equation(self):
        policy = baselines.make("windshield", CARS, half_angle=0.3, speed=0.2)
        for angle, turn in [(0.29, 0), (0.31, 4), (-0.31, -4), (3.0, 4), (0.0, 0)]:
            seen = view(CARS, *([[math.cos(angle), math.sin(angle)]] * 3))
            np.testing.assert_allclose(policy(seen, 0.0), [(0.2, turn)] * 4, rtol=1e-6)
        assert policy(view(CARS, *([[0, 0]] * 3)), 0.0).tolist() == [[0, 4]] * 4
        usual = baselines.make("windshield", CARS)
        assert math.cos(2 * usual.half_angle) == pytest.approx(2 / 3)  # half of lemma 11
        assert rv.rollout(CARS, usual, 0, num_envs=50).success.all()

    @pytest.mark.parametrize(
        ("name", "options", "message"),
        [
            ("pursuit", {"speed": 0.5}, r"speed is 0\.5; .* less than ω_max r/2 = 0\.4 m/s"),
            ("pursuit", {"speed": 0.35}, r"at most the speed limit, 0\.3 m/s"),
            ("pursuit", {"order": "x"}, "order is 'x'; it must be numbers"),
            ("pursuit", {"order": [[0, 1]]}, r"order is .*; it must be rows below \d+, "),
            ("pursuit", {"order": np.full((CARS.n_robots, CARS.n_robots - 1), 0.5)}, "rows below"),
            ("windshield", {"half_angle": 2}, "half_angle is 2; .* less than π/2"),
        ],
    )
    def test_invalid_pursuit_scenarios_are_rejected(self, name, options, message):
        with pytest.raises(ValueError, match=message):
            baselines.make(name, CARS, **options)

    @pytest.mark.parametrize(("model", "dim"), [("unicycle", 2), slow("nonholonomic_3d", 3)])
    def test_pursuer_turns_then_drives_straight(self, model, dim):
        scenario = CARS.replace(
            n_robots=3, dim=dim, robot_model=model, max_turn_rate=3.0, max_speed=0.2,
            time_step=0.02, neighbour_slots=2, graph="path", time_limit=60.0,
        )  # fmt: skip
        simulator = Simulator(scenario, 30)
        order = np.argsort(np.random.default_rng(0).random((30, 3, 2)), axis=-1)
        law = Pursuit(scenario, scenario.speed_limit, order)
        drove = 0
        for step in run(simulator, law, simulator.reset(1)):
            speeds = step.actions[..., 0]
            assert set(np.unique(speeds)) <= {np.float32(0), np.float32(0.2)}
            seen = scenario.observation_layout.split(step.observations).neighbours
            ahead = np.max(unit(seen)[..., 0], axis=-1, initial=0.0)  # cosine to the nearest
            driving = (speeds > 0) & step.running[:, None]
            assert (ahead[driving] >= np.cos(3.0 * 0.02) - 1e-6).all()
            drove += driving.sum()
        assert drove > 1000 and (simulator.active.sum(axis=-1) == 1).all()

    def test_yaw_and_pitch_align_body_with_bearing(self):
        random = np.random.default_rng(0)
        for yaw, pitch in random.uniform(-1.5, 1.5, (100, 2)):
            target = unit(random.normal(size=3))
            turns = yaw_and_pitch(body_frame(3, yaw, pitch).T @ target, pitch)
            pointed = body_frame(3, yaw + turns[0], pitch + turns[1])[:, 0]
            np.testing.assert_allclose(pointed, target, atol=1e-12)
