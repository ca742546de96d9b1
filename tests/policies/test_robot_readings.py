"""Validation of sensor messages of a robot, and reactions to invalid ones."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rendezvous_env as rv
from baselines import RobotPolicy
from baselines.robot_readings import BodyReadings, angles_of, yaw_of

TEAM = rv.Scenario(n_robots=4, merge_radius=0.4, max_speed=0.5, time_step=0.05, obstacle_slots=2)
NO_ESTIMATE = [-1.0, *8 * [0.0]]
UNKNOWN = 9 * [0.0]
NAN = math.nan


def facing(yaw):
    """Quaternion of a yaw, rad."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def readings(yaw=0.0):
    made = BodyReadings(TEAM.observation_layout, max_age=0.2)
    if yaw is not None:
        assert made.see_orientation(0.0, facing(yaw), UNKNOWN)
    return made


@pytest.mark.parametrize("yaw", np.linspace(-3.1, 3.1, 7))
def test_yaw_is_that_of_the_quaternion(yaw):
    assert yaw_of(facing(yaw)) == pytest.approx(yaw)
    assert yaw_of([-part for part in facing(yaw)], UNKNOWN) == pytest.approx(yaw)
    rounded = np.array(facing(yaw), np.float32)
    assert yaw_of(rounded) == pytest.approx(yaw, abs=1e-6)
    roll = math.sin(0.3), 0.0, 0.0, math.cos(0.3)  # about the body's x axis, after the yaw
    (_, _, z, w), (x, *_, c) = facing(yaw), roll
    assert yaw_of((w * x, z * x, z * c, w * c)) == pytest.approx(yaw)


@pytest.mark.parametrize(
    ("orientation", "covariance"),
    [
        (facing(1.0), NO_ESTIMATE),
        (facing(0.0), NO_ESTIMATE),
        ((NAN, 0.0, 0.0, 1.0), UNKNOWN),
        ((0.0, 0.0, math.inf, 1.0), UNKNOWN),
        ((0.0, 0.0, 0.0, 0.0), UNKNOWN),
        ((0.0, 0.0, 0.0, 2.0), UNKNOWN),
    ],
)
def test_an_orientation_that_is_none_has_no_yaw(orientation, covariance):
    assert yaw_of(orientation, covariance) is None


@pytest.mark.parametrize(
    ("data", "most", "width"),
    [
        ([0.1, NAN], 3, 1),
        ([0.1, -math.inf], 3, 1),
        ([0.1, 0.2, 0.3, 0.4], 3, 1),
        ([0.1, 0.2, 0.3], 2, 2),
        ([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], 2, 2),
        (["left"], 3, 1),
        (None, 3, 1),
        ([[0.1], [0.2, 0.3]], 3, 1),
    ],
)
def test_malformed_angles_are_none(data, most, width):
    assert angles_of(data, most, width) is None


def test_angles_come_in_rows():
    assert angles_of([], 3).shape == (0, 1) and angles_of([], 3, 2).shape == (0, 2)
    np.testing.assert_array_equal(angles_of([0.1, 0.2, 0.3, 0.4], 2, 2), [[0.1, 0.2], [0.3, 0.4]])


def test_bearings_are_turned_by_the_yaw_at_which_they_were_seen():
    made = readings(yaw=1.0)
    made.see_bearings(0.01, [0.5])
    made.see_edges(0.01, [0.2, 0.4])
    made.see_orientation(0.02, facing(-2.0))
    seen = made.at(0.03)
    assert np.arctan2(*seen.bearings[0, ::-1]) == pytest.approx(1.5)
    np.testing.assert_allclose(np.arctan2(*seen.obstacles[0].T[::-1]), [1.2, 1.4])
    assert seen.yaw == pytest.approx(-2.0)


def test_bearings_before_the_first_orientation_are_dropped():
    made = readings(yaw=None)
    assert not made.see_bearings(0.0, [0.5]) and not made.see_edges(0.0, [])
    made.see_orientation(0.01, facing(2.0))
    assert made.at(0.01) is None
    assert made.dropped == {"imu": 0, "bearings": 1, "edges": 1}
    assert made.see_bearings(0.02, [0.5]) and made.see_edges(0.02, [])
    assert np.arctan2(*made.at(0.02).bearings[0, ::-1]) == pytest.approx(2.5)


def test_bearings_are_not_turned_by_a_yaw_that_is_too_old():
    made = readings(yaw=1.0)
    assert not made.see_bearings(0.3, [0.5])
    made.see_orientation(0.31, facing(2.0))
    assert made.at(0.31) is None and made.dropped["bearings"] == 1


@pytest.mark.parametrize("lost", ["imu", "bearings", "edges"])
def test_a_robot_that_misses_a_topic_rests(lost):
    made = readings()
    made.see_bearings(0.0, [0.5])
    made.see_edges(0.0, [])
    assert made.at(0.1) is not None
    for topic in made.heard_at:
        made.heard_at[topic] = -math.inf if topic == lost else 0.1
    assert made.at(0.1) is None


def test_an_estimate_that_ends_stops_the_robot():
    made = readings()
    for tick in range(1, 10):
        now = 0.05 * tick
        made.see_orientation(now, facing(0.0), NO_ESTIMATE)
        made.see_bearings(now, [0.5])
        made.see_edges(now, [])
    assert made.at(now) is None and made.dropped["imu"] == 9


angles = st.lists(st.floats(allow_nan=True, allow_infinity=True, width=64), max_size=7)
quaternions = st.tuples(*4 * [st.floats(-2.0, 2.0) | st.just(NAN)])


@given(angles, angles, quaternions | st.just(facing(0.4)))
def test_whatever_messages_hold_a_robot_acts_or_rests(bearings, edges, orientation):
    made, robot = readings(), RobotPolicy(TEAM, "bearing-only")
    made.see_orientation(0.01, orientation, UNKNOWN)
    made.see_bearings(0.02, bearings)
    made.see_edges(0.02, edges)
    seen = made.at(0.03)
    assert (seen is None) == (made.dropped["bearings"] + made.dropped["edges"] > 0)
    if seen is not None:
        assert np.isfinite(robot.act(seen.bearings, seen.obstacles)).all()
