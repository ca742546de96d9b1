"""The vector form of the heading wrapper is the PettingZoo form, many times."""

import copy
import pickle

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import rendezvous_env as rv
from rendezvous_env.vector import HeadingVectorWrapper

NUM_ENVS = 6
SCENARIOS = {
    "single": rv.Scenario(n_robots=4, spawn_size=3.0, time_limit=3.0),
    "space": rv.Scenario(n_robots=3, dim=3, spawn_size=3.0, time_limit=3.0),
    "unicycle": rv.Scenario(n_robots=3, robot_model="unicycle", spawn_size=2.0, time_limit=4.0),
    "clutter": rv.scenarios.get("clutter-8").replace(time_limit=4.0),
}


def tape(venv, length, seed=0):
    shape = (length, *venv.action_space.shape)
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)


def episodes_of_singles(scenario, actions, **options):
    """What PettingZoo says: (observation, reward, terminated, truncated) by step, by team."""
    told = []
    for team in range(NUM_ENVS):
        env = rv.HeadingVectorWrapper(rv.parallel_env(scenario), **options)
        env.reset(seed=7 + team)
        steps = []
        for raw in actions[:, team]:
            if not env.agents:
                break
            alive = env.agents.copy()
            step = env.step({name: raw[int(name[6:])] for name in alive})
            observations, rewards, ends, cuts, _ = step
            table = np.zeros((scenario.n_robots, *scenario.observation_layout.shape), np.float32)
            for name in alive:
                table[int(name[6:])] = observations[name]
            over = not env.agents
            reward = rewards["robot_0"]  # never merged away: it has all of the period
            steps.append((table, reward, over and not any(cuts.values()), any(cuts.values())))
            assert set(ends) == set(alive)
        told.append(steps)
    return told


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("period", [1, 3])
def test_every_transition_equals_the_pettingzoo_wrapper(name, period):
    scenario = SCENARIOS[name]
    venv = HeadingVectorWrapper(
        rv.make_vec(scenario, NUM_ENVS, autoreset_mode=AutoresetMode.DISABLED),
        decision_period=period,
    )
    venv.reset(seed=7)
    actions = tape(venv, 1 + scenario.max_steps // period)
    singles = episodes_of_singles(scenario, actions, decision_period=period)
    compared = 0
    for t, raw in enumerate(actions):
        seen, rewards, terminations, truncations, _ = venv.step(raw)
        for team, steps in enumerate(singles):
            if t >= len(steps):
                continue
            table, reward, terminated, truncated = steps[t]
            active = table.any(axis=(1, 2))
            np.testing.assert_array_equal(seen[team][active], table[active])
            assert rewards[team] == pytest.approx(reward, abs=1e-12)
            assert (terminations[team], truncations[team]) == (terminated, truncated)
            compared += 1
    assert compared == sum(len(steps) for steps in singles) > NUM_ENVS


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_new_episode_begins_with_the_next_start_and_no_headings(mode):
    scenario = rv.Scenario(n_robots=3, spawn_size=3.0)
    venv = HeadingVectorWrapper(
        rv.make_vec(scenario, NUM_ENVS, autoreset_mode=mode, max_cycles=4), decision_period=2
    )
    other = HeadingVectorWrapper(rv.make_vec(scenario, NUM_ENVS))
    venv.reset(seed=1)
    other.reset(seed=1)
    second, _ = other.reset()
    actions = tape(venv, 3)
    venv.step(actions[0])
    *_, truncations, infos = venv.step(actions[1])
    assert truncations.all()
    assert infos["_summary" if mode is AutoresetMode.NEXT_STEP else "_final_obs"].all()
    if mode is AutoresetMode.NEXT_STEP:
        seen, rewards, _, truncations, infos = venv.step(actions[2])
        assert not rewards.any() and not truncations.any()
    else:
        seen = venv.steering.view(venv._observed)
        assert infos["final_obs"][0].shape == seen[0].shape
        assert not np.array_equal(infos["final_obs"][0], seen[0])
    np.testing.assert_array_equal(seen, second)
    assert not venv.steering.headings.any()


def test_memory_survives_state_pickle_and_deepcopy():
    venv = HeadingVectorWrapper(rv.make_vec("clutter-8", NUM_ENVS), decision_period=2)
    venv.reset(seed=3)
    actions = tape(venv, 12)
    for raw in actions[:6]:
        venv.step(raw)
    fresh = HeadingVectorWrapper(rv.make_vec("clutter-8", NUM_ENVS), decision_period=2)
    fresh.set_state(venv.get_state())
    copies = [fresh, copy.deepcopy(venv), pickle.loads(pickle.dumps(venv))]
    for raw in actions[6:]:
        seen, rewards, *_ = venv.step(raw)
        for other in copies:
            other_seen, other_rewards, *_ = other.step(raw)
            np.testing.assert_array_equal(seen, other_seen)
            np.testing.assert_array_equal(rewards, other_rewards)


def test_bad_raw_vectors_change_nothing():
    venv = HeadingVectorWrapper(rv.make_vec("duo", NUM_ENVS))
    venv.reset(seed=0)
    raw = tape(venv, 1)[0]
    before = venv.get_state()["env"]
    raw[4, 1, 0] = np.nan
    with pytest.raises(ValueError, match="robot_1 in team 4"):
        venv.step(raw)
    with pytest.raises(ValueError, match="shape"):
        venv.step(raw[:2])
    after = venv.get_state()["env"]
    assert all(np.array_equal(before[key], after[key]) for key in before)


def test_a_refused_state_leaves_the_headings_alone():
    venv = HeadingVectorWrapper(rv.make_vec("duo", NUM_ENVS))
    venv.reset(seed=0)
    venv.step(tape(venv, 1)[0])
    state, headings = venv.get_state(), venv.steering.headings
    foreign = {**state["steering"], "headings": -headings}
    with pytest.raises(ValueError, match="merged_into"):
        env = {key: value for key, value in state["env"].items() if key != "merged_into"}
        venv.set_state({**state, "steering": foreign, "env": env})
    with pytest.raises(ValueError, match="observed"):
        venv.set_state({**state, "steering": foreign, "observed": np.zeros(3)})
    np.testing.assert_array_equal(venv.steering.headings, headings)
