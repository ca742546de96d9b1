"""PettingZoo environment: determinism of whole episodes, results of a step."""

import hashlib
import pickle

import numpy as np
import pettingzoo
import pytest
from conftest import MODELS, ROOT, assert_same_state, five, law_of, run_python
from guarantees import constant, draw

import rendezvous_env as rv
from rendezvous_env import Scenario, Simulator, parallel_env, rendezvous_v0


def make(kind, **changes):
    return parallel_env(five(kind, **{"spawn_size": 4.0, "time_limit": 8.0, **changes}))


def act(env, value=0.1):
    return constant(env, [value] * env.unwrapped.scenario.action_size)


def by_law(env, observations):
    scenario = env.scenario
    table = np.zeros((scenario.n_robots, *scenario.observation_layout.shape), np.float32)
    for name, seen in observations.items():
        table[env.index(name)] = seen
    actions = law_of(scenario)(table, 0.0)
    return {name: actions[env.index(name)] for name in env.agents}


def merged(infos):
    """Names of the merged robots."""
    return [name for name, info in infos.items() if name != f"robot_{info['merged_into']}"]


def until_a_merge(env, seed=3):
    """Run the law up to the first merge; returns the result of that step."""
    result = env.reset(seed=seed)
    while not merged(result[-1]):
        result = env.step(by_law(env, result[0]))
    return result


EPISODE = """
import sys
sys.path[:0] = ["tests", "tests/envs"]
from test_pettingzoo import fingerprint
print(*map(fingerprint, sys.argv[1:]))
"""


def fingerprint(kind):
    """Hash of all outputs of two episodes."""
    env, given = make(kind), []
    for seed in (12, None):
        given.append(env.reset(seed=seed))
        while env.agents:
            given.append((*env.step(by_law(env, given[-1][0])), env.state()))
    return hashlib.sha256(pickle.dumps(given)).hexdigest()


def test_episodes_are_deterministic_across_processes():
    expected = [fingerprint(kind) for kind in MODELS]
    assert len(set(expected)) == len(MODELS)
    found = run_python(ROOT, "-c", EPISODE, *MODELS, PYTHONHASHSEED="4711").stdout
    assert found.split()[-len(MODELS) :] == expected


def test_environment_equals_simulator(kind):
    """Dicts of a batch of one, with Python types and without further arithmetic."""
    rv.reward_term("speed asked for", lambda step: step.actions[..., 0])
    env = make(kind, reward=rv.RewardWeights(custom={"speed asked for": 1.0}))
    simulator, venv = Simulator(env.scenario), rv.make_vec(env.scenario, 1)
    observations, infos = env.reset(seed=3)
    assert list(observations) == list(infos) == env.possible_agents
    table, policy = simulator.reset(3), law_of(env.scenario)
    venv.reset(seed=3)
    while env.agents:
        alive = list(env.agents)
        observations, rewards, ends, cuts, infos = env.step(by_law(env, observations))
        actions = policy(table, 0.0)
        outcome, (_, team, _, _, told) = simulator.step(actions), venv.step(actions)
        table = outcome.observations
        np.testing.assert_array_equal(team, outcome.rewards)
        np.testing.assert_array_equal(told["robot_rewards"], outcome.robot_rewards)
        for told in (observations, rewards, ends, cuts, infos):
            assert list(told) == alive
        for name in alive:
            seen, info, i = observations[name], infos[name], env.index(name)
            np.testing.assert_array_equal(seen, table[0, i])
            assert seen.dtype == np.float32
            assert type(rewards[name]) is float and rewards[name] == outcome.robot_rewards[0, i]
            assert type(ends[name]) is bool and type(cuts[name]) is bool
            assert ("summary" in info) == (not env.agents)
            assert [type(info[key]) for key in ("contact", "merged_into", "success")] == [
                bool, int, bool,
            ]  # fmt: skip
            assert {type(info[key]) for key in ("clearance", "time", "lyapunov")} == {float}
        np.testing.assert_array_equal(env.simulator.positions, simulator.positions)


def test_reset_mask_is_not_an_option():
    """The mask would leave an episode incomplete."""
    env, other = parallel_env("swarm-20"), parallel_env("swarm-20")
    env.reset(seed=1)
    env.step({name: env.action_space(name).sample() for name in env.agents})
    observations, _ = env.reset(seed=2, options={"reset_mask": [False]})
    expected, _ = other.reset(seed=2)
    assert_same_state(env.simulator, other.simulator)
    np.testing.assert_equal(observations, expected)
    env.set_state(env.get_state())


def test_registry_creates_environment():
    pytest.importorskip("pettingzoo.env_registry", reason="PettingZoo has it from 1.27 on")
    env = pettingzoo.make("parallel", "rendezvous/rendezvous-v0", scenario="duo")
    assert env.unwrapped.scenario == Scenario(name="duo", n_robots=2)
    assert env.unwrapped.possible_agents == ["robot_0", "robot_1"]
    aec = pettingzoo.make("aec", "rendezvous/rendezvous-v0", scenario="duo", max_cycles=3)
    aec.reset(seed=0)
    turns = []
    for name in aec.agent_iter():
        over = aec.terminations[name] or aec.truncations[name]
        aec.step(None if over else aec.action_space(name).sample())
        turns.append(name)
    assert len(turns) == 2 * (3 + 1)  # everyone acts three times and then steps out


def test_factories_accept_scenarios_names_files_and_overrides(tmp_path):
    scenario = five("unicycle", name="from a file")
    scenario.to_toml(tmp_path / "mine.toml")
    assert parallel_env(tmp_path / "mine.toml").scenario == scenario
    assert parallel_env("duo", n_robots=4).scenario.n_robots == 4
    assert parallel_env().scenario.name == "fig3"
    assert parallel_env(scenario).scenario is scenario
    metadata = parallel_env().metadata
    assert metadata["name"] == "rendezvous_v0" and metadata["is_parallelizable"] is True
    assert rendezvous_v0.env().metadata["name"] == "rendezvous_v0"
    with pytest.raises(ValueError, match="render_mode is 'movie'"):
        parallel_env("duo", render_mode="movie")


def test_spaces_match_scenario(kind):
    env = make(kind)
    shapes = env.scenario.observation_layout.shape, (env.scenario.action_size,)
    for name in env.possible_agents:
        for space, shape in zip((env.observation_space, env.action_space), shapes, strict=True):
            assert space(name) is space(name) and space(name) == space("robot_0")
            assert space(name).shape == shape and space(name).dtype == np.float32
            np.testing.assert_array_equal(space(name).low, -space(name).high)
    bound, high = env.scenario.max_degree, env.action_space("robot_0").high
    expected = [bound, 10 * bound, bound] if kind == "nonholonomic_3d" else [bound] * len(high)
    np.testing.assert_allclose(high, expected, rtol=1e-6)
    assert env.state_space is env.state_space


@pytest.mark.slow
def test_double_integrators_observe_velocity():
    heavy = {"robot_model": "double_integrator", "max_speed": 0.7}
    env, usual = (make("single_integrator-2d", **heavy, max_acceleration=a) for a in (50.0, None))
    space, random, fastest = env.observation_space("robot_0"), np.random.default_rng(0), 0.0
    np.testing.assert_allclose(space.high[-1], 0.7, rtol=1e-6)
    np.testing.assert_allclose(env.action_space("robot_0").high, 50.0)
    np.testing.assert_allclose(usual.action_space("robot_0").high, 4 * 0.7)
    env.reset(seed=0)
    while env.agents:
        observations, *_ = env.step(draw(env, random))
        for seen in observations.values():
            assert space.contains(seen)
            fastest = max(fastest, float(np.linalg.norm(seen[-1])))
    assert 0.69 < fastest <= 0.7000001


def test_merged_agent_terminates_and_is_removed(kind):
    env = make(kind)
    observations, rewards, terminations, truncations, infos = until_a_merge(env)
    gone = merged(infos)
    assert gone and len(env.agents) == 5 - len(gone) and not set(gone) & set(env.agents)
    assert not any(truncations.values())
    for name, info in infos.items():
        assert terminations[name] == (name in gone)
        if name in gone:
            survivor = f"robot_{info['merged_into']}"
            assert survivor in env.agents
            assert env.index(survivor) < env.index(name)
            assert not observations[name][env.scenario.observation_layout.neighbours].any()
            assert rewards[name] == rewards[survivor]
    assert not set(env.step(by_law(env, observations))[0]) & set(gone)


def test_merged_agent_may_follow(kind):
    env, removing = make(kind, on_merge="follow"), make(kind)
    until_a_merge(removing)
    observations, rewards, terminations, truncations, infos = until_a_merge(env)
    np.testing.assert_array_equal(env.simulator.positions, removing.simulator.positions)
    gone = merged(infos)
    assert gone and env.agents == env.possible_agents
    assert not any(terminations.values()) and not any(truncations.values())
    while env.agents:
        assert env.agents == env.possible_agents
        observations, rewards, terminations, _, infos = env.step(by_law(env, observations))
        assert not any(observations[name].any() for name in gone)
        assert len(set(rewards.values())) == 1
    assert all(terminations.values()) and len(terminations) == 5
    assert infos["robot_4"]["merged_into"] == 0


def test_summary_is_in_final_infos(kind):
    env = make(kind, time_limit=60.0)
    observations, _ = env.reset(seed=2)
    total, steps = 0.0, 0
    while env.agents:
        observations, rewards, ends, cuts, infos = env.step(by_law(env, observations))
        total, steps = total + rewards["robot_0"], steps + 1
    assert all(ends.values()) and not any(cuts.values())
    for info in infos.values():
        summary = info["summary"]
        assert set(summary) == {"success", "time", "contacts", "path_length", "lyapunov"}
        assert summary["success"] is True and type(summary["contacts"]) is int
        assert summary["time"] == pytest.approx(steps * env.scenario.tau)
        assert summary["lyapunov"] == 0 and summary["path_length"] > 3
        assert summary.items() <= info.items()
    assert total == pytest.approx(1 + 1 - 0.1 * steps / env.max_cycles)


def test_time_out_truncates_active_agents(kind):
    env = make(kind, time_limit=1e-9)
    env.reset(seed=2)
    actions = act(env)
    _, _, terminations, truncations, infos = env.step(actions)
    assert list(truncations.values()) == [True] * 5 and not any(terminations.values())
    assert infos["robot_0"]["summary"]["success"] is False and env.agents == []
    assert env.step({}) == ({}, {}, {}, {}, {})
    with pytest.raises(KeyError, match="robot_0 has ended"):
        env.step(actions)


def test_merge_in_last_step_terminates_and_others_truncate():
    chain = Scenario(n_robots=3, graph="path", time_limit=1e-9)
    env = parallel_env(chain)
    env.reset(seed=0, options={"positions": [[0.0, 0], [0.1, 0], [5, 0]]})
    _, _, terminations, truncations, _ = env.step(act(env, 0.0))
    assert terminations == {"robot_0": False, "robot_1": True, "robot_2": False}
    assert truncations == {"robot_0": True, "robot_1": False, "robot_2": True}


def test_state_reports_contents(kind):
    until_a_merge(env := make(kind))
    sim, state = env.simulator, env.state()
    n, d = 5, env.scenario.dim
    assert state.dtype == np.float32 and state.shape == env.state_space.shape
    parts = np.split(state, np.cumsum([n * d, n * d * d, n * n, n]))
    held = sim.positions, sim.frames, sim.weights, sim.active
    for part, expected in zip(parts, held, strict=False):
        np.testing.assert_allclose(part, expected.ravel(), rtol=1e-6, atol=1e-6)
    assert parts[4][-1] == pytest.approx(sim.steps[0] / env.max_cycles)
