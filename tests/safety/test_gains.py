"""Conversion of weights to gains, and rejected weights."""

import numpy as np
import pytest

from rendezvous_env import Scenario, certificate, graphs, make_vec
from rendezvous_env.safety.gains import Gains, gain_range
from rendezvous_env.vector import GainWrapper


def observed(scenario, *rows):
    table = np.zeros((1, scenario.n_robots, *scenario.observation_layout.shape), np.float32)
    table[0, 0, : len(rows)] = rows
    return table


@pytest.mark.parametrize(
    ("chosen", "gain", "velocity"),
    [
        ((1, 1, 1), 3.0, (1.0, 2.0)),  # a sum that is within the range stays
        ((1, 0, 0), 1.0, (1.0, 0.0)),
        ((0.5, 0.25, 1), 1.0, (0.5, 0.5)),
        ((0.1, 0.1, 1), 0.5, (0.5 / 3, 1.0 / 3)),  # 0.3 is too little: all of them grow
        ((0, 0, 1), 3.0, (1.0, 2.0)),  # nobody is in the third row: all count alike
        ((0, 0, 0), 3.0, (1.0, 2.0)),
        ((-1, 0.5, 0), 1.0, (0.0, 1.0)),
        ((7, 2, 0), 3.0, (1.0, 2.0)),
    ],
)
def test_gains_match_hand_computation(chosen, gain, velocity):
    scenario = Scenario(n_robots=4, max_speed=50.0)
    gains = Gains(scenario, 1, frame="local", min_gain=0.5, max_gain=4.0)
    held = np.zeros((1, 4, 3))
    held[0, 0] = chosen
    gains.hold(held)
    actions = gains.apply(observed(scenario, [1.0, 0.0], [0.0, 2.0]))
    np.testing.assert_allclose(actions[0, 0], velocity, rtol=1e-6)
    assert gains.gain[0, 0] == pytest.approx(gain) and not actions[0, 1:].any()
    f = np.array([1.0, 2.0])
    assert gains.lyapunov_rate[0, 0] == pytest.approx(-2 * f @ velocity)
    aligned = f @ velocity / np.linalg.norm(f) / np.linalg.norm(velocity)
    assert gains.alignment[0, 0] == pytest.approx(aligned)
    assert np.isnan(gains.alignment[0, 1]) and gains.gain[0, 1] == 0.0


def test_excessive_gains_are_scaled_down():
    scenario = Scenario(n_robots=3, max_speed=0.5)
    gains = Gains(scenario, 1, frame="local", max_gain=1.5)
    gains.hold(np.ones((1, 3, 2)))
    actions = gains.apply(observed(scenario, [1.0, 0.0], [0.0, 1.0]))
    np.testing.assert_allclose(actions[0, 0], [0.5 / np.sqrt(2)] * 2, rtol=1e-6)
    assert gains.gain[0, 0] == pytest.approx(0.5 * np.sqrt(2))  # more than v_max
    away = gains.apply(observed(scenario, [1.0, 0.0], [-1.0, 0.0]))
    assert gains.gain[0, 0] == pytest.approx(1.5) and not away.any()


def test_gains_of_each_robot_stay_within_its_limits():
    scenario = Scenario(n_robots=3, max_speed=50.0)
    limits = {"min_gain": [0.5, 1.0, 1.5], "max_gain": [0.8, 1.2, 3.0]}
    gains = Gains(scenario, 2, frame="local", **limits)
    rows = np.zeros((2, 3, *scenario.observation_layout.shape), np.float32)
    rows[:, :, :2] = np.eye(2)
    for weight, wanted in ((0.1, limits["min_gain"]), (1.0, [0.8, 1.2, 2.0])):
        gains.hold(np.full((2, 3, 2), weight))
        gains.apply(rows)
        np.testing.assert_allclose(gains.gain, [wanted] * 2, rtol=1e-6)


def test_gains_of_equal_limits_are_bitwise_those_of_one():
    scenario, found = Scenario(n_robots=4), []
    for limits in ((0.5, 2.0), ([0.5] * 4, [2.0] * 4)):
        env = GainWrapper(make_vec(scenario, num_envs=40), *limits)
        env.reset(seed=0)
        random = np.random.default_rng(0)
        for _ in range(20):
            actions = random.random(env.action_space.shape).astype(np.float32)
            seen, _, _, _, infos = env.step(actions)
        found.append((seen, infos["gain"], env.unwrapped.simulator.positions))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_certificate_of_gains_per_robot_is_that_of_the_extreme_limits():
    scenario = Scenario(n_robots=4)
    own = certificate(scenario, by="gains", min_gain=[0.5, 0.7, 1.0, 2.0], max_gain=[1, 1, 1, 3])
    assert own == certificate(scenario, by="gains", min_gain=0.5, max_gain=3.0)
    even = certificate(scenario, by="gains", min_gain=[0.5] * 4, max_gain=[0.5] * 4)
    assert even == certificate(scenario, by="gains", min_gain=0.5, max_gain=0.5)
    uneven = {"min_gain": [0.5, 1.0, 1.0, 1.0], "max_gain": [0.5, 1.0, 1.0, 1.0]}
    erring = certificate(scenario, by="gains", bearing_error=0.01, **uneven)
    assert not erring.guaranteed and "theorem N needs equal sums of gains" in erring.theorem


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"min_gain": [1.0, 2.0]}, r"min_gain is \[1.0, 2.0\]; it must be 3 numbers, one for each"),
        ({"max_gain": [1.0, 2.0, -1.0]}, r"max_gain\[2\] is -1.0; it must be a positive"),
        ({"min_gain": [1.0, 99.0, 1.0]}, r"min_gain\[1\] is 99.0; it must be at most r/τ"),
        (
            {"min_gain": 1.0, "max_gain": [2.0, 0.5, 2.0]},
            r"max_gain\[1\] is 0.5; it must be at least min_gain = 1.0",
        ),
    ],
)
def test_gains_of_each_robot_are_refused_by_field_value_and_remedy(limits, message):
    for check in (lambda: Gains(Scenario(n_robots=3), 1, **limits),
                  lambda: certificate(Scenario(n_robots=3), by="gains", **limits)):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            check()


def test_gain_range_is_reported():
    scenario = Scenario(n_robots=5, graph=graphs.path((0.5, 2.0)))
    safe = scenario.merge_radius / scenario.tau
    assert gain_range(scenario) == (0.5, scenario.max_degree) == (0.5, 4.0)
    assert gain_range(scenario, 6.0) == (6.0, 6.0)
    assert gain_range(scenario, max_gain=0.1) == (0.1, 0.1)
    assert gain_range(scenario, 1.0, 1e9) == (1.0, safe)
    slow = scenario.replace(time_step=2.0, allow_long_step=True)
    assert gain_range(slow) == (0.1, 0.1) == (slow.merge_radius / slow.tau,) * 2
