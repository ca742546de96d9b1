"""GainWrapper and LinkKeepingWrapper for PettingZoo and for vector environments."""

from __future__ import annotations

import copy
import pickle
import warnings

import numpy as np
import pytest
from conftest import five
from gymnasium.vector import AutoresetMode
from test_pettingzoo import api_suite
from test_wrappers import draw, same

import rendezvous_env as rv
from rendezvous_env import vector

with warnings.catch_warnings():  # PettingZoo imports its own old modules here
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
    from pettingzoo.test.state_test import state_test
    from pettingzoo.utils.conversions import parallel_to_aec

NUM_ENVS = 4
WRAPPERS = {
    "gains": (rv.GainWrapper, vector.GainWrapper),
    "links": (rv.LinkKeepingWrapper, vector.LinkKeepingWrapper),
}
KEYS = {
    "gains": {"gain", "alignment", "lyapunov_rate"},
    "links": {"alignment", "lyapunov_rate"},
}
OTHER = {
    "gains": {"min_gain": 0.3, "max_gain": 2.0},
    "links": {"share": 0.2, "bearing_error": 0.05},
}


@pytest.fixture(params=WRAPPERS)
def which(request):
    """Gains or links."""
    return request.param


def make(which, dim=2, **options):
    scenario = five(f"single_integrator-{dim}d", spawn_size=3.0, time_limit=5.0)
    return WRAPPERS[which][0](rv.parallel_env(scenario), **options)


def make_vec(which, scenario, num_envs=NUM_ENVS, mode=AutoresetMode.NEXT_STEP, **options):
    teams = rv.make_vec(scenario, num_envs, autoreset_mode=mode)
    return WRAPPERS[which][1](teams, **options)


def tape(venv, length, seed=0):
    space = venv.action_space
    shape = (length, *space.shape)
    random = np.random.default_rng(seed)
    return random.uniform(space.low, space.high, shape).astype(np.float32)


# ---- the suites of PettingZoo --------------------------------------------------------------------


@api_suite
@pytest.mark.parametrize("dim", [2, 3])
def test_parallel_api(which, dim, capsys):
    parallel_api_test(make(which, dim, decision_period=2, **OTHER[which]), num_cycles=200)
    assert "Passed Parallel API test" in capsys.readouterr().out


@api_suite
def test_aec_api(which, capsys):
    api_test(parallel_to_aec(make(which)), num_cycles=60, verbose_progress=False)
    assert "Passed API test" in capsys.readouterr().out


@api_suite
def test_seeds(which):
    parallel_seed_test(lambda: make(which), num_cycles=60)
    first, second = (make(which).reset(seed=seed)[0]["robot_0"] for seed in (1, 2))
    assert not np.array_equal(first, second)


def test_state_suite(which):
    state_test(parallel_to_aec(make(which)), make(which), num_cycles=20)


@pytest.mark.parametrize("frame", ["net_bearing", "local"])
def test_spaces_hold_what_is_seen_and_done(which, frame):
    env, seen = make(which, frame=frame), 0
    layout = env.unwrapped.scenario.observation_layout
    observations, _ = env.reset(seed=3)
    space = env.action_space("robot_0")
    assert space is env.action_space("robot_0") and (space.high == 1).all()
    assert space.shape == ((layout.neighbour_slots,) if which == "gains" else (2,))
    assert (space.low == (0 if which == "gains" else -1)).all()
    while env.agents:
        for name, table in observations.items():
            assert env.observation_space(name).shape == layout.shape
            assert env.observation_space(name).contains(table)
            seen += 1
        actions = {name: env.action_space(name).sample() for name in env.agents}
        observations, *_, infos = env.step(actions)
        assert all(set(info) >= KEYS[which] for info in infos.values())
    assert seen > 30


# ---- what is done and told -----------------------------------------------------------------------


def test_weights_are_of_rows_in_either_frame():
    """They are numbers, not vectors: a frame turns what is seen and nothing else."""
    envs = [make("gains", frame=frame) for frame in ("net_bearing", "local")]
    for env in envs:
        env.reset(seed=4)
    random = np.random.default_rng(1)
    for _ in range(10):
        choice = {a: random.random(4).astype(np.float32) for a in envs[0].agents}
        infos = [env.step(choice)[4] for env in envs]
        assert same(*infos)
    first, second = (env.unwrapped.simulator.positions for env in envs)
    np.testing.assert_array_equal(first, second)


def test_wishes_are_turned_with_the_frame():
    envs = [make("links", frame=frame) for frame in ("net_bearing", "local")]
    (turned, _), (local, _) = (env.reset(seed=4) for env in envs)
    layout = envs[0].unwrapped.scenario.observation_layout
    assert not same(turned, local)
    for name in envs[0].agents:
        f = layout.net_bearing(local[name])
        strength = np.linalg.norm(f)
        assert layout.net_bearing(turned[name]) == pytest.approx([strength, 0.0], abs=1e-6)
    ahead = {name: np.array([1.0, 0.0], np.float32) for name in envs[0].agents}
    along = {}
    for name in envs[1].agents:
        f = layout.net_bearing(local[name])
        along[name] = (f / np.linalg.norm(f)).astype(np.float32)
    envs[0].step(ahead)
    envs[1].step(along)
    first, second = (env.unwrapped.simulator.positions for env in envs)
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_rates_are_those_of_the_motion(which):
    env, random = make(which, frame="local"), np.random.default_rng(1)
    before, _ = env.reset(seed=2)
    layout, tau = env.unwrapped.scenario.observation_layout, env.unwrapped.scenario.tau
    compared = 0
    while env.agents:
        places, frames = env.unwrapped.simulator.positions, env.unwrapped.simulator.frames
        choice = draw(env, random)
        after, _, ends, _, infos = env.step({name: abs(choice[name]) for name in env.agents})
        moved = np.einsum("nji,nj->ni", frames[0], (env.unwrapped.simulator.positions - places)[0])
        for name, info in infos.items() if not any(ends.values()) else ():
            rate = -2 * layout.net_bearing(before[name]) @ moved[env.unwrapped.index(name)] / tau
            assert info["lyapunov_rate"] == pytest.approx(rate, abs=1e-5)
            compared += 1
        before = after
    assert compared > 20


# ---- memory --------------------------------------------------------------------------------------


def test_state_pickle_and_deepcopy_go_on_alike(which):
    options = OTHER[which] | {"decision_period": 2}
    env, random = make(which, **options), np.random.default_rng(0)
    env.reset(seed=3)
    for _ in range(3):
        env.step(draw(env, random))
    fresh = make(which, **options)
    fresh.set_state(env.get_state())
    copies = [fresh, copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    compared = 0
    while env.agents and compared < 15:
        choice = draw(env, random)
        result = env.step(choice)
        for other in copies:
            assert all(same(a, b) for a, b in zip(result, other.step(choice), strict=True))
            assert same(env.get_state(), other.get_state())
        compared += 1
    assert compared > 4


# ---- vector environments -------------------------------------------------------------------------


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("period", [1, 3])
def test_every_transition_equals_the_pettingzoo_wrapper(which, dim, period):
    scenario = rv.Scenario(n_robots=4, dim=dim, spawn_size=3.0, time_limit=2.0)
    options = OTHER[which] | {"decision_period": period}
    venv = make_vec(which, scenario, mode=AutoresetMode.DISABLED, **options)
    singles = [WRAPPERS[which][0](rv.parallel_env(scenario), **options) for _ in range(NUM_ENVS)]
    seen, _ = venv.reset(seed=7)
    for team, env in enumerate(singles):
        assert same(env.reset(seed=7 + team)[0]["robot_0"], seen[team, 0])
    compared = 0
    for choices in tape(venv, 1 + scenario.max_steps // period):
        seen, _, terminations, truncations, infos = venv.step(choices)
        for team, env in enumerate(singles):
            if not env.agents:
                continue
            step = env.step({agent: choices[team, int(agent[6:])] for agent in env.agents})
            for agent, told in step[4].items():
                i = int(agent[6:])
                if period == 1 or agent in env.agents:
                    in_array = {key: infos[key][team, i].item() for key in KEYS[which]}
                    assert same(in_array, {key: told[key] for key in KEYS[which]})
                assert same(step[0][agent], seen[team, i])
            assert bool(terminations[team] or truncations[team]) == (not env.agents)
            compared += 1
    assert compared > NUM_ENVS and not any(env.agents for env in singles)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_new_episode_begins_with_the_next_start(which, mode):
    scenario = rv.Scenario(n_robots=3, spawn_size=3.0, time_limit=0.4)
    venv = make_vec(which, scenario, mode=mode)
    other = make_vec(which, scenario)
    venv.reset(seed=1)
    other.reset(seed=1)
    second, _ = other.reset()
    ended = False
    for choices in tape(venv, scenario.max_steps):
        seen, _, _, truncations, infos = venv.step(choices)
        ended = truncations.all()
    assert ended
    if mode is AutoresetMode.NEXT_STEP:
        seen, _, _, truncations, infos = venv.step(tape(venv, 1)[0])
    np.testing.assert_array_equal(seen, second)
    assert np.isnan(infos["alignment"]).all() and not infos["lyapunov_rate"].any()
    if which == "gains":
        assert not infos["gain"].any()


def test_vector_memory_survives_state_and_pickle(which):
    scenario = rv.Scenario(n_robots=3, spawn_size=3.0)
    venv = make_vec(which, scenario, decision_period=2)
    venv.reset(seed=3)
    actions = tape(venv, 8)
    for choices in actions[:4]:
        venv.step(choices)
    restored = make_vec(which, scenario, decision_period=2)
    restored.set_state(venv.get_state())
    copies = [restored, pickle.loads(pickle.dumps(venv))]
    for choices in actions[4:]:
        seen, rewards, *_ = venv.step(choices)
        for other in copies:
            other_seen, other_rewards, *_ = other.step(choices)
            np.testing.assert_array_equal(seen, other_seen)
            np.testing.assert_array_equal(rewards, other_rewards)


def test_bad_choices_change_nothing(which):
    venv = make_vec(which, "duo")
    venv.reset(seed=0)
    choices, before = tape(venv, 1)[0], venv.get_state()
    choices[3, 1, 0] = np.nan
    for wrong, message in ((choices, "robot_1 in team 3"), (choices[:2], "shape")):
        with pytest.raises(ValueError, match=message):
            venv.step(wrong)
    assert same(venv.get_state(), before)


# ---- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("which", "options"),
    [
        ("gains", {"min_gain": -1.0}), ("gains", {"max_gain": np.inf}), ("gains", {"frame": "f"}),
        ("gains", {"decision_period": 0}), ("links", {"share": 0}), ("links", {"share": "all"}),
        ("links", {"bearing_error": 2.0}), ("links", {"frame": None}),
        ("links", {"decision_period": 1.5}),
    ],
)  # fmt: skip
def test_arguments_are_checked(which, options):
    (field,) = options
    for wrap in (lambda: make(which, **options), lambda: make_vec(which, "duo", **options)):
        with pytest.raises(ValueError, match=f"{field} is .*; it must"):
            wrap()


def test_only_environments_of_ours_are_wrapped(which):
    single, several = WRAPPERS[which]
    name = single.__name__
    with pytest.raises(TypeError, match=rf"rendezvous_env\.vector\.{name}"):
        single(rv.make_vec("duo", 1))
    with pytest.raises(TypeError, match=rf"take rendezvous_env\.{name}"):
        several(rv.parallel_env("duo"))
    with pytest.raises(ValueError, match="scenario has unicycle robots"):
        single(rv.parallel_env(rv.Scenario(robot_model="unicycle")))
