"""A wrapper that changes the rewards of teams changes what a learner is paid."""

import numpy as np
import pytest
from gymnasium.vector import VectorWrapper
from gymnasium.wrappers.vector import RecordEpisodeStatistics, TransformReward

import rendezvous_env as rv
from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.adapters.slots import RewardShaping
from rendezvous_env.vector import HeadingVectorWrapper, training_env

SCENARIO = rv.scenarios.get("duo").replace(time_limit=3.0)
TEAMS = 4


class RobotByRobot(VectorWrapper):
    """Pays robots one by one, and says so itself."""

    def step(self, actions):
        seen, rewards, ends, cuts, infos = super().step(actions)
        infos["robot_rewards"] = infos["robot_rewards"] + np.arange(2.0)
        return seen, rewards + 0.5, ends, cuts, infos


def plain():
    return rv.make_vec(SCENARIO, TEAMS, autoreset_mode="SameStep")


def certified():
    return HeadingVectorWrapper(plain(), decision_period=3)


def preset():
    return training_env("clutter-4", TEAMS, time_limit=3.0)


FORMS = [plain, certified, preset]


def played(teams, steps=25):
    """Rewards (steps, B, n) of random actions."""
    robots = RobotVecEnv(teams)
    robots.seed(0)
    robots.reset()
    rng = np.random.default_rng(0)
    low, high = robots.action_space.low, robots.action_space.high
    actions = rng.uniform(low, high, (steps, robots.num_envs, *low.shape)).astype(np.float32)
    rewards = [robots.step(action)[1] for action in actions]
    return np.reshape(rewards, (steps, -1, robots.n_robots))


@pytest.mark.parametrize("make", FORMS)
def test_what_a_wrapper_of_gymnasium_adds_is_paid_and_no_more(make):
    usual = played(make())
    np.testing.assert_array_equal(played(RecordEpisodeStatistics(make())), usual)
    added = played(TransformReward(make(), lambda rewards: rewards + 1000.0)) - usual
    assert np.isclose(added, 1000.0, rtol=1e-4).sum() >= 0.5 * added.size
    assert np.isclose(added[:, :, 0], 1000.0, rtol=1e-4).all()  # robot 0 lives to the end


def test_who_pays_robots_one_by_one_has_the_last_word():
    added = played(RobotByRobot(plain())) - played(plain())
    np.testing.assert_allclose(added, np.broadcast_to([0.0, 1.0], added.shape), atol=1e-6)


def test_shaping_may_stand_on_shaping_and_adapters_on_one_environment():
    twice = TransformReward(TransformReward(plain(), lambda r: r + 1.0), lambda r: 2.0 * r)
    RobotVecEnv(twice)  # another adapter looked at it before
    expected = 2.0 * (played(plain())[:, :, 0] + 1.0)
    np.testing.assert_allclose(played(twice)[:, :, 0], expected, rtol=1e-5)


def test_shaping_may_stand_under_a_guarantee():
    under = TransformReward(plain(), lambda rewards: rewards + 1.0)
    shaped = played(HeadingVectorWrapper(under, decision_period=3))
    added = (shaped - played(certified()))[:, :, 0]
    assert (added > 0.99).all() and np.isclose(added, 3.0, rtol=1e-4).mean() > 0.5


def test_robots_that_are_gone_are_paid_nothing_more():
    shaping = RewardShaping(teams := TransformReward(plain(), lambda rewards: rewards + 1.0))
    teams.reset(seed=0)
    _, rewards, _, _, infos = teams.step(np.zeros(teams.action_space.shape, np.float32))
    acted = np.array([[True, False]] * TEAMS)
    usual = infos["robot_rewards"]
    found = shaping.robot_rewards(rewards, infos, acted)
    np.testing.assert_allclose(found - usual, acted.astype(float))


def test_a_wrapper_between_does_not_hide_the_state():
    robots = RobotVecEnv(TransformReward(training_env("duo", 3), lambda paid: 2.0 * paid))
    robots.seed(0)
    robots.reset()
    state, ahead = robots.get_state(), np.ones((6, *robots.action_space.shape), np.float32)
    once = robots.step(ahead)[:2]
    robots.set_state(state)
    for found, again in zip(once, robots.step(ahead)[:2], strict=True):
        np.testing.assert_array_equal(found, again)
