"""Reward wrappers: changed team rewards reach the learner."""

import numpy as np
import pytest
from gymnasium.vector import VectorRewardWrapper, VectorWrapper
from gymnasium.wrappers import TransformReward as TransformSingle
from gymnasium.wrappers.vector import (
    ClipReward,
    NormalizeReward,
    RecordEpisodeStatistics,
    TransformReward,
    VectorizeTransformReward,
)

import rendezvous_env as rv
from rendezvous_env.adapters.reward_shaping import RewardShaping
from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.vector import HeadingVectorWrapper, training_env

SCENARIO = rv.scenarios.get("duo").replace(time_limit=3.0)
TEAMS = 4


class RobotByRobot(VectorWrapper):
    """Wrapper with individual robot rewards, which it reports."""

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
    """Rewards (steps, B, n) under random actions."""
    robots = RobotVecEnv(teams)
    robots.seed(0)
    robots.reset()
    rng = np.random.default_rng(0)
    low, high = robots.action_space.low, robots.action_space.high
    actions = rng.uniform(low, high, (steps, robots.num_envs, *low.shape)).astype(np.float32)
    rewards = [robots.step(action)[1] for action in actions]
    return np.reshape(rewards, (steps, -1, robots.n_robots))


@pytest.mark.parametrize("make", FORMS)
def test_gymnasium_reward_wrapper_changes_rewards_once(make):
    usual = played(make())
    np.testing.assert_array_equal(played(RecordEpisodeStatistics(make())), usual)
    added = played(TransformReward(make(), lambda rewards: rewards + 1000.0)) - usual
    assert np.isclose(added, 1000.0, rtol=1e-4).sum() >= 0.5 * added.size
    assert np.isclose(added[:, :, 0], 1000.0, rtol=1e-4).all()  # robot 0 lives to the end


def test_per_robot_shaping_overrides_team_reward():
    added = played(RobotByRobot(plain())) - played(plain())
    np.testing.assert_allclose(added, np.broadcast_to([0.0, 1.0], added.shape), atol=1e-6)


def test_shaping_wrappers_stack_under_adapters():
    twice = TransformReward(TransformReward(plain(), lambda r: r + 1.0), lambda r: 2.0 * r)
    RobotVecEnv(twice)  # another adapter looked at it before
    expected = 2.0 * (played(plain())[:, :, 0] + 1.0)
    np.testing.assert_allclose(played(twice)[:, :, 0], expected, rtol=1e-5)


def test_shaping_works_under_guarantee():
    under = TransformReward(plain(), lambda rewards: rewards + 1.0)
    shaped = played(HeadingVectorWrapper(under, decision_period=3))
    added = (shaped - played(certified()))[:, :, 0]
    assert (added > 0.99).all() and np.isclose(added, 3.0, rtol=1e-4).mean() > 0.5


def test_merged_robots_get_no_shaped_reward():
    shaping = RewardShaping(teams := TransformReward(plain(), lambda rewards: rewards + 1.0))
    teams.reset(seed=0)
    _, rewards, _, _, infos = teams.step(np.zeros(teams.action_space.shape, np.float32))
    acted = np.array([[True, False]] * TEAMS)
    usual = infos["robot_rewards"]
    found = shaping.robot_rewards(rewards, infos, acted)
    np.testing.assert_allclose(found - usual, acted.astype(float))


def test_intermediate_wrapper_keeps_state_access():
    robots = RobotVecEnv(TransformReward(training_env("duo", 3), lambda paid: 2.0 * paid))
    robots.seed(0)
    robots.reset()
    state, ahead = robots.get_state(), np.ones((6, *robots.action_space.shape), np.float32)
    once = robots.step(ahead)[:2]
    robots.set_state(state)
    for found, again in zip(once, robots.step(ahead)[:2], strict=True):
        np.testing.assert_array_equal(found, again)


class OwnScale(VectorRewardWrapper):
    """Custom wrapper that scales rewards and counts its calls."""

    count = 0

    def rewards(self, rewards):
        self.count += 1
        return 3.0 * rewards


class PaysAsTold(VectorWrapper):
    """Team rewards are always the mean of the robot rewards here."""

    def __init__(self, env, told):
        super().__init__(env)
        self._told = np.array(told)

    def step(self, actions):
        seen, rewards, *ends, infos = self.env.step(actions)
        infos["robot_rewards"] = np.tile(self._told, (len(rewards), 1))
        return seen, np.full(len(rewards), self._told.mean()), *ends, infos


RAW = [-0.001, -0.001, -0.001, -1.001]
SCALING = {
    "normalised": (NormalizeReward, None),
    "own": (OwnScale, lambda r: 3.0 * r),
    "function": (
        lambda teams: TransformReward(teams, lambda r: 2.0 * r - 1.0),
        lambda r: 2 * r - 1,
    ),
    "clipped": (lambda teams: ClipReward(teams, -0.5, 0.5), lambda r: np.clip(r, -0.5, 0.5)),
    "one by one": (
        lambda teams: VectorizeTransformReward(teams, TransformSingle, func=lambda r: 5.0 * r),
        lambda r: 5.0 * r,
    ),
}


@pytest.mark.parametrize("how", SCALING)
@pytest.mark.parametrize("under", [False, True])
def test_robots_are_scaled_where_a_wrapper_scales(how, under):
    """Directly beneath the adapter, and beneath a guarantee that sums over two steps."""
    wrap, expected = SCALING[how]
    base = PaysAsTold(training_env("clutter-4", TEAMS, guarantee=None, learning_preset=False), RAW)
    robots = RobotVecEnv(RecordEpisodeStatistics(wrapped := wrap(base)))
    if under:
        plain = PaysAsTold(rv.make_vec("clutter-4", TEAMS, "SameStep", on_merge="follow"), RAW)
        robots = RobotVecEnv(HeadingVectorWrapper(wrapped := wrap(plain), decision_period=2))
    robots.reset()
    for _ in range(6):
        rewards = robots.step(np.ones((robots.num_envs, *robots.action_space.shape)))[1]
    if expected is None:
        factor = 1.0 / np.sqrt(wrapped.return_rms.var + wrapped.epsilon)
        assert wrapped.return_rms.count == pytest.approx((12 if under else 6) * TEAMS, rel=1e-3)
        right = np.array(RAW) * factor
    else:
        right = expected(np.array(RAW))
    found = rewards.reshape(TEAMS, 4) / (2.0 if under else 1.0)
    tolerance = 0.05 if under and expected is None else 1e-6  # the factor changes from step to step
    np.testing.assert_allclose(found, np.tile(right, (TEAMS, 1)), rtol=tolerance)
    assert how != "own" or wrapped.count == (12 if under else 6)


def test_chain_of_scaling_and_adding_wrappers_is_followed_in_order():
    class Bonus(VectorWrapper):
        def step(self, actions):
            seen, rewards, *others = self.env.step(actions)
            return seen, rewards + 0.25, *others

    teams = PaysAsTold(training_env("clutter-4", TEAMS, guarantee=None), RAW)
    robots = RobotVecEnv(OwnScale(Bonus(OwnScale(teams))))
    robots.reset()
    rewards = robots.step(np.ones((robots.num_envs, *robots.action_space.shape)))[1]
    np.testing.assert_allclose(rewards[:4], 3.0 * (3.0 * np.array(RAW) + 0.25), rtol=1e-6)


class Observed(VectorWrapper):
    """Wrapper that scales observations, optionally also final ones."""

    def __init__(self, env, last):
        super().__init__(env)
        self._last = last

    def reset(self, **asked):
        seen, infos = self.env.reset(**asked)
        return 20.0 * seen, infos

    def step(self, actions):
        seen, *others, infos = self.env.step(actions)
        if self._last and "final_obs" in infos:
            final = infos["final_obs"]
            for team in np.flatnonzero(infos["_final_obs"]):
                final[team] = 20.0 * final[team]
        return 20.0 * seen, *others, infos


@pytest.mark.parametrize("make", FORMS)
@pytest.mark.parametrize("outside", [False, True])
def test_last_observations_are_changed_like_the_others_or_refused(make, outside):
    """Episodes end by time-out, where separate robots still have neighbours."""

    def ends(teams):
        robots = RobotVecEnv(RecordEpisodeStatistics(teams) if outside else teams)
        robots.seed(0), robots.reset()
        still = np.zeros((robots.num_envs, *robots.action_space.shape))
        for _ in range(60):
            infos = robots.step(still)[3]
            if found := [i for i in infos if i.get("TimeLimit.truncated")]:
                return np.array([info["terminal_observation"] for info in found])
        raise AssertionError("none was cut off")

    with pytest.raises(TypeError, match=r"wrapped in Observed, which changes .*final_obs"):
        ends(Observed(make(), last=False))
    np.testing.assert_array_equal(ends(Observed(make(), last=True)), 20.0 * ends(make()))


class Multiplied(VectorWrapper):
    """Wrapper with its own ``step`` that scales rewards."""

    def step(self, actions):
        seen, rewards, *others = self.env.step(actions)
        return seen, -7.0 * rewards, *others


class Drawn(VectorWrapper):
    """Wrapper with random robot rewards, and their mean as team reward."""

    def __init__(self, env):
        super().__init__(env)
        self._random = np.random.default_rng(0)

    def step(self, actions):
        seen, _, *ends, infos = self.env.step(actions)
        infos["robot_rewards"] = self._random.normal(size=infos["robot_rewards"].shape)
        return seen, infos["robot_rewards"].mean(axis=1), *ends, infos


@pytest.mark.parametrize("teams", [1, TEAMS])
def test_wrapper_that_multiplies_in_its_own_step_multiplies_the_rewards_of_robots(teams):
    def paid(wrap):
        made = Drawn(training_env("clutter-4", teams, guarantee=None, time_limit=1.0))
        robots = RobotVecEnv(wrap(made))
        robots.seed(0), robots.reset()
        still = np.zeros((robots.num_envs, *robots.action_space.shape))
        return np.array([robots.step(still)[1] for _ in range(60)])

    usual = paid(RecordEpisodeStatistics)
    first = 1 if teams == 1 else 0  # of one team the first step does not tell
    np.testing.assert_allclose(paid(Multiplied)[first:], -7.0 * usual[first:], rtol=1e-5)
