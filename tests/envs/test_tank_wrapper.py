"""EnergyTankWrapper for PettingZoo and for vector environments: suites, periods, infos, memory."""

from __future__ import annotations

import copy
import pickle
import warnings

import numpy as np
import pytest
from conftest import five
from gymnasium.vector import AutoresetMode
from test_pettingzoo import api_suite
from test_wrappers import constant, draw, same

import rendezvous_env as rv
from rendezvous_env import vector

with warnings.catch_warnings():  # PettingZoo imports its own old modules here
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
    from pettingzoo.test.state_test import state_test
    from pettingzoo.utils.conversions import parallel_to_aec

KEYS = {"tank", "carried_out", "alignment", "lyapunov_rate"}
NUM_ENVS = 6
SCENARIOS = {
    "single": rv.Scenario(n_robots=4, spawn_size=3.0, time_limit=3.0),
    "space": rv.Scenario(n_robots=3, dim=3, spawn_size=3.0, time_limit=3.0),
    "unicycle": rv.Scenario(n_robots=3, robot_model="unicycle", spawn_size=2.0, time_limit=4.0),
    "clutter": rv.scenarios.get("clutter-8").replace(time_limit=4.0),
}


def make(kind="single_integrator-2d", *, changes=None, **options):
    scenario = five(kind, spawn_size=4.0, time_limit=8.0, **(changes or {}))
    return rv.EnergyTankWrapper(rv.parallel_env(scenario), **options)


# ---- the suites of PettingZoo --------------------------------------------------------------------


@api_suite
@pytest.mark.parametrize("options", [{}, {"decision_period": 3, "observe_level": True}])
def test_parallel_api(kind, options, capsys):
    parallel_api_test(make(kind, budget=1.0, **options), num_cycles=300)
    assert "Passed Parallel API test" in capsys.readouterr().out


@api_suite
@pytest.mark.parametrize("observe_level", [False, True])
def test_aec_api(kind, observe_level, capsys):
    env = make(kind, observe_level=observe_level)
    api_test(parallel_to_aec(env), num_cycles=100, verbose_progress=False)
    assert "Passed API test" in capsys.readouterr().out


@api_suite
def test_seeds(kind):
    parallel_seed_test(lambda: make(kind), num_cycles=100)
    first, second = (make(kind).reset(seed=seed)[0]["robot_0"] for seed in (1, 2))
    assert not np.array_equal(first, second)


def test_state_suite(kind):
    env = make(kind)
    state_test(parallel_to_aec(env), make(kind), num_cycles=20)
    np.testing.assert_array_equal(env.state_space.low, env.unwrapped.state_space.low)


@pytest.mark.parametrize("observe_level", [False, True])
def test_spaces_hold_what_is_seen_and_done(kind, observe_level):
    env = make(kind, budget=2.0, observe_level=observe_level)
    random, scenario = np.random.default_rng(0), env.unwrapped.scenario
    observations, _ = env.reset(seed=3)
    assert env.action_space("robot_0").shape == (scenario.action_size,)
    assert env.action_space("robot_0") is env.action_space("robot_0")
    rows, d = scenario.observation_layout.shape
    assert env.observation_space("robot_0").shape == (rows + observe_level, d)
    seen = 0
    while env.agents:
        for name, table in observations.items():
            assert env.observation_space(name).contains(table)
            assert env.observation_space(name).contains(env.observation_space(name).sample())
            seen += 1
        observations, *_ = env.step(draw(env, random))
    assert seen > 50


# ---- what is told --------------------------------------------------------------------------------


def test_infos_are_those_of_the_ledger(kind):
    env, random = make(kind, budget=0.5, frame="local"), np.random.default_rng(1)
    before, _ = env.reset(seed=2)
    layout, tau = env.unwrapped.scenario.observation_layout, env.unwrapped.scenario.tau
    levels, both = dict.fromkeys(env.agents, 0.5), set()
    while env.agents:
        places, frames = env.unwrapped.simulator.positions, env.unwrapped.simulator.frames
        after, _, ends, _, infos = env.step(draw(env, random))
        moved = np.einsum("nji,nj->ni", frames[0], (env.unwrapped.simulator.positions - places)[0])
        whole = not any(ends.values())
        for name, info in infos.items():
            i = env.unwrapped.index(name)
            assert set(info) >= KEYS and type(info["carried_out"]) is bool
            if whole:
                rate = -2 * layout.net_bearing(before[name]) @ moved[i] / tau
                assert info["lyapunov_rate"] == pytest.approx(rate, abs=1e-5)
                assert info["tank"] >= 0 and (info["carried_out"] or rate <= 1e-6)
            both.add(info["carried_out"])
        if whole:
            assert any(infos[name]["tank"] != levels[name] for name in infos)
        levels, before = {name: info["tank"] for name, info in infos.items()}, after
    assert both == {False, True}


@pytest.mark.parametrize("on_merge", ["remove", "follow"])
def test_a_survivor_has_the_tanks_of_both(on_merge):
    scenario = rv.Scenario(n_robots=3, graph="path", merge_radius=0.2, on_merge=on_merge)
    env = rv.EnergyTankWrapper(rv.parallel_env(scenario), budget=3.0)
    env.reset(seed=0, options={"positions": [[0.0, 0.0], [0.22, 0.0], [6.0, 0.0]]})
    wishes = constant(env, (0.0, 0.0)) | {"robot_0": np.array([0.5, 0.0], np.float32)}  # along f
    *_, infos = env.step(wishes)
    assert infos["robot_1"]["merged_into"] == 0 and infos["robot_1"]["tank"] == 0.0
    assert infos["robot_0"]["tank"] > 5.5 and 2.9 < infos["robot_2"]["tank"] < 3.5
    assert len(env.agents) == (2 if on_merge == "remove" else 3)
    *_, infos = env.step(constant(env, (0.0, 0.0)))
    assert infos["robot_0"]["tank"] > 5.5
    if on_merge == "follow":
        assert infos["robot_1"]["tank"] == 0.0 and not infos["robot_1"]["carried_out"]


def test_a_wall_along_f_fills_no_tank():
    scenario = rv.Scenario(
        n_robots=2,
        start_positions=((-2.0, 0.0), (2.0, 0.0)),
        obstacles=(rv.Disc(centre=(0.0, 0.0), radius=1.99),),
    )
    env = rv.EnergyTankWrapper(rv.parallel_env(scenario))
    env.reset(seed=0)
    for _ in range(5):
        *_, infos = env.step(constant(env, (1.0, 0.0)))  # along f
        assert all(info["contact"] and info["tank"] == 0.0 for info in infos.values())
    *_, infos = env.step(constant(env, (-1.0, 0.0)))
    assert not any(info["carried_out"] for info in infos.values())


def test_the_level_seen_is_the_level_told():
    env, random = make(budget=0.3, observe_level=True), np.random.default_rng(0)
    scenario = env.unwrapped.scenario
    unit = scenario.merge_radius * scenario.max_degree
    observations, _ = env.reset(seed=1)
    assert observations["robot_3"][-1] == pytest.approx([0.3 / unit, 0.0])
    for _ in range(10):
        observations, *_, infos = env.step(draw(env, random))
        for name, rows in observations.items():
            assert rows[-1] == pytest.approx([infos[name]["tank"] / unit, 0.0], rel=1e-6)


# ---- decision period -----------------------------------------------------------------------------


def test_a_period_is_that_many_base_steps_with_the_wish_held(kind):
    scenario = five(kind, spawn_size=3.0, time_limit=5.0)
    options = {"budget": 0.4, "frame": "local"}
    env = rv.EnergyTankWrapper(rv.parallel_env(scenario), decision_period=4, **options)
    single = rv.EnergyTankWrapper(rv.parallel_env(scenario), **options)
    env.reset(seed=8)
    single.reset(seed=8)
    wish, steps = draw(env, np.random.default_rng(5)), 0
    while env.agents:
        alive = env.agents.copy()
        result = env.step({name: wish[name] for name in alive})
        told, rewards = [{} for _ in result], dict.fromkeys(alive, 0.0)
        for _ in range(4):
            if single.agents:
                part = single.step({name: wish[name] for name in single.agents})
                for known, new in zip(told, part, strict=True):
                    known |= new
                rewards = {name: rewards[name] + part[1].get(name, 0.0) for name in alive}
        assert result[1] == pytest.approx(rewards, abs=1e-12)
        assert all(same(result[k], told[k]) for k in (0, 2, 3, 4))
        np.testing.assert_array_equal(env.tank.levels, single.tank.levels)
        steps += 1
    assert steps > 3 and not single.agents


# ---- memory --------------------------------------------------------------------------------------


def test_state_pickle_and_deepcopy_go_on_alike(kind):
    options = {"decision_period": 2, "budget": 1.0, "observe_level": True}
    env, random = make(kind, **options), np.random.default_rng(0)
    env.reset(seed=3)
    for _ in range(6):
        env.step(draw(env, random))
    fresh = make(kind, **options)
    fresh.set_state(env.get_state())
    copies = [fresh, copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    compared = 0
    while env.agents and compared < 30:
        wish = draw(env, random)
        result = env.step(wish)
        for other in copies:
            assert all(same(a, b) for a, b in zip(result, other.step(wish), strict=True))
            assert same(env.get_state(), other.get_state())
        compared += 1
    assert compared > 5


def test_a_reset_fills_the_tanks_anew(kind):
    env, fresh = make(kind, budget=0.2), make(kind, budget=0.2)
    random = np.random.default_rng(0)
    env.reset(seed=1)
    for _ in range(5):
        env.step(draw(env, random))
    assert (env.tank.levels != 0.2).any()
    observations, _ = env.reset(seed=9)
    again, _ = fresh.reset(seed=9)
    assert same(observations, again) and same(env.get_state(), fresh.get_state())


def test_a_refused_state_leaves_the_tanks_alone():
    for env in (make(budget=1.0), vector.EnergyTankWrapper(rv.make_vec("duo", 2), budget=1.0)):
        env.reset(seed=0)
        state, levels = env.get_state(), env.tank.levels
        foreign = {**state["tank"], "levels": levels + 1}
        with pytest.raises(ValueError, match="observed"):
            env.set_state({**state, "tank": foreign, "observed": np.zeros(3)})
        with pytest.raises(ValueError, match="levels"):
            env.set_state({**state, "tank": {**state["tank"], "levels": -levels}})
        np.testing.assert_array_equal(env.tank.levels, levels)
        env.set_state({**state, "tank": foreign})
        np.testing.assert_array_equal(env.tank.levels, levels + 1)


# ---- vector environments -------------------------------------------------------------------------


def tape(venv, length, seed=0):
    shape = (length, *venv.action_space.shape)
    return np.random.default_rng(seed).uniform(-1, 1, shape).astype(np.float32)


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("period", [1, 3])
def test_every_transition_equals_the_pettingzoo_wrapper(name, period):
    scenario = SCENARIOS[name]
    options = {"budget": 0.3, "decision_period": period, "observe_level": True}
    venv = rv.make_vec(scenario, NUM_ENVS, autoreset_mode=AutoresetMode.DISABLED)
    venv = vector.EnergyTankWrapper(venv, **options)
    singles = [rv.EnergyTankWrapper(rv.parallel_env(scenario), **options) for _ in range(NUM_ENVS)]
    seen, _ = venv.reset(seed=7)
    for team, env in enumerate(singles):
        assert same(env.reset(seed=7 + team)[0]["robot_0"], seen[team, 0])
    compared = 0
    for wishes in tape(venv, 1 + scenario.max_steps // period):
        seen, _, terminations, truncations, infos = venv.step(wishes)
        for team, env in enumerate(singles):
            if not env.agents:
                continue
            step = env.step({agent: wishes[team, int(agent[6:])] for agent in env.agents})
            for agent, told in step[4].items():
                i = int(agent[6:])
                # of who ends within a period arrays tell the last step, names the last one lived
                keys = KEYS if period == 1 or agent in env.agents else {"tank"}
                told_in_array = {key: infos[key][team, i].item() for key in keys}
                assert same(told_in_array, {key: told[key] for key in keys})
                assert same(step[0][agent], seen[team, i])
            assert bool(terminations[team] or truncations[team]) == (not env.agents)
            compared += 1
    assert compared > NUM_ENVS and not any(env.agents for env in singles)
    for team, env in enumerate(singles):  # tanks of teams that have ended rest
        np.testing.assert_array_equal(venv.tank.levels[team], env.tank.levels[0])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_new_episode_begins_with_the_next_start_and_the_budget(mode):
    scenario = rv.Scenario(n_robots=3, spawn_size=3.0)
    options = {"budget": 0.7, "observe_level": True}
    teams = rv.make_vec(scenario, NUM_ENVS, autoreset_mode=mode, max_cycles=4)
    venv = vector.EnergyTankWrapper(teams, decision_period=2, **options)
    other = vector.EnergyTankWrapper(rv.make_vec(scenario, NUM_ENVS), **options)
    venv.reset(seed=1)
    other.reset(seed=1)
    second, _ = other.reset()
    actions = tape(venv, 3)
    venv.step(actions[0])
    seen, _, _, truncations, infos = venv.step(actions[1])
    assert truncations.all()
    if mode is AutoresetMode.NEXT_STEP:
        assert (infos["tank"] != 0.7).any() and infos["_summary"].all()
        seen, rewards, _, truncations, infos = venv.step(actions[2])
        assert not rewards.any() and not truncations.any()
    else:
        final = infos["final_info"]
        assert (final["tank"] != 0.7).any()
        assert not np.array_equal(infos["final_obs"][0], seen[0])
    np.testing.assert_array_equal(seen, second)
    assert (venv.tank.levels == 0.7).all() and (infos["tank"] == 0.7).all()
    assert np.isnan(infos["alignment"]).all() and not infos["carried_out"].any()


def test_memory_survives_state_pickle_and_deepcopy():
    def fresh():
        teams = rv.make_vec("clutter-8", NUM_ENVS)
        return vector.EnergyTankWrapper(teams, budget=1.0, decision_period=2)

    venv = fresh()
    venv.reset(seed=3)
    actions = tape(venv, 12)
    for wishes in actions[:6]:
        venv.step(wishes)
    restored = fresh()
    restored.set_state(venv.get_state())
    copies = [restored, copy.deepcopy(venv), pickle.loads(pickle.dumps(venv))]
    for wishes in actions[6:]:
        seen, rewards, *_ = venv.step(wishes)
        for other in copies:
            other_seen, other_rewards, *_ = other.step(wishes)
            np.testing.assert_array_equal(seen, other_seen)
            np.testing.assert_array_equal(rewards, other_rewards)
            np.testing.assert_array_equal(venv.tank.levels, other.tank.levels)


def test_teams_of_a_mask_begin_anew_alone():
    venv = vector.EnergyTankWrapper(rv.make_vec("fig3", 3), budget=0.5)
    venv.reset(seed=0)
    for wishes in tape(venv, 5):
        venv.step(wishes)
    before = venv.tank.levels
    venv.reset(options={"reset_mask": np.array([False, True, False])})
    assert (venv.tank.levels[1] == 0.5).all() and (before != 0.5).all()
    np.testing.assert_array_equal(venv.tank.levels[[0, 2]], before[[0, 2]])


def test_bad_wishes_change_nothing():
    venv = vector.EnergyTankWrapper(rv.make_vec("duo", NUM_ENVS), budget=1.0)
    venv.reset(seed=0)
    wishes, before = tape(venv, 1)[0], venv.get_state()
    wishes[4, 1, 0] = np.nan
    for wrong, message in ((wishes, "robot_1 in team 4"), (wishes[:2], "shape")):
        with pytest.raises(ValueError, match=message):
            venv.step(wrong)
    assert same(venv.get_state(), before)


# ---- refusals ------------------------------------------------------------------------------------

WRAPS = {
    "PettingZoo": lambda **options: rv.EnergyTankWrapper(rv.parallel_env("duo"), **options),
    "vector": lambda **options: vector.EnergyTankWrapper(rv.make_vec("duo", 1), **options),
}


@pytest.mark.parametrize("wrap", WRAPS.values(), ids=WRAPS)
@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("budget", -1.0), ("budget", np.nan), ("budget", "1"), ("budget", None),
        ("min_alignment", 0.0), ("min_alignment", 1.0), ("min_alignment", None),
        ("frame", "global"), ("frame", 5), ("decision_period", 0), ("decision_period", 1.5),
        ("observe_level", 1), ("observe_level", "no"),
    ],
)  # fmt: skip
def test_arguments_are_checked(wrap, field, value):
    with pytest.raises(ValueError, match=f"{field} is .*; it must"):
        wrap(**{field: value})


@pytest.mark.parametrize("wrap", WRAPS.values(), ids=WRAPS)
def test_unknown_arguments_are_a_type_error(wrap):
    with pytest.raises(TypeError, match="max_turn_rate"):
        wrap(max_turn_rate=3.0)


def test_only_environments_of_ours_are_wrapped():
    with pytest.raises(TypeError, match=r"rendezvous_env\.vector\.EnergyTankWrapper"):
        rv.EnergyTankWrapper(rv.make_vec("duo", 1))
    with pytest.raises(TypeError, match=r"take rendezvous_env\.EnergyTankWrapper"):
        vector.EnergyTankWrapper(rv.parallel_env("duo"))
    with pytest.raises(ValueError, match="scenario has double_integrator robots"):
        rv.EnergyTankWrapper(rv.parallel_env(rv.Scenario(robot_model="double_integrator")))
