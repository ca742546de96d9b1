"""Pursuit by robots with a turn limit: one target at a time, aligned before it drives."""

import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from baselines.laws.pursuit import Pursuit, yaw_and_pitch
from rendezvous_env import Scenario, Simulator
from rendezvous_env.trajectory import run
from research.time_bounds import pursuit_bound

CARS = Scenario(
    n_robots=4, robot_model="unicycle", max_turn_rate=4.0, max_speed=0.3, time_step=0.0125,
    allow_long_step=True, time_limit=90.0,
)  # fmt: skip
PLANES = CARS.replace(robot_model="nonholonomic_3d", dim=3)


@pytest.mark.parametrize("scenario", [CARS, PLANES], ids=["unicycle", "3d"])
def test_they_meet_within_the_bound(scenario):
    found = rv.rollout(scenario, baselines.make("pursuit", scenario, speed=0.3), 0, num_envs=40)
    simulator = Simulator(scenario, 40)
    simulator.reset(0)
    assert (found.rendezvous_time <= pursuit_bound(scenario, simulator.size(), 0.3)).all()


def view(scenario, *rows):
    """One team; every robot sees the same rows."""
    shape = (scenario.n_robots, *scenario.observation_layout.shape)
    return np.broadcast_to(np.array(rows, dtype=np.float32), shape)


def test_turns_by_hand():
    """At most ω_max; only what is left in the last step; drives to within a step's turn."""
    cars = CARS.replace(n_robots=2, time_step=0.1)
    policy = baselines.make("pursuit", cars)
    assert policy.speed == pytest.approx(0.3)  # the limit, less than 0.8 · 4 · 0.2/2
    for angle, wanted in [
        (1.0, (0, 4)), (-3.0, (0, -4)), (0.45, (0, 4)), (0.3, (0.3, 3)), (-0.05, (0.3, -0.5)),
    ]:  # fmt: skip
        seen = view(cars, [math.cos(angle), math.sin(angle)])
        np.testing.assert_allclose(policy(seen, 0.0), [wanted] * 2, rtol=1e-5)
    assert policy(view(cars, [0, 0]), 0.0).tolist() == [[0, 4]] * 2  # looks for somebody


def test_a_car_that_needs_no_slack_is_slower_than_its_target_can_turn_round_it():
    quick = CARS.replace(max_speed=5.0)
    assert baselines.make("pursuit", quick).speed == pytest.approx(0.8 * 4.0 * 0.1)


@pytest.mark.parametrize("name", ["pursuit", "windshield"])
def test_a_target_is_kept_until_it_is_gone(name):
    policy = baselines.make(name, CARS)
    left, right, none = [0, 1], [0, -1], [0, 0]

    def turns(*rows):
        return np.sign(policy(view(CARS, *rows), 0.0)[:, 1]).tolist()

    assert turns(none, left, right) == [1, 1, -1, 1]  # the next by row that is seen
    assert turns(left, right, left) == [-1, -1, 1, -1]  # kept
    assert turns(none, none, right) == [-1] * 4
    policy.reset()
    assert turns(left, right, left) == [1, -1, 1, 1]


class TestWindshield:
    def test_three_values_by_hand(self):
        policy = baselines.make("windshield", CARS, half_angle=0.3, speed=0.2)
        for angle, turn in [(0.29, 0), (0.31, 4), (-0.31, -4), (3.0, 4), (0.0, 0)]:
            seen = view(CARS, *([[math.cos(angle), math.sin(angle)]] * 3))
            np.testing.assert_allclose(policy(seen, 0.0), [(0.2, turn)] * 4, rtol=1e-6)
        assert policy(view(CARS, *([[0, 0]] * 3)), 0.0).tolist() == [[0, 4]] * 4

    def test_they_meet_from_many_starts(self):
        found = rv.rollout(CARS, baselines.make("windshield", CARS), 0, num_envs=50)
        assert found.success.all()

    def test_its_default_is_half_of_lemma_11(self):
        assert math.cos(2 * baselines.make("windshield", CARS).half_angle) == pytest.approx(2 / 3)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("pursuit", {"speed": 0.5}, r"speed is 0\.5; .* less than ω_max r/2 = 0\.4 m/s"),
        ("pursuit", {"speed": 0.35}, r"at most the speed limit, 0\.3 m/s"),
        ("windshield", {"half_angle": 2}, "half_angle is 2; .* less than π/2"),
    ],
)
def test_what_they_refuse(name, options, message):
    with pytest.raises(ValueError, match=message):
        baselines.make(name, CARS, **options)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_pursuer_turns_to_its_target_and_then_drives_straight_at_it(dim):
    model = {2: "unicycle", 3: "nonholonomic_3d"}[dim]
    scenario = Scenario(
        n_robots=3, dim=dim, robot_model=model, max_turn_rate=3.0, max_speed=0.2, time_step=0.02,
        allow_long_step=True, neighbour_slots=2, graph="path", time_limit=60.0,
    )  # fmt: skip
    simulator = Simulator(scenario, 30)
    order = np.argsort(np.random.default_rng(0).random((30, 3, 2)), axis=-1)
    law = Pursuit(scenario, scenario.speed_limit, order)
    observations = simulator.reset(1)
    drove = 0
    for step in run(simulator, law, observations):
        speeds = step.actions[..., 0]
        assert set(np.unique(speeds)) <= {np.float32(0), np.float32(0.2)}
        seen = scenario.observation_layout.split(step.observations).neighbours
        units = seen / np.maximum(np.linalg.norm(seen, axis=-1, keepdims=True), 1e-12)
        ahead = np.max(units[..., 0], axis=-1, initial=0.0)  # cosine to the nearest bearing
        driving = (speeds > 0) & step.running[:, None]
        assert (ahead[driving] >= np.cos(3.0 * 0.02) - 1e-6).all()
        drove += driving.sum()
    assert drove > 1000 and (simulator.active.sum(axis=-1) == 1).all()


def test_yaw_and_pitch_point_the_body_at_a_bearing():
    random = np.random.default_rng(0)
    yaw, pitch = random.uniform(-np.pi, np.pi, 100), random.uniform(-1.5, 1.5, 100)
    target = random.normal(size=(100, 3))
    target /= np.linalg.norm(target, axis=-1, keepdims=True)

    def axis(a, b):
        return np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], axis=-1)

    forward, left = axis(yaw, pitch), np.stack([-np.sin(yaw), np.cos(yaw), 0 * yaw], axis=-1)
    up = np.cross(forward, left)
    body = np.stack([np.sum(target * v, axis=-1) for v in (forward, left, up)], axis=-1)
    turns = yaw_and_pitch(body, pitch)
    np.testing.assert_allclose(axis(yaw + turns[:, 0], pitch + turns[:, 1]), target, atol=1e-12)
