"""Wrappers and a buffer of stable-baselines3 over slots of merging robots."""

import csv
import warnings
from collections import defaultdict

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from small_scenario import ROBOTS, SCENARIO, SEED
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor, VecNormalize

import rendezvous_env as rv
from rendezvous_env.adapters.sb3 import RobotVecEnv, make_robots
from rendezvous_env.adapters.sb3_wrappers import (
    RobotFrameStack,
    RobotMonitor,
    RobotNormalize,
    RobotReplayBuffer,
)
from rendezvous_env.vector import HeadingVectorWrapper

TEAMS, STEPS = 6, 120


@pytest.fixture(autouse=True)
def one_torch_thread(set_threads):
    set_threads(1)


def steps_of(env, steps=STEPS, seed=0):
    random = np.random.default_rng(seed)
    for _ in range(steps):
        actions = random.uniform(-2, 2, (env.num_envs, *env.action_space.shape))
        yield env.step(actions.astype(np.float32))


def begun(env):
    env.seed(SEED)
    env.reset()
    return env


def test_monitor_counts_and_writes_episodes_of_teams(tmp_path):
    path = tmp_path / "monitor.csv"
    keywords = ("success", "time")
    monitor = RobotMonitor(make_robots(SCENARIO, TEAMS), str(path), info_keywords=keywords)
    expected = [
        info["episode"]
        for *_, infos in steps_of(begun(make_robots(SCENARIO, TEAMS)))
        for info in infos
        if "episode" in info
    ]
    found = [
        info["episode"]
        for *_, infos in steps_of(begun(monitor))
        for info in infos
        if "episode" in info
    ]
    monitor.close()
    for mine, right in zip(found, expected, strict=True):
        assert mine | {"t": 0.0} == right | {"t": 0.0}
    assert monitor.episode_count == len(expected) >= 10
    rows = list(csv.DictReader(path.read_text().splitlines()[1:]))
    assert [int(row["l"]) for row in rows] == [each["l"] for each in expected]
    assert [row["success"] for row in rows] == [str(each["success"]) for each in expected]


@pytest.mark.parametrize("held", [1, 3])
def test_frame_stack_at_a_merge_is_the_survivors(held):
    mode = AutoresetMode.SAME_STEP
    teams = rv.make_vec(SCENARIO, TEAMS, autoreset_mode=mode, on_merge="follow", max_cycles=9)
    robots = RobotVecEnv(HeadingVectorWrapper(teams, decision_period=held))
    env = RobotFrameStack(robots, 3)
    env.seed(SEED)
    frames = [
        [np.zeros_like(row)] * 2 + [row]
        for row in env.reset()[..., -robots.simulator.scenario.dim :]
    ]
    counts = defaultdict(int)
    for stacked, _, dones, infos in steps_of(env, 200 // held):
        d = robots.simulator.scenario.dim
        newest = stacked[..., -d:]
        ends = {}
        for slot in range(env.num_envs):
            if not dones[slot]:
                frames[slot] = [*frames[slot][1:], newest[slot]]
            elif (
                slot not in robots.bootstrapped
                or robots.survivors[list(robots.bootstrapped).index(slot)] == slot
            ):
                ends[slot] = [*frames[slot][1:], infos[slot]["terminal_observation"][..., -d:]]
        for slot, survivor in zip(robots.bootstrapped, robots.survivors, strict=True):
            own = frames[survivor] if survivor not in ends else ends[survivor]
            counts["merged" if slot != survivor else "late"] += 1
            terminal = infos[slot]["terminal_observation"]
            np.testing.assert_array_equal(terminal, np.concatenate(own, axis=-1))
        for slot in np.flatnonzero(dones):
            frames[slot] = [np.zeros_like(newest[slot])] * 2 + [newest[slot]]
        np.testing.assert_array_equal(stacked, [np.concatenate(own, axis=-1) for own in frames])
    assert counts["merged"] >= 5 and counts["late"] >= 1, counts


def test_normalised_observations_count_robots_that_exist():
    robots = make_robots(SCENARIO, TEAMS)
    env = RobotNormalize(robots, norm_obs=True, clip_obs=1e9)
    env.seed(SEED)
    env.reset()
    seen, returns, gone = [env.get_original_obs()], [], 0
    running = np.zeros(env.num_envs)
    for observations, _, dones, _ in steps_of(env):
        active = robots.slots.active.reshape(-1)
        seen.append(env.get_original_obs()[active])
        running = running * env.gamma + env.get_original_reward()
        returns.append(running[robots.acted])
        running[dones] = 0.0
        mean, spread = env.obs_rms.mean, np.sqrt(env.obs_rms.var + env.epsilon)
        expected = (env.get_original_obs() - mean) / spread
        np.testing.assert_allclose(observations[active], expected[active], rtol=1e-4, atol=1e-5)
        assert not observations[~active].any()
        gone += (~active).sum()
    every = np.concatenate(seen)
    assert gone > 50
    np.testing.assert_allclose(env.obs_rms.mean, every.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(env.obs_rms.var, every.var(axis=0), rtol=1e-3, atol=1e-4)
    every = np.concatenate(returns)
    np.testing.assert_allclose(env.ret_rms.var, every.var(), rtol=1e-3)


def test_statistics_of_observations_can_be_saved_and_held(tmp_path):
    env = RobotNormalize(make_robots(SCENARIO, 2), norm_obs=True)
    begun(env)
    list(steps_of(env, 20))
    env.save(str(tmp_path / "statistics"))
    other = RobotNormalize.load(str(tmp_path / "statistics"), make_robots(SCENARIO, 2))
    other.training = False
    before = other.obs_rms.mean.copy()
    begun(other)
    list(steps_of(other, 20))
    np.testing.assert_array_equal(other.obs_rms.mean, before)


def test_replay_buffer_has_no_steps_of_merged_robots():
    robots = make_robots(SCENARIO, TEAMS)
    model = SAC(
        "MlpPolicy", robots, replay_buffer_class=RobotReplayBuffer, learning_starts=10**6,
        buffer_size=50 * robots.num_envs, policy_kwargs={"net_arch": [8]}, device="cpu", seed=SEED,
    )  # fmt: skip
    model.learn(80 * robots.num_envs)
    buffer = model.replay_buffer
    assert buffer.full and 0.05 < 1.0 - buffer.mask.mean() < 0.9
    gone = ~buffer.observations.any(axis=(2, 3)) & ~buffer.mask
    assert (gone == ~buffer.mask).all()  # exactly those that observed nothing
    sampled = buffer.sample(4000)
    assert (sampled.observations.abs().sum(dim=(1, 2)) > 0).all()
    rewards = np.sort(np.unique(buffer.rewards[buffer.mask]))
    assert np.isin(sampled.rewards.numpy().ravel(), rewards).all()
    # a merge is no end: it is valued by what its survivor observes
    merged = buffer.mask & (buffer.dones == 1) & (buffer.timeouts == 1)
    assert merged.sum() >= 5 and buffer.next_observations[merged].any(axis=(1, 2)).all()
    model.learning_starts = 0
    model.learn(3 * robots.num_envs, reset_num_timesteps=False)


def test_replay_buffer_without_steps_is_refused():
    robots = make_robots(SCENARIO, 1)
    spaces = robots.observation_space, robots.action_space
    buffer = RobotReplayBuffer(30, *spaces, device="cpu", n_envs=robots.num_envs)
    with pytest.raises(ValueError, match="no step of a robot that acted"):
        buffer.sample(4)
    settings = {"optimize_memory_usage": True, "handle_timeout_termination": False}
    with pytest.raises(ValueError, match="optimize_memory_usage is True; it must be False"):
        RobotReplayBuffer(30, *spaces, device="cpu", n_envs=robots.num_envs, **settings)


@pytest.mark.parametrize("wrapper", [RobotMonitor, RobotFrameStack, RobotNormalize])
def test_other_environments_are_refused(wrapper):
    other = DummyVecEnv([lambda: __import__("gymnasium").make("CartPole-v1")])
    with pytest.raises(TypeError, match=f"{wrapper.__name__} is for a RobotVecEnv"):
        wrapper(other, **({"n_stack": 2} if wrapper is RobotFrameStack else {}))


def test_drop_in_forms_do_what_the_stock_ones_do_where_nobody_merges():
    """Robots at rest up to the time limit."""
    pairs = (
        (RobotFrameStack, VecFrameStack, {"n_stack": 2}),
        (RobotNormalize, VecNormalize, {"norm_obs": True}),
    )
    for ours, theirs, settings in pairs:
        mine, other = (begun(kind(make_robots("duo", 3), **settings)) for kind in (ours, theirs))
        still = np.zeros((6, 2), np.float32)
        for _ in range(70):
            (seen, paid, ended, infos), (expected, *others) = mine.step(still), other.step(still)
            np.testing.assert_allclose(seen, expected, rtol=1e-5)
            np.testing.assert_allclose(paid, others[0], rtol=1e-5)
            np.testing.assert_array_equal(ended, others[1])
            for info, right in zip(infos, others[2], strict=True):
                if "terminal_observation" in right:
                    last = right["terminal_observation"]
                    np.testing.assert_allclose(info["terminal_observation"], last, rtol=1e-5)


def test_infos_tell_who_acted():
    robots = begun(make_robots(SCENARIO, TEAMS))
    gone = 0
    for *_, infos in steps_of(robots):
        assert [info["acted"] for info in infos] == robots.acted.tolist()
        gone += sum(not info["acted"] for info in infos)
    assert gone > 50


def test_episode_stands_at_the_same_slot_after_a_state_was_put_back():
    def slots_told(env):
        return [
            (step, slot)
            for step, (*_, infos) in enumerate(steps_of(env, 60, seed=3))
            for slot, info in enumerate(infos)
            if "episode" in info
        ]

    env = begun(make_robots(SCENARIO, TEAMS))
    list(steps_of(env, 50))
    state = env.get_state()
    once = slots_told(env)
    fresh = make_robots(SCENARIO, TEAMS)
    fresh.set_state(state)
    assert slots_told(fresh) == once and len({slot % ROBOTS for _, slot in once}) > 1
    with pytest.raises(ValueError, match=r"told\[0\] is -1"):
        fresh.set_state(state | {"told": np.full(TEAMS, -1)})


def test_stock_monitor_counts_what_the_adapter_does_not():
    """Reason for the drop-in form, as long as stable-baselines3's own behaves like this."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        stock = begun(VecMonitor(make_robots(SCENARIO, TEAMS)))
    lengths = [i["episode"]["l"] for *_, infos in steps_of(stock) for i in infos if "episode" in i]
    assert min(lengths) == 1
