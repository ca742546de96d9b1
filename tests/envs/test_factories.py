"""Common properties of all factories: flat observations, unknown arguments, tensors, state."""

import gymnasium
import numpy as np
import pytest
from guarantees import NAMES, draw, same
from gymnasium.vector import AutoresetMode

import baselines
import rendezvous_env as rv
from rendezvous_env import rendezvous_v0, vector
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.envs.gymnasium_env import make_env, make_heading_env, make_heading_vec

SCENARIO = rv.scenarios.get("clutter-4").replace(time_limit=0.3)
SIZE = np.prod(SCENARIO.observation_layout.shape)
HEADING = "rendezvous_env:rendezvous/RendezvousHeading-v0"


def wrapped(name, env, home=vector):
    return getattr(home, name)(env) if name else env


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("name", [None, *NAMES])
def test_flat_vector_observations_are_equal(name, mode):
    tables, flat = (
        wrapped(name, rv.make_vec(SCENARIO, 3, autoreset_mode=mode, flatten=flatten))
        for flatten in (False, True)
    )
    rows, seen = tables.reset(seed=1)[0], flat.reset(seed=1)[0]
    ends = 0
    for _ in range(9):
        assert flat.observation_space.contains(seen) and seen.shape == (3, 4, SIZE)
        np.testing.assert_array_equal(seen, rows.reshape(seen.shape))
        choices = tables.action_space.sample()
        rows, *_, cuts, infos = tables.step(choices)
        seen, *_, told = flat.step(choices)
        ends += cuts.sum()
        for last, other in zip(told.get("final_obs", ()), infos.get("final_obs", ()), strict=True):
            np.testing.assert_array_equal(last, other.reshape(4, SIZE))
    assert ends


@pytest.mark.parametrize("name", [None, *NAMES])
def test_flat_pettingzoo_observations_are_equal(name):
    tables, flat = (
        wrapped(name, rv.parallel_env(SCENARIO, flatten=flatten), rv) for flatten in (False, True)
    )
    rows, seen = tables.reset(seed=1)[0], flat.reset(seed=1)[0]
    while tables.agents:
        for robot, vector_seen in seen.items():
            assert flat.observation_space(robot).contains(vector_seen)
            np.testing.assert_array_equal(vector_seen, rows[robot].reshape(-1))
        choices = draw(tables, np.random.default_rng(0))
        rows, seen = tables.step(choices)[0], flat.step(choices)[0]
    assert not flat.agents


def test_other_factories_accept_flatten():
    one = rendezvous_v0.env(SCENARIO, flatten=True)
    one.reset(seed=0)
    assert one.observe("robot_1").shape == one.observation_space("robot_1").shape == (SIZE,)
    for make in (make_env, make_heading_env):
        env = make(SCENARIO, flatten=True)
        assert env.reset(seed=0)[0].shape == env.observation_space.shape == (4, SIZE)
    with pytest.raises(ValueError, match="flatten is 'yes'; it must be one of True, False"):
        rv.make_vec(SCENARIO, flatten="yes")


def test_heading_factory_equals_wrapper():
    """The alignment holds for any choices, and numbers equal those of the vector environment."""
    settings = {"scenario": SCENARIO, "min_alignment": 0.3, "decision_period": 2}
    one, mode = gymnasium.make(HEADING, **settings), AutoresetMode.DISABLED
    entry = {"vectorization_mode": "vector_entry_point", "autoreset_mode": mode}
    many = gymnasium.make_vec(HEADING, num_envs=2, **entry, **settings)
    assert many.autoreset_mode is mode and many.metadata["autoreset_mode"] is mode
    seen, infos = one.reset(seed=6)
    table, told = many.reset(seed=5)
    keys, over = set(infos), False
    while not over:
        np.testing.assert_array_equal(seen, table[1])
        np.testing.assert_array_equal(one.unwrapped.state(), many.state()[1])
        choices = many.action_space.sample()
        table, rewards, _, cuts, told = many.step(choices)
        seen, reward, _, over, infos = one.step(choices[1])
        assert reward == rewards[1] and over == cuts[1]
        np.testing.assert_array_equal(infos["alignment"], told["alignment"][1])
        assert (infos["alignment"] >= 0.3 - 1e-9).all() and keys <= set(infos)
    assert infos["summary"]["time"] == infos["time"] == pytest.approx(SCENARIO.time_limit)


@pytest.mark.parametrize(
    ("make", "word", "meant"),
    [
        (rv.make_vec, "n_robot", "n_robots"),
        (rv.make_vec, "num_agents", "n_robots"),
        (rv.parallel_env, "max_steps", "max_cycles"),
        (rv.parallel_env, "flaten", "flatten"),
        (make_env, "max_cycle", "max_cycles"),
        (make_heading_vec, "min_alignmet", "min_alignment"),
        (make_heading_env, "time_limt", "time_limit"),
    ],
)
def test_unknown_argument_is_type_error_with_match(make, word, meant):
    with pytest.raises(TypeError, match=f"'{word}'; did you mean '{meant}'"):
        make("fig3", **{word: 1})


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("home", [rv, vector])
def test_unknown_wrapper_argument_is_type_error(home, name):
    env = rv.parallel_env(SCENARIO) if home is rv else rv.make_vec(SCENARIO, 2)
    wrapper, word, meant = getattr(home, name), "decisionperiod", "decision_period"
    with pytest.raises(TypeError, match=f"{name} has no argument '{word}'; did you mean '{meant}'"):
        wrapper(env, **{word: 1})
    with pytest.raises(TypeError, match=f"{name} has no argument 'zzz'; known are env, .*{meant}"):
        wrapper(env, zzz=1)
    assert wrapper(env=env).unwrapped is env.unwrapped


@pytest.mark.parametrize("home", [rv, vector])
def test_custom_wrapper_may_collect_arguments(home):
    class Mine(home.HeadingVectorWrapper):
        def __init__(self, env, **options):
            super().__init__(env, **{"min_alignment": 0.4} | options)

    env = rv.parallel_env(SCENARIO) if home is rv else rv.make_vec(SCENARIO, 2)
    assert Mine(env, decision_period=3).decision_period == 3
    with pytest.raises(TypeError, match="HeadingVectorWrapper has no argument 'period'; did you"):
        Mine(env, period=3)


@pytest.mark.parametrize("make", [rv.parallel_env, rv.training_env])
def test_step_before_reset_raises(make):
    env = make("duo")
    actions = {name: env.action_space(name).sample() for name in env.possible_agents}
    for given in (actions, {}):
        with pytest.raises(RuntimeError, match="call reset"):
            env.step(given)


@pytest.mark.parametrize("spelling", ["SAME_STEP", "same_step", "SameStep"])
def test_autoreset_mode_spellings_are_accepted(spelling):
    mode = AutoresetMode.SAME_STEP
    assert rv.make_vec("duo", autoreset_mode=spelling).autoreset_mode is mode
    with pytest.raises(ValueError, match="autoreset_mode"):
        rv.make_vec("duo", autoreset_mode=f"-{spelling}")


TENSORS = {
    "that requires grad": {"requires_grad": True},
    "bfloat16 tensor": {"dtype": "bfloat16"},
    "tensor on meta": {"device": "meta"},
}


@pytest.mark.parametrize("what", list(TENSORS))
def test_unreadable_tensors_are_named(what):
    torch = pytest.importorskip("torch")
    of = TENSORS[what]
    of = {key: getattr(torch, value) if key == "dtype" else value for key, value in of.items()}
    advice = rf"{what}.*\.detach\(\)\.cpu\(\)\.float\(\)\.numpy\(\)"
    bare = rv.make_vec(SCENARIO, 2)
    for env in (bare, vector.HeadingVectorWrapper(rv.make_vec(SCENARIO, 2))):
        env.reset(seed=0)
        with pytest.raises(ValueError, match=f"actions is a .*{advice}"):
            env.step(torch.zeros(2, 4, 2, **of))
    for env in (rv.parallel_env(SCENARIO), rv.training_env(SCENARIO)):
        env.reset(seed=0)
        actions, state = draw(env, np.random.default_rng(0)), env.state()
        with pytest.raises(ValueError, match=f"action of robot_2 is a .*{advice}"):
            env.step(actions | {"robot_2": torch.zeros(2, **of)})
        np.testing.assert_array_equal(env.state(), state)


def test_batch_state_stacks_single_states():
    teams = vector.GainWrapper(rv.make_vec(SCENARIO, 3))
    env = rv.parallel_env(SCENARIO)
    teams.reset(seed=2)
    for team in range(3):
        env.reset(seed=2 + team)
        np.testing.assert_array_equal(teams.state()[team], env.state())
    assert teams.state().dtype == np.float32
    assert teams.unwrapped.single_state_space == env.state_space


@pytest.mark.parametrize("name", ["duo", "swarm-20", "clutter-8", "unicycle-6"])
def test_reward_range_bounds_rewards(name):
    """Robots move along −f at full speed; two opposite ones attain the bound."""
    scenario = rv.scenarios.get(name).replace(time_limit=3.0)
    teams = rv.make_vec(scenario, 4, autoreset_mode=AutoresetMode.DISABLED)
    rows, _ = teams.reset(seed=0)
    simulator, n, weights = teams.simulator, scenario.n_robots, scenario.reward
    start, gains = simulator.initial_lyapunov, simulator.weights.sum(axis=(1, 2))
    rise = 2 * scenario.speed_limit * scenario.tau * gains / start
    at_merge = 2 * scenario.merge_radius * scenario.max_degree / start
    total, steps = np.zeros(4), simulator.max_steps
    for _ in range(steps):
        f = scenario.observation_layout.net_bearing(rows)
        length = np.linalg.norm(f, axis=-1, keepdims=True)
        away = -scenario.speed_limit * f / np.where(length > 0, length, 1.0)
        if name == "unicycle-6":
            away[..., 0], away[..., 1] = -scenario.speed_limit * np.sign(f[..., 0]), 0.0
        active = simulator.active.sum(axis=1)
        rows, rewards, *_ = teams.step(away.astype(np.float32))
        merges = active - simulator.active.sum(axis=1)
        least = -weights.progress * (rise + at_merge * merges)
        least = least - weights.time_penalty / steps - weights.collision_penalty * n
        assert (rewards >= least - 1e-9).all()
        total += rewards
        if name == "duo":
            np.testing.assert_allclose(rewards, least + weights.collision_penalty * n, rtol=1e-4)
    fixed = weights.time_penalty + weights.collision_penalty * n * steps
    assert (total >= -weights.progress * (rise * steps + at_merge * (n - 1)) - fixed).all()
    assert (total < 0).all()


@pytest.mark.parametrize("teams", [1, 2, 40])
def test_state_view_equals_simulator(teams):
    """Read together or separately; more environments than lanes in a block, or one."""
    simulator = rv.Simulator(rv.scenarios.get("clutter-8").replace(merge_radius=2.0), teams)
    law = baselines.make("bearing-only", simulator.scenario)
    rows = simulator.reset(0)
    for _ in range(260):
        outcome = simulator.step(law(rows, 0.0))
        rows = outcome.observations
    told = simulator.episode_statistics()
    assert same(simulator.episode_statistics(outcome), told)
    np.testing.assert_array_equal(told["success"], simulator.status == RENDEZVOUS)
    np.testing.assert_array_equal(told["lyapunov"], simulator.lyapunov())
    for key in ("time", "contacts", "path_length"):
        assert same(told[key], getattr(simulator, key))
    first = simulator.first_episode_statistics(outcome)
    assert first == {key: values[0] for key, values in told.items()}
    assert {type(value) for value in first.values()} == {bool, float, int}
    assert told["success"].any() and told["path_length"].min() > 1
    told["path_length"][:] = 0
    assert simulator.path_length.min() > 1
