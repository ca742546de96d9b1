"""Slots, episode ends and advantages, recomputed from single environments in plain Python."""

import sys
from collections import Counter
from types import ModuleType

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from small_scenario import ROBOTS, SCENARIO, SEED, Lives
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize, VecVideoRecorder

import rendezvous_env as rv
from rendezvous_env.adapters.sb3 import RobotVecEnv, make_robots
from rendezvous_env.adapters.slots import RobotSlots
from rendezvous_env.vector import EnergyTankWrapper, HeadingVectorWrapper, training_env
from train.learn.rollout_buffer import RobotPPO

TEAMS, STEPS = 8, 90
GAMMA, LAMBDA = 0.95, 0.9
SETTINGS = {
    "n_steps": STEPS, "batch_size": 64, "n_epochs": 1, "gamma": GAMMA, "gae_lambda": LAMBDA,
    "policy_kwargs": {"net_arch": [16]}, "device": "cpu", "seed": SEED,
}  # fmt: skip


@pytest.fixture(autouse=True)
def one_torch_thread(set_threads):
    set_threads(1)


def collected(algorithm, env):
    """A model after the first rollout, before any update."""
    model = algorithm("MlpPolicy", env, **SETTINGS)
    with torch.no_grad():
        model.policy.value_net.weight *= 30.0  # values that matter
    _, callback = model._setup_learn(STEPS * env.num_envs)
    model.collect_rollouts(model.env, callback, model.rollout_buffer, STEPS)
    return model


def value_of(model, observation):
    with torch.no_grad():
        return model.policy.predict_values(torch.as_tensor(observation[None])).item()


def lived(model, team):
    """Advantages of one environment's robots by (step, slot), and the ends of their episodes.

    A team of a filled buffer is played again, robot by robot, and generalised advantages are taken
    over each life backwards from the value of its future.
    """
    lives, advantages, ends = Lives(team), {}, Counter()
    slots = {name: team * ROBOTS + i for i, name in enumerate(lives.env.possible_agents)}
    for actions in model.rollout_buffer.actions:
        lives.step({name: actions[slot].clip(-2, 2) for name, slot in slots.items()})
    for robot, life, last, kind in (*lives.found, *lives.unfinished()):
        future, advantage = 0.0 if kind == "met" else value_of(model, last), 0.0
        ends[kind] += 1
        for t, reward, seen in list(zip(life.times, life.rewards, life.seen, strict=True))[::-1]:
            value = value_of(model, seen)
            advantage = reward + GAMMA * future - value + GAMMA * LAMBDA * advantage
            advantages[t, team * ROBOTS + robot] = advantage
            future = value
    return advantages, ends


def test_advantages_match_each_robot_alone():
    np.testing.assert_array_equal(SCENARIO.action_bounds, 2.0)
    model = collected(RobotPPO, make_robots(SCENARIO, TEAMS))
    buffer, counts = model.rollout_buffer, Counter()
    acted = np.zeros_like(buffer.mask)
    for team in range(TEAMS):
        advantages, ends = lived(model, team)
        for (t, slot), advantage in advantages.items():
            acted[t, slot] = True
            assert buffer.advantages[t, slot] == pytest.approx(advantage, abs=2e-5)
        counts += ends
    np.testing.assert_array_equal(buffer.mask, acted)
    assert min(counts[kind] for kind in ("met", "merged", "late")) >= 3, counts
    assert not acted.all()


@pytest.mark.filterwarnings("ignore:You have specified a mini-batch size")
def test_stock_ppo_uses_rewards_and_values_from_infos():
    ours = collected(RobotPPO, make_robots(SCENARIO, TEAMS)).rollout_buffer
    stock = collected(PPO, make_robots(SCENARIO, TEAMS)).rollout_buffer
    mask = ours.mask
    np.testing.assert_allclose(ours.rewards[mask], stock.rewards[mask], atol=1e-5)
    np.testing.assert_allclose(ours.advantages[mask], stock.advantages[mask], atol=1e-5)
    np.testing.assert_array_equal(ours.observations, stock.observations)


def test_batches_contain_every_active_sample_once():
    buffer = collected(RobotPPO, make_robots(SCENARIO, TEAMS)).rollout_buffer
    expected = np.sort(buffer.log_probs[buffer.mask])
    batches = list(buffer.get(64))
    least = len(expected) // len(batches)
    assert {len(batch.returns) for batch in batches} <= {least, least + 1}
    found = torch.cat([batch.old_log_prob for batch in batches]).numpy()
    np.testing.assert_array_equal(np.sort(found), expected)
    assert all(batch.observations.abs().sum(dim=(1, 2)).min() > 0 for batch in batches)


def random_steps(env, steps, seed=0):
    random = np.random.default_rng(seed)
    for _ in range(steps):
        actions = random.uniform(-2, 2, (env.num_envs, *env.action_space.shape))
        yield env.step(actions.astype(np.float32))


def test_episode_statistics_are_per_environment():
    env = make_robots(SCENARIO, 4)
    env.seed(SEED)
    env.reset()
    rewards_of, episodes = np.zeros(4), []
    for _, rewards, dones, infos in random_steps(env, 60):
        rewards_of += rewards[::ROBOTS]
        for slot, info in enumerate(infos):
            if "episode" in info:
                episode, team = info["episode"], slot // ROBOTS
                assert info["is_success"] is episode["success"]
                own = slice(team * ROBOTS, (team + 1) * ROBOTS)
                cut = [one["TimeLimit.truncated"] for one in infos[own]]
                assert dones[own].all()
                assert cut[0] != episode["success"] and not (episode["success"] and any(cut))
                assert episode["r"] == pytest.approx(rewards_of[team], abs=1e-5)
                assert episode["time"] == pytest.approx(episode["l"] * SCENARIO.tau)
                rewards_of[team] = 0.0
                episodes.append(episode)
    assert len(episodes) >= 8 and {"r", "l", "t", "success", "contacts"} <= episodes[0].keys()


def test_partial_reset_keeps_counts_of_others():
    slots = RobotSlots(training_env("clutter-4", 2, time_limit=3.0))
    slots.reset(0)
    still, lengths = np.zeros((slots.num_envs, 2), np.float32), {}
    for step in range(7):
        if step == 2:
            slots.reset(options={"reset_mask": np.array([True, False])})
        finished = slots.step(still).finished
        lengths |= {team: (step, episode["length"]) for team, episode in finished.items()}
    assert lengths == {1: (4, 5), 0: (6, 5)}


@pytest.mark.parametrize(("count", "of_teams"), [(4, (1, 3)), (6, (3, 3)), (15, (6, 9))])
def test_evaluate_policy_counts_each_episode_once(count, of_teams):
    env = make_robots(SCENARIO, 2)
    model = PPO("MlpPolicy", env, **SETTINGS | {"batch_size": 60})
    env.seed(SEED)
    returns, lengths = evaluate_policy(model, env, count, return_episode_rewards=True)
    env.seed(SEED)
    seen, own, running = env.reset(), ([], []), np.zeros((2, 2))
    while min(map(len, own)) < max(of_teams):
        seen, rewards, dones, _ = env.step(model.predict(seen, deterministic=True)[0])
        running += np.stack([np.ones(2), rewards[::ROBOTS]])
        for team in np.flatnonzero(dones[::ROBOTS]):
            own[team].append(tuple(running[:, team]))  # length, total
            running[:, team] = 0.0
    expected = sorted(own[0][: of_teams[0]] + own[1][: of_teams[1]])
    assert len(returns) == count
    found = sorted(zip(lengths, returns, strict=True))
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_returned_arrays_are_not_modified_later():
    env = make_robots(SCENARIO, TEAMS)
    env.reset()
    kept = []
    for obs, rewards, dones, infos in random_steps(env, 30):
        seen = [info["terminal_observation"] for info in infos if "terminal_observation" in info]
        kept.append([(array, array.copy()) for array in (obs, rewards, dones, *seen)])
    assert sum(len(step) for step in kept) > 100
    for step in kept:
        for array, copy in step:
            np.testing.assert_array_equal(array, copy)


def test_seeds_options_and_attributes_reach_environments():
    env = make_robots(SCENARIO, TEAMS, max_cycles=7)
    assert env.seed(10) == [10 + slot // ROBOTS for slot in range(TEAMS * ROBOTS)]
    start = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    env.set_options({"positions": start})
    first = env.reset()
    np.testing.assert_array_equal(env.simulator.seeds, 10 + np.arange(TEAMS))
    np.testing.assert_array_equal(env.get_attr("positions", indices=[4])[0], start)
    assert (env.reset() != first).any()  # options and seeds hold for one reset
    env.set_options([{"positions": start + slot} for slot in range(env.num_envs)])
    env.reset()
    np.testing.assert_array_equal(env.simulator.positions[2], start + 2 * ROBOTS)
    assert env.get_attr("scenario", indices=0) == [SCENARIO]
    assert env.get_attr("seeds", indices=[0, 5]) == [10, 11]
    assert env.env_method("set_max_steps", 9) == [None] * env.num_envs
    env.set_attr("note", "mine")
    assert env.get_attr("max_steps")[0] == 9 and env.get_attr("note") == ["mine"] * env.num_envs
    with pytest.raises(ValueError, match="all slots share"):
        env.set_attr("note", "other", indices=0)
    with pytest.raises(AttributeError, match="no_such_thing"):
        env.get_attr("no_such_thing")


@pytest.mark.parametrize(
    ("wrapper", "options"),
    [(HeadingVectorWrapper, {}), (EnergyTankWrapper, {"budget": 1.0, "observe_level": True})],
)
def test_ppo_learns_through_wrappers(wrapper, options):
    teams = rv.make_vec(SCENARIO, TEAMS, autoreset_mode=AutoresetMode.SAME_STEP)
    robots = RobotVecEnv(wrapper(teams, decision_period=2, **options))
    assert robots.env_is_wrapped(wrapper, indices=[1, 2]) == [True, True]
    model = RobotPPO("MlpPolicy", VecNormalize(robots, norm_obs=False), **SETTINGS)
    before = model.policy.state_dict()["action_net.weight"].clone()
    model.learn(STEPS * robots.num_envs)
    assert (model.policy.state_dict()["action_net.weight"] != before).any()
    assert len(model.ep_info_buffer) > 0 and "success" in model.ep_info_buffer[0]
    assert robots.tell_bootstraps


def test_robot_vec_env_rejects_unsupported_wrappers():
    for teams in (SCENARIO, None, rv.parallel_env("duo")):
        with pytest.raises(TypeError, match=f"vector_env is a {type(teams).__name__}; it must be"):
            RobotVecEnv(teams)
    with pytest.raises(ValueError, match="SAME_STEP"):
        RobotVecEnv(rv.make_vec(SCENARIO, 2))
    with pytest.raises(ValueError, match="SAME_STEP"):
        make_robots(SCENARIO, 2, autoreset_mode="NextStep")
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        counted_twice = VecMonitor(make_robots(SCENARIO, 2))
    with pytest.raises(TypeError, match="norm_obs"):
        RobotPPO("MlpPolicy", VecNormalize(counted_twice), **SETTINGS).learn(10)


def test_invalid_discrete_action_is_rejected():
    robots = RobotVecEnv(training_env("clutter-8", 1, discrete=True))
    robots.reset()
    robots.step(np.full(4, 8))
    for wrong in (1.5, np.nan, 9):
        with pytest.raises(ValueError, match=f"environment 0 is {wrong}; .* integer below 9"):
            robots.step(np.full(4, wrong))


def test_vec_video_recorder_works(tmp_path, monkeypatch):
    """``moviepy`` only writes the recording."""
    monkeypatch.setitem(sys.modules, "moviepy", ModuleType("moviepy"))
    robots = make_robots(SCENARIO, 2, render_mode="rgb_array")
    film = VecVideoRecorder(robots, str(tmp_path), lambda step: step == 0, video_length=9)
    film.reset(), film.step(np.zeros((6, 2), np.float32))
    (_, last), film.recorded_frames = film.recorded_frames, []
    assert film.frames_per_sec == robots.vector_env.metadata["render_fps"]
    np.testing.assert_array_equal(pictures := robots.get_images(), robots.vector_env.render())
    assert last.size >= sum(picture.size for picture in pictures)


def test_slot_options_must_match_within_environment():
    env = make_robots(SCENARIO.replace(obstacle_slots=1), 2)
    places = [np.array([0.5, 3.0]), [0.5, 3.0]] * ROBOTS
    env.set_options([{"obstacles": [{"centre": place, "radius": 0.1}]} for place in places])
    env.reset()
    np.testing.assert_array_equal(*env.simulator.obstacles)
    assert env.simulator.obstacles.any()
    env.set_options([{"obstacles": None}, {}] * ROBOTS)  # as if they were not given
    env.reset()
    env.set_options([{"obstacles": [rv.Disc((slot, 0.0), 0.1)]} for slot in range(2 * ROBOTS)])
    with pytest.raises(ValueError, match="all environments need the same keys and obstacles"):
        env.reset()
    start = np.zeros((ROBOTS, 2))
    for wrong, message in (
        (
            start[:2],
            r"positions of environment 1 has shape \(2, 2\); that of environment 0 has \(3, 2\)",
        ),
        ("x", "positions is 'x'"),
    ):
        env.set_options([{"positions": start}] * ROBOTS + [{"positions": wrong}] * ROBOTS)
        with pytest.raises(ValueError, match=message):
            env.reset()
    # what is no option of ours is ignored, and a mask of teams is none
    env.set_options([{"note": [1], "reset_mask": 1}] * ROBOTS + [{"note": 2, "reset_mask": 0}] * 3)
    env.reset()


@pytest.mark.parametrize(
    "wrong",
    [{"positions": np.full((ROBOTS, 2), np.nan)}, {"positions": "x"}, {"obstacles": 3}],
)
def test_rejected_options_do_not_affect_next_reset(wrong):
    env, other = make_robots(SCENARIO, 2), make_robots(SCENARIO, 2)
    for one in (env, other):
        one.seed(1)
        one.reset()
        one.seed(7)
    env.set_options(wrong)
    with pytest.raises(ValueError, match=next(iter(wrong))):
        env.reset()
    np.testing.assert_array_equal(env.simulator.positions, other.simulator.positions)
    np.testing.assert_array_equal(env.reset(), other.reset())  # with the seeds that were given
    assert env.get_attr("seeds") == [7] * ROBOTS + [8] * ROBOTS


def test_bad_actions_seeds_options_and_slots_are_rejected():
    env = make_robots(SCENARIO, 2)
    env.reset()
    for actions, message in (
        ("left", "actions is 'left'"),
        (np.zeros((2, 3, 2)), r"actions have shape \(2, 3, 2\); they must be \(6, 2\)"),
        (np.full((6, 2), 1e40), "action of robot_0 in environment 0"),  # of float32 it is infinite
    ):
        with pytest.raises(ValueError, match=message):
            env.step(actions)
    for seed in ("x", -1, 1.5):
        with pytest.raises(ValueError, match="seed is"):
            env.seed(seed)
    with pytest.raises(ValueError, match="5 entries; give one dict, or one for each of 6 slots"):
        env.set_options([{}] * 5)
    with pytest.raises(ValueError, match="options is 3"):
        env.set_options([3] * 6)
    for indices in (99, [0, 99], [-1], 1.5):
        with pytest.raises(ValueError, match="indices is"):
            env.env_method("set_max_steps", 9, indices=indices)
    assert env.get_attr("max_steps") != [9] * 6


def test_robot_slots_reject_foreign_reset_and_step():
    slots = RobotSlots(make_robots(SCENARIO, 2).vector_env)
    slots.reset(0)
    slots.step([[0.0, 0.0]] * 6)
    for call, given, message in (
        (slots.reset, {"options": 5}, "options is 5; it must be None or a dict"),
        (slots.step, {"actions": np.zeros(12)}, r"shape \(12,\); they must be \(6, 2\)"),
        (slots.step, {"actions": None}, "actions is None"),
        (slots.begin, {"which": np.array([1, 0])}, "mask is .* must be bool, one for each of 2"),
    ):
        with pytest.raises(ValueError, match=message):
            call(**given)


def test_infos_of_every_slot_hold_costs():
    """Infos and arrays equal those of the vector environment; episodes accumulate them."""
    scenario = rv.scenarios.get("clutter-16").replace(costs=("contact", "rise"), time_limit=1.0)
    robots, teams = make_robots(scenario, 3), rv.make_vec(scenario, 3, autoreset_mode="SameStep")
    robots.seed(4), robots.reset(), teams.reset(seed=4)
    total, ended, random = np.zeros(3), 0, np.random.default_rng(0)
    for _ in range(45):
        actions = random.uniform(-1, 1, (12, 2)).astype(np.float32)
        *_, infos = robots.step(actions)
        told = teams.step(actions.reshape(3, 4, 2))[4]
        for key in ("cost", "cost_contact", "cost_rise"):
            np.testing.assert_array_equal([info[key] for info in infos], told[key].ravel())
            np.testing.assert_array_equal(robots.costs[key], told[key].ravel())
        total += told["cost"].sum(axis=1)
        for slot, info in enumerate(infos):
            if "episode" in info:
                np.testing.assert_allclose(info["episode"]["cost"], total[slot // 4])
                total[slot // 4], ended = 0.0, ended + 1
        robots.set_state(robots.get_state())
    assert ended == 6 and make_robots("duo", 1).get_state().keys() == {
        "teams", "active", "returns", "lengths", "told",
    }  # fmt: skip


def test_infos_of_slots_hold_the_conditions_of_robots():
    clocks = {"kind": "periodic", "period": [1, 2, 3]}
    env = make_robots(SCENARIO.replace(activation=clocks, spawn_size=40.0), 2)
    env.seed(SEED)
    env.reset()
    for step in range(SCENARIO.max_steps):
        infos = env.step(np.zeros((env.num_envs, 2), np.float32))[3]
        wanted = [step % period == k % period for k, period in enumerate(clocks["period"])] * 2
        assert [info["activated"] for info in infos] == wanted
    assert all("episode" in info for info in infos[2::3])
