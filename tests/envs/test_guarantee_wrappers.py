"""Common properties of guarantee wrappers: spaces, equal APIs, periods, errors."""

import copy
import itertools
import pickle
import re

import gymnasium
import numpy as np
import pytest
from conftest import five
from guarantees import GUARANTEES, NAMES, draw, make, same, tape, which_and_kind
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import FlattenObservation, TransformAction
from pettingzoo.utils.wrappers import BaseParallelWrapper
from strategies import HUGE

import rendezvous_env as rv
from rendezvous_env.checks import short_repr
from rendezvous_env.envs.gymnasium_env import make_env
from rendezvous_env.limits import MAX_HELD_STEPS

NUM_ENVS = 6
CLUTTER = rv.scenarios.get("clutter-8").replace(time_limit=4.0)
SCENARIOS = {
    "single": rv.Scenario(n_robots=4, spawn_size=3.0, time_limit=2.0),
    "space": rv.Scenario(n_robots=3, dim=3, spawn_size=3.0, time_limit=2.0),
    "unicycle": rv.Scenario(n_robots=3, robot_model="unicycle", spawn_size=2.0, time_limit=4.0),
    "clutter": CLUTTER,
    "costs": CLUTTER.replace(costs=("contact", "rise")),
}


@pytest.fixture(params=GUARANTEES)
def which(request):
    """Each of the guarantees."""
    return request.param


def make_vec(which, scenario="duo", mode=AutoresetMode.NEXT_STEP, max_cycles=None, **options):
    teams = rv.make_vec(scenario, NUM_ENVS, autoreset_mode=mode, max_cycles=max_cycles)
    return GUARANTEES[which].around_teams(teams, **options)


@which_and_kind
@pytest.mark.parametrize("frame", ["net_bearing", "local"])
def test_spaces_contain_observations_and_actions(which, kind, frame):
    env = make(which, kind, frame=frame, **GUARANTEES[which].options)
    scenario, random = env.unwrapped.scenario, np.random.default_rng(0)
    rows, d = scenario.observation_layout.shape
    sizes = {"heading": d - scenario.model.nonholonomic, "tank": scenario.action_size, "gains": 4}
    sees, does = env.observation_space("robot_0"), env.action_space("robot_0")
    assert sees.shape == (rows + (which == "tank"), d) and sees.contains(sees.sample())
    assert does.shape == (sizes.get(which, d),) and does is env.action_space("robot_0")
    assert (does.low == (0 if which == "gains" else -1)).all() and (does.high == 1).all()
    observations, infos = env.reset(seed=3)
    seen = 0
    while env.agents:
        assert all(sees.contains(table) for table in observations.values())
        assert all(set(info) >= GUARANTEES[which].told for info in infos.values())
        seen += len(observations)
        observations, *_, infos = env.step(draw(env, random))
    assert seen > 50


@which_and_kind
def test_reported_rates_match_motion(which, kind):
    env, random = make(which, kind, frame="local"), np.random.default_rng(1)
    env.reset(seed=2)
    simulator, scenario, compared = env.unwrapped.simulator, env.unwrapped.scenario, 0
    while env.agents:
        places, frames = simulator.positions[0], simulator.frames[0]
        f = scenario.observation_layout.net_bearing(simulator.observe()[0])
        *_, ends, _, infos = env.step(draw(env, random))
        moved = np.einsum("nji,nj->ni", frames, simulator.positions[0] - places)
        for name, info in infos.items() if not any(ends.values()) else ():
            i = env.unwrapped.index(name)
            assert info["lyapunov_rate"] == pytest.approx(
                -2 * f[i] @ moved[i] / scenario.tau, abs=1e-5
            )
            compared += 1
    assert compared > 20


@pytest.mark.parametrize(
    ("which", "name"),
    [
        pytest.param("tank", "single", marks=pytest.mark.kernels),
        *(("tank", name) for name in SCENARIOS if name != "single"),
        *(("heading", name) for name in SCENARIOS),
        *itertools.product(("gains", "links"), ("single", "space")),
    ],
)
@pytest.mark.parametrize("period", [1, 3])
def test_vector_transitions_equal_pettingzoo(which, name, period):
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
                keys = told.keys() - {"summary"}
                if period > 1:  # of a team, those of a robot that has merged are of that moment
                    keys = {*guarantee.told, *env.unwrapped.simulator.costs, "contact"}
                found = {key: infos[key][team].item(*[i] * (infos[key].ndim - 1)) for key in keys}
                assert same(found, {key: told[key] for key in keys})
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
def test_new_episode_clears_filter_state(which, mode):
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


@which_and_kind
def test_decision_period_repeats_action(which, kind):
    guarantee = GUARANTEES[which]
    scenario = five(kind, spawn_size=3.0, time_limit=5.0, costs=("rise",))
    options = guarantee.options | {"frame": "local"}
    env = guarantee.around(rv.parallel_env(scenario), decision_period=4, **options)
    single = guarantee.around(rv.parallel_env(scenario), **options)
    env.reset(seed=8)
    single.reset(seed=8)
    choice, steps = draw(env, np.random.default_rng(5)), 0
    while env.agents:
        alive = env.agents.copy()
        result = env.step({name: choice[name] for name in alive})
        told, rewards = [{} for _ in result], dict.fromkeys(alive, 0.0)
        costs = dict.fromkeys(alive, 0.0)
        for _ in range(4):
            if single.agents:
                part = single.step({name: choice[name] for name in single.agents})
                for known, new in zip(told, part, strict=True):
                    known |= new
                rewards = {name: rewards[name] + part[1].get(name, 0.0) for name in alive}
                costs |= {name: costs[name] + part[4][name]["cost"] for name in part[4]}
        for name, cost in costs.items():
            told[4][name] |= {"cost": cost, "cost_rise": cost}
        assert result[1] == pytest.approx(rewards, abs=1e-12) and set(result[0]) == set(alive)
        assert all(same(result[k], told[k]) for k in (0, 2, 3, 4))
        assert same(env.get_state()["env"], single.get_state()["env"])
        assert which != "tank" or (env.tank.levels == single.tank.levels).all()
        steps += 1
    assert steps > 3 and not single.agents and env.step({}) == ({}, {}, {}, {}, {})


@pytest.mark.parametrize(
    ("which", "field", "values"),
    [
        ("heading", "min_alignment", (0.0, 5e-324, 9e-7, 1.0, np.nan, "1", None, [1], True, HUGE)),
        ("heading", "min_alignment", (np.ones(2), 1j)),
        ("heading", "certified", ("no", 1, np.ones(2, bool))),
        ("heading", "decision_period", (np.inf, True, MAX_HELD_STEPS + 1, HUGE)),
        ("heading", "max_turn_rate", (0.0, np.inf, np.nan)),
        ("tank", "budget", (-1.0, np.nan, "1", None)),
        ("tank", "min_alignment", (0.0, 9e-7, 1.0)),
        ("tank", "observe_level", (1, "no")),
        ("gains", "min_gain", (-1.0,)),
        ("gains", "max_gain", (np.inf,)),
        ("links", "share", (0, 1e-18, 9e-7, "all")),
        ("links", "bearing_error", (2.0,)),
        *((which, "frame", ("global", 5, None)) for which in GUARANTEES),
        *((which, "decision_period", (0, 1.5, 2.0)) for which in GUARANTEES),
    ],
)
def test_arguments_are_validated(which, field, values):
    for value in values:
        for wrap in (make, make_vec):
            with pytest.raises(
                ValueError, match=re.escape(f"{field} is {short_repr(value)}; it must")
            ):
                wrap(which, **{field: value})
    if field == "min_alignment":
        assert make(which, min_alignment=1e-6) and make_vec(which, min_alignment=1e-6)


def test_foreign_environments_are_rejected(which):
    name, around, around_teams = GUARANTEES[which].name, *GUARANTEES[which].both
    for wrap, env, message in (
        (around, rv.make_vec("duo"), rf"RendezvousVectorEnv.*vector\.{name}"),
        (around_teams, rv.parallel_env("duo"), rf"use rendezvous_env\.{name}"),
        (around, None, "env is a NoneType"),
        (around_teams, gymnasium.make_vec("CartPole-v1", num_envs=1), "env is a CartPoleVectorEnv"),
        (around_teams, TransformAction(rv.make_vec("duo"), abs), "TransformAction.*it outside"),
        (around_teams, FlattenObservation(rv.make_vec("duo")), "FlattenObservation.*it outside"),
        (around, make_env("duo"), "RendezvousEnv"),
        (around_teams, make_env("duo"), "RendezvousEnv"),
        (around, rv.training_env("duo"), "TrainingParallelEnv; it must be"),
        (around_teams, rv.vector.training_env("duo"), "already has .* FeatureVectorEnv"),
    ):
        with pytest.raises(TypeError, match=message):
            wrap(env)


@pytest.mark.parametrize("lower", NAMES)
@pytest.mark.parametrize("upper", NAMES)
def test_nested_guarantees_are_rejected(upper, lower):
    base = rv.parallel_env("duo")
    for home, env in (
        (rv, getattr(rv, lower)(base)),
        (rv, BaseParallelWrapper(getattr(rv, lower)(base))),
        (rv.vector, getattr(rv.vector, lower)(rv.make_vec("duo"))),
    ):
        with pytest.raises(TypeError, match=rf"{lower}.*{upper}"):
            getattr(home, upper)(env)
    getattr(rv, upper)(BaseParallelWrapper(base)).reset(seed=0)


def test_activity_beneath_wrapper_requires_reset(which):
    """Its robots would otherwise act on earlier observations."""
    for around, base in zip(
        GUARANTEES[which].both, (rv.parallel_env("fig3"), rv.make_vec("fig3", 2)), strict=True
    ):
        base.reset(seed=0)
        env, before, state = around(base), base.get_state(), None
        choices, actions = (draw(each, np.random.default_rng(0)) for each in (env, base))
        for disturb in (
            lambda: None,  # it was reset before it was wrapped
            lambda base=base: base.reset(seed=1),
            lambda base=base: base.reset(),
            lambda base=base, before=before: base.set_state(before),
            lambda base=base, actions=actions: base.step(actions),
        ):
            disturb()
            with pytest.raises(RuntimeError, match=rf"{GUARANTEES[which].name}.*without it"):
                env.step(choices)
            if state is None:
                env.reset(seed=0)
                state = env.get_state()
            else:
                env.set_state(state)
            env.step(choices)
        for again in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
            again.step(choices)  # copies remember what is theirs


def test_partial_reset_does_not_excuse_other_environments(which):
    base = rv.make_vec("fig3", 2, autoreset_mode="Disabled")
    env = GUARANTEES[which].around_teams(base)
    choices = draw(env, np.random.default_rng(0))
    only_first, only_second = ({"reset_mask": np.arange(2) == k} for k in range(2))
    env.reset(seed=0, options=only_first)
    with pytest.raises(
        RuntimeError, match=r"call reset\(\) before step\(\): environment 1 was not reset"
    ):
        env.step(choices)
    env.reset(seed=0, options=only_second)
    env.step(choices)
    for disturb in (base.reset, lambda: base.step(draw(base, np.random.default_rng(0)))):
        disturb()
        env.reset(seed=0, options=only_first)
        with pytest.raises(RuntimeError, match=r"call reset\(\)"):
            env.step(choices)
        env.reset(seed=0, options={"reset_mask": np.array([True, True])})
        env.step(choices)
        env.reset(options=only_first)
        env.step(choices)


@pytest.mark.parametrize("around", [rv.vector.HeadingVectorWrapper, rv.vector.EnergyTankWrapper])
def test_unicycles_rest_without_visible_neighbour(around):
    """With multi-step execution in threads, or with an intermediate wrapper that observes steps."""
    sphere = rv.Sphere((9.0, 9.0, 9.0), 0.1)  # robots among spheres are of a kind with other tests'
    scenario = five("nonholonomic_3d", sensing=rv.Sensing(dropout=0.7), obstacles=sphere)
    ends = []
    for between in (lambda env: env, gymnasium.vector.VectorWrapper):
        env = around(between(rv.make_vec(scenario, 8)), decision_period=4)
        env.reset(seed=0)
        random = np.random.default_rng(0)
        for _ in range(10):
            env.step(draw(env, random))
        ends.append(env.unwrapped.simulator.positions)
    np.testing.assert_array_equal(*ends)


def twice(wrapper, actions):
    wrapper.env.step(actions)
    return wrapper.env.step(actions)


def anew(wrapper, actions):
    ended = wrapper.env.step(actions)[1:]
    return (wrapper.env.reset()[0], *ended)


def anew_instead(wrapper, actions):
    """As wrappers of other libraries return it at the end."""
    seen, infos = wrapper.env.reset()
    nothing = np.zeros(wrapper.num_envs)
    return seen, nothing, nothing > 0, nothing > 0, infos


def restart(wrapper, actions):
    told = wrapper.env.step(actions)
    wrapper.unwrapped.simulator.restart(np.ones(wrapper.num_envs, bool))
    return told


@pytest.mark.parametrize(
    ("teams", "step"),
    [(False, twice), (True, twice), (True, anew), (True, anew_instead), (True, restart)],
)
def test_multi_step_wrapper_between_is_rejected(which, teams, step):
    """The filter would not observe the step: with skipped frames V exceeded its bound."""
    wrapper = gymnasium.vector.VectorWrapper if teams else BaseParallelWrapper
    between = type("Between", (wrapper,), {"step": step})
    base = rv.make_vec("duo", 1) if teams else rv.parallel_env("duo")
    env = GUARANTEES[which].both[teams](between(base))
    env.reset(seed=0)
    choices = draw(env, np.random.default_rng(0))
    with pytest.raises(
        RuntimeError, match=r"beneath .* has stepped or reset the environments itself"
    ):
        env.step(choices)
    with pytest.raises(RuntimeError, match=r"call reset\(\)"):
        env.step(choices)
