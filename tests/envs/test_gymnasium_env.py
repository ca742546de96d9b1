"""One action tape through every kind of environment gives the same transitions."""

import gymnasium
import numpy as np
import pytest
from guarantees import same
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import rendezvous_env as rv
from rendezvous_env.envs.gymnasium_env import make_env, make_heading_env
from rendezvous_env.rewards.custom_terms import COSTS

NAME = "rendezvous_env:rendezvous/Rendezvous-v0"
TEAMS, STEPS, SEED = 21, 60, 3  # more teams than lanes in a block
DISC = rv.Disc(centre=(0.3, 0.2), radius=0.2)
SCENARIOS = {
    "2-D": {"n_robots": 3},
    "follow": {"n_robots": 3, "on_merge": "follow", "costs": tuple(COSTS)},
    "discs": {"n_robots": 3, "obstacles": (DISC,), "max_speed": 1.0, "costs": tuple(COSTS)},
    "unicycle": {"n_robots": 2, "robot_model": "unicycle"},
    "uav": {"n_robots": 2, "robot_model": "nonholonomic_3d", "dim": 3},
}
"""Small worlds in which teams meet, or not, within some steps of a random tape."""


def small(name):
    """One of them."""
    common = {"merge_radius": 0.25, "spawn_size": 1.3, "time_limit": 3.4}
    return rv.Scenario(**SCENARIOS[name], **common, time_step=0.2, allow_long_step=True)


@pytest.fixture(params=list(SCENARIOS))
def scenario(request):
    return small(request.param)


def tape_of(scenario, teams=TEAMS):
    random = np.random.default_rng(0)
    shape = (STEPS, teams, scenario.n_robots, scenario.action_size)
    return random.uniform(-1.5, 1.5, shape).astype(np.float32)


def replay_pettingzoo(scenario, team, tape):
    """Transitions of one PettingZoo environment on (STEPS, n, a), with resets in between."""
    env = rv.parallel_env(scenario)
    names, transitions = env.possible_agents, []
    start = np.stack(list(env.reset(seed=SEED + team)[0].values()))
    costs = [(key, 0.0) for key in env.simulator.costs]

    def table(values, missing):
        return np.array([values.get(name, missing) for name in names])

    for actions in tape:
        alive = list(env.agents)
        chosen = {name: actions[names.index(name)] for name in alive}
        observed, rewards, ends, cuts, infos = env.step(chosen)
        over = not env.agents
        told = {
            key: table({name: info[key] for name, info in infos.items()}, missing)
            for key, missing in (("contact", False), ("clearance", np.inf), *costs)
        }
        told |= {"robot_rewards": table(rewards, 0.0), "active": env.simulator.active[0]}
        met, cut = over and all(ends.values()), over and any(cuts.values())
        transitions.append(
            {
                "infos": told,
                "seen": table(observed, np.zeros_like(start[0])),
                "end": (rewards[alive[0]], met, cut),
                "summary": infos[alive[0]].get("summary"),
                "next": np.stack(list(env.reset()[0].values())) if over else None,
            }
        )
    return start, transitions


def assert_same(transition, team, obs, infos, *end):
    """One team's transition equals that of its PettingZoo environment, bit for bit."""
    np.testing.assert_array_equal(obs, transition["seen"])
    for key, values in transition["infos"].items():
        np.testing.assert_array_equal(infos[key][team], values)
    assert tuple(values[team] for values in end) == transition["end"]


def summary_of(infos, team):
    kept = {key: value for key, value in infos["summary"].items() if key[0] != "_"}
    assert infos["_summary"][team]
    assert all(infos["summary"][f"_{key}"][team] for key in kept)
    return {key: values[team] for key, values in kept.items()}


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_tape_gives_the_transitions_of_single_environments(scenario, mode):
    tape = tape_of(scenario)
    venv = rv.make_vec(scenario, TEAMS, autoreset_mode=mode, num_threads=2)
    obs, _ = venv.reset(seed=SEED)
    single = [replay_pettingzoo(scenario, team, tape[:, team]) for team in range(TEAMS)]
    np.testing.assert_array_equal(obs, [start for start, _ in single])
    place = [0] * TEAMS  # how far each team's own tape has been played
    resting, ends = [False] * TEAMS, {True: 0, False: 0}
    for _ in range(STEPS):
        actions = np.stack([tape[place[team], team] for team in range(TEAMS)])
        obs, rewards, met, cut, infos = venv.step(actions)
        over = met | cut
        for team in range(TEAMS):
            step = single[team][1][place[team] - 1 if resting[team] else place[team]]
            if resting[team]:
                np.testing.assert_array_equal(obs[team], step["next"])
                assert not over[team] and rewards[team] == 0 and infos["active"][team].all()
                resting[team] = False
                continue
            place[team] += 1
            last, told = obs[team], infos
            if over[team] and mode is AutoresetMode.SAME_STEP:
                assert infos["_final_obs"][team] and infos["_final_info"][team]
                np.testing.assert_array_equal(obs[team], step["next"])
                last, told = infos["final_obs"][team], infos["final_info"]
            assert_same(step, team, last, told, rewards, met, cut)
            if over[team]:
                ends[bool(met[team])] += 1
                assert summary_of(told, team) == step["summary"]
                resting[team] = mode is AutoresetMode.NEXT_STEP
        if over.any() and mode is AutoresetMode.DISABLED:
            obs, infos = venv.reset(options={"reset_mask": over})
            np.testing.assert_array_equal(infos["_active"], over)
            for team in np.flatnonzero(over):
                np.testing.assert_array_equal(obs[team], single[team][1][place[team] - 1]["next"])
    assert ends[False] >= TEAMS
    assert scenario.dim == 3 or ends[True] >= 3


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_infos_have_the_form_that_gymnasium_gives_single_environments(scenario, mode):
    tape = tape_of(scenario, teams=4)
    ours = rv.make_vec(scenario, 4, autoreset_mode=mode)
    theirs = SyncVectorEnv([lambda: make_env(scenario)] * 4, autoreset_mode=mode)
    for space in ("single_observation_space", "observation_space", "action_space"):
        assert getattr(ours, space) == getattr(theirs, space)
    assert data_equivalence(ours.reset(seed=[7, 1, 5, 3]), theirs.reset(seed=[7, 1, 5, 3]))
    for actions in tape:
        *mine, told = ours.step(actions)
        *other, infos = theirs.step(actions)
        assert data_equivalence(tuple(mine), tuple(other), exact=True)
        if mode is AutoresetMode.SAME_STEP:  # ours stay those of the step, theirs start anew
            for key in ("robot_rewards", *ours.simulator.costs):
                del told[key], infos[key]
            final, their_final = told.pop("final_info", {}), infos.pop("final_info", {})
            for key, values in final.items():  # theirs hold zeros where the mask is False
                if isinstance(values, np.ndarray) and key[0] != "_":
                    rows = told["_final_info"]
                    np.testing.assert_array_equal(values[rows], their_final[key][rows])
            seen_last = told.pop("final_obs", None), infos.pop("final_obs", None)
            assert (seen_last[0] is None) == (seen_last[1] is None)
        summary, their_summary = told.pop("summary", {}), infos.pop("summary", {})
        assert summary.keys() == their_summary.keys() and same(told, infos)
        for key, values in their_summary.items():
            rows = their_summary[f"_{key.lstrip('_')}"]
            np.testing.assert_array_equal(values[rows], summary[key][rows])
            assert values.dtype == summary[key].dtype


def test_gymnasium_makes_teams():
    venv = gymnasium.make_vec(
        NAME, num_envs=3, scenario="duo", max_cycles=5, autoreset_mode=AutoresetMode.SAME_STEP
    )
    assert venv.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    obs, _ = venv.reset(seed=0)
    assert obs.shape == (3, 2, 1, 2) and obs in venv.observation_space
    lengths = [venv.step(np.zeros((3, 2, 2), np.float32))[3].all() for _ in range(10)]
    assert lengths == [False] * 4 + [True] + [False] * 4 + [True]


def test_a_disabled_team_stays_ended():
    venv = rv.make_vec("duo", 2, autoreset_mode="Disabled", max_cycles=2)
    venv.reset(seed=0)
    actions = np.ones((2, 2, 2), np.float32)
    venv.step(actions)
    obs, _, _, cut, _ = venv.step(actions)
    after, rewards, _, still, _ = venv.step(actions)
    assert cut.all() and still.all() and not rewards.any()
    np.testing.assert_array_equal(after, obs)


def one_agent(scenario, **given):
    return type(make_env(scenario))(rv.make_vec(scenario, **given))


@pytest.mark.parametrize("make", [make_env, make_heading_env, rv.training_env, one_agent])
@pytest.mark.parametrize("given", [{"num_envs": 2}, {"autoreset_mode": "SAME_STEP"}])
def test_one_agent_is_one_team_that_does_not_begin_anew(make, given):
    with pytest.raises(ValueError, match=r"it must be one team, and AutoresetMode\.DISABLED"):
        make("duo", **given)
