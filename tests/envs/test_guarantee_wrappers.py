"""All guarantee wrappers alike: API suites, spaces, memory, one world as the other, refusals."""

from __future__ import annotations

import copy
import itertools
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from guarantees import GUARANTEES, NAMES, api_suite, draw, make, same, tape, which_and_kind
from gymnasium.vector import AutoresetMode
from pettingzoo.utils.wrappers import BaseParallelWrapper

import rendezvous_env as rv
from rendezvous_env.envs.gymnasium_env import make_env

with warnings.catch_warnings():  # PettingZoo imports its own old modules here
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
    from pettingzoo.test.state_test import state_test
    from pettingzoo.utils.conversions import parallel_to_aec

NUM_ENVS = 6
SCENARIOS = {
    "single": rv.Scenario(n_robots=4, spawn_size=3.0, time_limit=2.0),
    "space": rv.Scenario(n_robots=3, dim=3, spawn_size=3.0, time_limit=2.0),
    "unicycle": rv.Scenario(n_robots=3, robot_model="unicycle", spawn_size=2.0, time_limit=4.0),
    "clutter": rv.scenarios.get("clutter-8").replace(time_limit=4.0),
}


@pytest.fixture(params=GUARANTEES)
def which(request):
    """Each of the guarantees."""
    return request.param


def make_vec(which, scenario="duo", mode=AutoresetMode.NEXT_STEP, max_cycles=None, **options):
    teams = rv.make_vec(scenario, NUM_ENVS, autoreset_mode=mode, max_cycles=max_cycles)
    return GUARANTEES[which].around_teams(teams, **options)


# ---- the suites of PettingZoo --------------------------------------------------------------------


@api_suite
@which_and_kind
def test_pettingzoo_is_content(which, kind, capsys):
    options = GUARANTEES[which].options
    parallel_api_test(make(which, kind, decision_period=3, **options), num_cycles=300)
    assert "Passed Parallel API test" in capsys.readouterr().out
    env = make(which, kind, **options)
    api_test(parallel_to_aec(env), num_cycles=60, verbose_progress=False)
    assert "Passed API test" in capsys.readouterr().out
    state_test(parallel_to_aec(env), make(which, kind), num_cycles=20)
    np.testing.assert_array_equal(env.state_space.low, env.unwrapped.state_space.low)


@api_suite
@which_and_kind
def test_seeds(which, kind):
    parallel_seed_test(lambda: make(which, kind), num_cycles=60)
    first, second = (make(which, kind).reset(seed=seed)[0]["robot_0"] for seed in (1, 2))
    assert not np.array_equal(first, second)


@which_and_kind
@pytest.mark.parametrize("frame", ["net_bearing", "local"])
def test_spaces_hold_what_is_seen_and_done(which, kind, frame):
    env, random = (
        make(which, kind, frame=frame, **GUARANTEES[which].options),
        np.random.default_rng(0),
    )
    scenario = env.unwrapped.scenario
    rows, d = scenario.observation_layout.shape
    sizes = {"heading": d - scenario.model.nonholonomic, "tank": scenario.action_size, "gains": 4}
    sees, does = env.observation_space("robot_0"), env.action_space("robot_0")
    assert sees.shape == (rows + (which == "tank"), d) and sees.contains(sees.sample())
    assert does.shape == (sizes.get(which, d),) and does is env.action_space("robot_0")
    assert (does.low == (0 if which == "gains" else -1)).all() and (does.high == 1).all()
    observations, _ = env.reset(seed=3)
    seen = 0
    while env.agents:
        for name, table in observations.items():
            assert env.observation_space(name).contains(table)
            seen += 1
        observations, *_, infos = env.step(draw(env, random))
        assert all(set(info) >= GUARANTEES[which].told for info in infos.values())
    assert seen > 50


# ---- memory --------------------------------------------------------------------------------------


@which_and_kind
def test_state_pickle_and_deepcopy_go_on_alike(which, kind):
    options = GUARANTEES[which].options | {"decision_period": 2}
    env, random = make(which, kind, **options), np.random.default_rng(0)
    env.reset(seed=3)
    for _ in range(3):
        env.step(draw(env, random))
    state = env.get_state()
    kept, fresh = copy.deepcopy(state), make(which, kind, **options)
    fresh.set_state(state)
    copies = [fresh, copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    compared = 0
    while env.agents and compared < 15:
        choices = draw(env, random)
        result = env.step(choices)
        for other in copies:
            assert all(same(a, b) for a, b in zip(result, other.step(choices), strict=True))
            assert same(env.get_state(), other.get_state())
        compared += 1
    assert compared > 4 and same(state, kept)


def test_vector_memory_survives_state_pickle_and_deepcopy(which):
    scenario = "clutter-8" if GUARANTEES[which].anywhere else rv.Scenario(n_robots=3)
    options = GUARANTEES[which].options | {"decision_period": 2}
    venv = make_vec(which, scenario, **options)
    venv.reset(seed=3)
    actions = tape(venv, 10)
    for choices in actions[:5]:
        venv.step(choices)
    restored = make_vec(which, scenario, **options)
    restored.set_state(venv.get_state())
    copies = [restored, copy.deepcopy(venv), pickle.loads(pickle.dumps(venv))]
    for choices in actions[5:]:
        seen, rewards, *_ = venv.step(choices)
        for other in copies:
            other_seen, other_rewards, *_ = other.step(choices)
            np.testing.assert_array_equal(seen, other_seen)
            np.testing.assert_array_equal(rewards, other_rewards)
            assert same(venv.get_state(), other.get_state())


@which_and_kind
def test_a_reset_forgets_what_was(which, kind):
    options = GUARANTEES[which].options
    env, fresh = make(which, kind, **options), make(which, kind, **options)
    random = np.random.default_rng(0)
    env.reset(seed=1)
    for _ in range(5):
        env.step(draw(env, random))
    observations, _ = env.reset(seed=9)
    again, _ = fresh.reset(seed=9)
    assert same(observations, again) and same(env.get_state(), fresh.get_state())


def test_a_state_that_does_not_fit_is_refused_and_changes_nothing(which):
    for env, other in ((make(which), make(which, changes={"n_robots": 4, "graph": "complete"})),
                       (make_vec(which), make_vec(which, "fig3"))):  # fmt: skip
        env.reset(seed=0)
        other.reset(seed=0)
        before = env.get_state()
        with pytest.raises(ValueError, match="observed must be an array of shape"):
            env.set_state(other.get_state())
        broken = env.get_state()
        broken["env"].get("simulator", broken["env"]).pop("weights")
        memory = broken[env.filter.state_key]
        broken[env.filter.state_key] = {key: array + 1.0 for key, array in memory.items()}
        with pytest.raises(ValueError, match=r"weights|frames"):
            env.set_state(broken)
        assert same(before, env.get_state())


# ---- vector environments -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("which", "name"),
    [
        *itertools.product(("heading", "tank"), SCENARIOS),
        *itertools.product(("gains", "links"), ("single", "space")),
    ],
)
@pytest.mark.parametrize("period", [1, 3])
def test_every_transition_equals_the_pettingzoo_wrapper(which, name, period):
    guarantee, scenario = GUARANTEES[which], SCENARIOS[name]
    options = guarantee.options | {"decision_period": period}
    venv = make_vec(which, scenario, AutoresetMode.DISABLED, **options)
    singles = [guarantee.around(rv.parallel_env(scenario), **options) for _ in range(NUM_ENVS)]
    seen, _ = venv.reset(seed=7)
    for team, env in enumerate(singles):
        assert same(env.reset(seed=7 + team)[0]["robot_0"], seen[team, 0])
    compared = 0
    for choices in tape(venv, 1 + scenario.max_steps // period):
        seen, rewards, terminations, truncations, infos = venv.step(choices)
        for team, env in enumerate(singles):
            if not env.agents:
                continue
            step = env.step({agent: choices[team, int(agent[6:])] for agent in env.agents})
            for agent, told in step[4].items():
                i = int(agent[6:])
                # of who ends within a period arrays tell the last step, names the last one lived
                lives = period == 1 or agent in env.agents
                keys = guarantee.told if lives else guarantee.told & {"tank"}
                assert same({key: infos[key][team, i].item() for key in keys},
                            {key: told[key] for key in keys})  # fmt: skip
                assert same(step[0][agent], seen[team, i])
            assert rewards[team] == pytest.approx(step[1]["robot_0"], abs=1e-12)
            assert truncations[team] == any(step[3].values())
            assert bool(terminations[team] or truncations[team]) == (not env.agents)
            compared += 1
    assert compared > NUM_ENVS and not any(env.agents for env in singles)
    if which == "tank":  # tanks of teams that have ended rest
        for team, env in enumerate(singles):
            np.testing.assert_array_equal(venv.tank.levels[team], env.tank.levels[0])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_new_episode_begins_with_the_next_start_and_nothing_remembered(which, mode):
    scenario = rv.Scenario(n_robots=3, spawn_size=3.0)
    options = GUARANTEES[which].options | {"decision_period": 2}
    venv, other = (
        make_vec(which, scenario, mode, 4, **options),
        make_vec(which, scenario, **options),
    )
    venv.reset(seed=1)
    other.reset(seed=1)
    second, _ = other.reset()
    actions = tape(venv, 3)
    venv.step(actions[0])
    seen, _, _, truncations, infos = venv.step(actions[1])
    assert truncations.all()
    if mode is AutoresetMode.NEXT_STEP:
        assert infos["_summary"].all() and not np.isnan(infos["alignment"]).any()
        seen, rewards, _, truncations, infos = venv.step(actions[2])
        assert not rewards.any() and not truncations.any()
    else:
        assert infos["_final_obs"].all() and not np.array_equal(infos["final_obs"][0], seen[0])
        assert not np.isnan(infos["final_info"]["alignment"]).any()
    np.testing.assert_array_equal(seen, second)
    assert same(venv.filter.get_state(), other.filter.get_state())
    assert np.isnan(infos["alignment"]).all() and not infos["lyapunov_rate"].any()
    assert which != "gains" or not infos["gain"].any()
    assert which != "tank" or ((infos["tank"] == 0.3).all() and not infos["carried_out"].any())


# ---- bad choices and arguments -------------------------------------------------------------------

BAD_CHOICES = {
    "NaN": (lambda raw: raw | {"robot_2": raw["robot_2"] * np.nan}, ValueError, "robot_2"),
    "inf": (lambda raw: raw | {"robot_0": raw["robot_0"] + np.inf}, ValueError, "robot_0"),
    "wrong shape": (lambda raw: raw | {"robot_1": np.zeros(7)}, ValueError, "robot_1"),
    "a word": (lambda raw: raw | {"robot_1": "left"}, ValueError, "robot_1"),
    "missing": (lambda raw: {k: v for k, v in raw.items() if k != "robot_3"}, KeyError, "robot_3"),
    "unknown": (lambda raw: raw | {"robot_9": raw["robot_0"]}, KeyError, "robot_9"),
}


@pytest.mark.parametrize("wrong", BAD_CHOICES)
def test_bad_choices_are_refused_by_name_and_change_nothing(which, wrong):
    spoil, error, name = BAD_CHOICES[wrong]
    env, random = make(which), np.random.default_rng(0)
    env.reset(seed=0)
    env.step(draw(env, random))
    before = env.get_state()
    with pytest.raises(error, match=name):
        env.step(spoil(draw(env, random)))
    assert same(before, env.get_state())


def test_bad_tables_of_choices_change_nothing(which):
    venv = make_vec(which)
    venv.reset(seed=0)
    choices, before = tape(venv, 1)[0], venv.get_state()
    choices[3, 1, 0] = np.nan
    for wrong, message in ((choices, "robot_1 in team 3"), (choices[:2], "shape")):
        with pytest.raises(ValueError, match=message):
            venv.step(wrong)
    assert same(venv.get_state(), before)


@pytest.mark.parametrize(
    ("which", "field", "values"),
    [
        ("heading", "min_alignment", (0.0, 5e-324, 9e-7, 1.0, np.nan)),
        ("heading", "max_turn_rate", (0.0, np.inf)),
        ("tank", "budget", (-1.0, np.nan, "1", None)),
        ("tank", "min_alignment", (0.0, 1e-200, 9e-7, 1.0, None)),
        ("tank", "observe_level", (1, "no")),
        ("gains", "min_gain", (-1.0,)),
        ("gains", "max_gain", (np.inf,)),
        ("links", "share", (0, "all")),
        ("links", "bearing_error", (2.0,)),
        *((which, "frame", ("global", 5, None)) for which in GUARANTEES),
        *((which, "decision_period", (0, 1.5, 2.0, True)) for which in GUARANTEES),
    ],
)
def test_arguments_are_checked(which, field, values):
    for value in values:
        for wrap in (make, make_vec):
            with pytest.raises(ValueError, match=f"{field} is .*; it must"):
                wrap(which, **{field: value})


def test_the_smallest_margin_is_a_millionth():
    for which in ("heading", "tank"):
        assert make(which, min_alignment=1e-6) and make_vec(which, min_alignment=1e-6)
    for margin in (0.0, 5e-324, 1e-200, 9e-7):
        with pytest.raises(ValueError, match="at least 1e-06"):
            rv.certified_heading(
                [1, 0], [1, 0], [1, 0], min_alignment=margin, dead_zone=1, max_turn=1
            )


# ---- what may be wrapped -------------------------------------------------------------------------


def one_team():
    return rv.parallel_env("ring-12")


def teams(**options):
    return rv.make_vec("ring-12", num_envs=2, **options)


def test_only_environments_of_ours_are_wrapped(which):
    guarantee = GUARANTEES[which]
    with pytest.raises(TypeError, match=rf"RendezvousVectorEnv.*vector\.{guarantee.name}"):
        guarantee.around(teams())
    with pytest.raises(TypeError, match=rf"take rendezvous_env\.{guarantee.name}"):
        guarantee.around_teams(one_team())
    for wrap in (guarantee.around, guarantee.around_teams):
        with pytest.raises(TypeError, match="RendezvousEnv"):
            wrap(make_env("ring-12"))
    for wrap, home in ((guarantee.around, rv), (guarantee.around_teams, rv.vector)):
        with pytest.raises(TypeError):  # it has a guarantee already
            wrap(home.training_env("ring-12"))


@pytest.mark.parametrize(
    ("which", "model"),
    [("tank", "double_integrator"), ("gains", "unicycle"), ("links", "unicycle")],
)
def test_robots_that_a_theorem_does_not_cover_are_refused(which, model):
    with pytest.raises(ValueError, match=f"scenario has {model} robots"):
        GUARANTEES[which].around(rv.parallel_env(rv.Scenario(robot_model=model)))


@pytest.mark.parametrize("lower", NAMES)
@pytest.mark.parametrize("upper", NAMES)
def test_a_guarantee_is_not_put_upon_another(upper, lower):
    for home, env in ((rv, one_team()), (rv.vector, teams())):
        with pytest.raises(TypeError, match=rf"{lower}.*{upper}"):
            getattr(home, upper)(getattr(home, lower)(env))
    with pytest.raises(TypeError, match=rf"{lower}.*{upper}"):
        getattr(rv, upper)(BaseParallelWrapper(getattr(rv, lower)(one_team())))
    getattr(rv, upper)(BaseParallelWrapper(one_team())).reset(seed=0)


def test_an_environment_that_was_reset_before_needs_a_new_reset(which):
    guarantee, base = GUARANTEES[which], one_team()
    base.reset(seed=0)
    env = guarantee.around(base)
    choices = {agent: env.action_space(agent).sample() for agent in env.agents}
    with pytest.raises(RuntimeError, match=rf"{guarantee.name}.*new reset"):
        env.step(choices)
    env.reset(seed=0)
    env.step(choices)
    env = guarantee.around(base)
    env.set_state(guarantee.around(base).get_state())
    env.step(choices)

    venv = teams()
    venv.reset(seed=0)
    wrapped = guarantee.around_teams(venv)
    zeros = np.zeros(wrapped.action_space.shape, np.float32)
    with pytest.raises(RuntimeError, match=rf"{guarantee.name}.*new reset"):
        wrapped.step(zeros)
    wrapped.reset(seed=0)
    wrapped.step(zeros)


@pytest.mark.parametrize("make", [rv.parallel_env, rv.training_env])
def test_a_step_before_the_reset_says_so(make):
    env = make("ring-12")
    actions = {name: env.action_space(name).sample() for name in env.possible_agents}
    for given in (actions, {}):
        with pytest.raises(RuntimeError, match="call reset"):
            env.step(given)


@pytest.mark.parametrize("spelling", ["SAME_STEP", "same_step", "SameStep"])
def test_autoreset_modes_may_be_spelled_as_elsewhere(spelling):
    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    assert teams(autoreset_mode=spelling).autoreset_mode is mode
    with pytest.raises(ValueError, match="autoreset_mode"):
        teams(autoreset_mode=f"-{spelling}")
