"""Search and pursuit: memories, phases of a search, obstacles, and rendezvous."""

import math

import numpy as np
import pytest
from robot_actions import single_and_batch

import baselines
import rendezvous_env as rv
from baselines.obstacle_rules.search_and_pursue import (
    are_blocked,
    clear_angles,
    intervals_of,
    wrapped,
)

TEAM = rv.Scenario(
    n_robots=2, robot_model="unicycle", max_speed=0.1, max_turn_rate=0.5, merge_radius=0.4,
    time_step=0.1, allow_long_step=True,
)  # fmt: skip
AMONG = TEAM.replace(obstacles=(rv.Disc((9.0, 9.0), 1.0),))
NOTHING = np.zeros((1, 2), np.float32)
SCAN, LEG = 2 * math.pi / 0.5, 0.8 / 0.1  # s


def unit(*angles):
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def act(policy, neighbour=None, edges=None):
    """Speed and turn rate of robot 0, which sees this bearing and these edges, rad."""
    layout = policy.scenario.observation_layout
    seen = np.zeros((2, *layout.shape), np.float32)
    if neighbour is not None:
        seen[0, 0] = unit(neighbour)
    if edges is not None:
        seen[0, layout.obstacles] = unit(*edges)
    return policy(seen, 0.0)[0].astype(float)


def test_bearing_is_pursued_and_dead_reckoned():
    policy = baselines.make("search-and-pursue", TEAM)
    np.testing.assert_allclose(act(policy, 0.02), [0.1 * math.cos(0.02), 0.2], rtol=1e-5)
    policy.reset()
    np.testing.assert_allclose(act(policy, 2.0), [0.0, 0.5], rtol=1e-6)
    # out of view the bearing turns by −ωτ in each step, and the robot drives from 0.5 rad on
    found = [act(policy) for _ in range(39)]
    left = [2.0 - 0.05 * k for k in range(1, 40)]
    for (speed, rate), angle in zip(found, left, strict=True):
        assert speed == pytest.approx(0.1 * math.cos(angle) if angle < 0.4999 else 0.0, abs=1e-6)
        assert rate == pytest.approx(0.5, rel=1e-5)


def test_search_alternates_scans_and_legs():
    """remember = r/v = 4 s; the first scan is on the spot, later ones are circles."""
    policy = baselines.make("search-and-pursue", TEAM)
    before = np.array([act(policy) for _ in range(400)])
    steps = [round(SCAN / 0.1), round(LEG / 0.1)]
    first = np.flatnonzero(before[:, 1] == 0.0)
    assert abs(first[0] - steps[0]) <= 2 and abs(np.ptp(first[: steps[1]]) - steps[1] + 1) <= 1
    assert (before[before[:, 1] > 0.0, 0] == 0.0).all()
    np.testing.assert_allclose(before[before[:, 1] == 0.0, 0], 0.1, rtol=1e-6)
    act(policy, 0.0)
    after = np.array([act(policy) for _ in range(200)])
    assert np.flatnonzero(after[:, 1])[0] in (39, 40)  # 4 s straight towards the last bearing
    np.testing.assert_allclose(after[:, 0], 0.1, rtol=1e-6)
    walled = baselines.make("search-and-pursue", AMONG)
    act(walled, 0.0)
    turning = np.array([act(walled) for _ in range(60)])
    assert (turning[turning[:, 1] > 0.0, 0] == 0.0).all() and (turning[:, 1] > 0.0).any()


def test_intervals_match_hand_computation():
    edges = np.array([unit(0.3, -0.1), unit(-3.0, 3.0), np.zeros((2, 2))])
    middles, halves = intervals_of(edges)
    np.testing.assert_allclose(middles[0], 0.1, atol=1e-12)
    assert abs(wrapped(middles[1] - math.pi)) < 1e-12  # across ±π
    np.testing.assert_allclose(halves, [0.2, math.pi - 3.0, -math.pi], atol=1e-12)
    found = are_blocked(np.array([0.35, 0.25, 1.0]), middles, halves, 0.1)
    assert found.tolist() == [True, True, False]


def test_clear_angle_is_end_of_merged_intervals():
    middles, halves = np.array([[0.0, 0.5], [0.0, 3.0], [0.0, 0.0]]), np.array([[0.3, 0.4]] * 3)
    halves[2] = 3.0, -math.pi  # an obstacle all round leaves no direction
    found = clear_angles(np.array([0.2, -0.1, 0.0]), middles, halves)
    # the left end of the first interval lies inside the second: 0.5 + 0.4 + 0.25, or −0.3 − 0.25
    np.testing.assert_allclose(found, [-0.55, -0.55, 0.5 * math.pi])


def test_robot_passes_remembered_obstacle():
    policy = baselines.make("search-and-pursue", AMONG)
    np.testing.assert_allclose(act(policy, 0.0, (0.2, -0.3)), [0.0, 0.5])  # towards 0.2 + 0.25
    found = [act(policy, 0.0) for _ in range(20)]  # the edges are out of view
    assert any(speed > 0 for speed, _ in found)
    # it drives once its axis is 0.05 rad beyond the edge at 0.2 rad
    turned = np.cumsum([0.05, *(0.1 * rate for _, rate in found)])[:-1]
    for angle, (speed, _) in zip(turned, found, strict=True):
        assert (speed > 0) == (angle > 0.25 - 1e-6) or abs(angle - 0.25) < 1e-3
    policy.reset()
    assert act(policy, 0.0)[0] == pytest.approx(0.1)  # forgotten


def test_obstacle_is_forgotten_after_half_a_leg():
    policy = baselines.make("search-and-pursue", AMONG)
    act(policy, -1.0, (1.6, 0.5))
    driven, blocked = 0.0, True
    while blocked:
        speed, _ = act(policy, 0.0)
        driven += 0.1 * speed
        blocked = bool(np.any(policy._edges))
        assert driven < 0.5
    assert driven == pytest.approx(0.4, abs=0.02)


def test_ticks_at_another_rate_turn_memory_by_elapsed_time():
    robot = baselines.RobotPolicy(TEAM, "search-and-pursue")
    robot.act(unit(2.0))
    for dt in (0.02, 0.05, 0.1):
        robot.act(np.zeros((0, 2)), dt=dt)
    bearing = robot.policy._bearing[0, 0]
    assert math.atan2(bearing[1], bearing[0]) == pytest.approx(2.0 - 0.5 * 0.17, abs=1e-6)


@pytest.mark.parametrize("name", ["utias-5", "utias-5-clutter", "camera-8"])
def test_single_robot_acts_as_one_of_a_batch(name):
    scenario = rv.scenarios.get(name)
    policy = baselines.make("search-and-pursue", scenario)
    robot = baselines.RobotPolicy(scenario, "search-and-pursue")
    for alone, together in single_and_batch(policy, robot):
        np.testing.assert_allclose(alone, together, atol=1e-5)


@pytest.mark.parametrize(("name", "least"), [("utias-5", 20), ("camera-8", 20)])
def test_teams_meet(name, least):
    scenario = rv.scenarios.get(name)
    scenario = scenario.replace(time_limit=min(scenario.time_limit, 300.0))
    policy = baselines.make("search-and-pursue", scenario)
    assert rv.rollout(scenario, policy, seed=0, num_envs=20).success.sum() >= least


@pytest.mark.nightly
def test_teams_meet_among_obstacles():
    scenario = rv.scenarios.get("utias-5-clutter")
    policy = baselines.make("search-and-pursue", scenario)
    found = rv.rollout(scenario, policy, seed=0, num_envs=40)
    assert found.collision_free.sum() >= 36


def test_search_scales_with_robots():
    """Lengths and times scale, so a team ten times as large and as fast acts alike."""
    large = TEAM.replace(merge_radius=4.0, max_speed=1.0, spawn_size=100.0)
    small = baselines.make("search-and-pursue", TEAM)
    big = baselines.make("search-and-pursue", large)
    for bearing in (0.1, None, None, 1.0, *[None] * 80):
        np.testing.assert_allclose(act(small, bearing) * [10, 1], act(big, bearing), rtol=1e-5)


@pytest.mark.parametrize("option", ["remember", "leg"])
def test_invalid_option_is_named(option):
    with pytest.raises(ValueError, match=rf"{option} is -1; it must be a positive"):
        baselines.make("search-and-pursue", TEAM, **{option: -1})
