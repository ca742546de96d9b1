"""Batched environments compared with single ones under equal actions."""

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
TEAMS, STEPS = 21, 60  # more teams than lanes in a block
DISC = rv.Disc(centre=(0.3, 0.2), radius=0.2)
SCENARIOS = {
    "2-D": {"n_robots": 3},
    "follow": {"n_robots": 3, "on_merge": "follow", "costs": tuple(COSTS)},
    "discs": {"n_robots": 3, "obstacles": (DISC,), "max_speed": 1.0, "costs": tuple(COSTS)},
    "unicycle": {"n_robots": 2, "robot_model": "unicycle"},
    "uav": {"n_robots": 2, "robot_model": "nonholonomic_3d", "dim": 3},
}
"""Small scenarios with and without rendezvous within some random steps."""


def small(name):
    """One of the environments."""
    common = {"merge_radius": 0.25, "spawn_size": 1.3, "time_limit": 3.4}
    return rv.Scenario(**SCENARIOS[name], **common, time_step=0.2, allow_long_step=True)


@pytest.fixture(params=list(SCENARIOS))
def scenario(request):
    return small(request.param)


def tape_of(scenario):
    random = np.random.default_rng(0)
    shape = (STEPS, TEAMS, scenario.n_robots, scenario.action_size)
    return random.uniform(-1.5, 1.5, shape).astype(np.float32)


def assert_same_where(rows, ours, theirs):
    """Entries of nested infos, which are zeros or None where the mask is False."""
    for key, values in theirs.items():
        if isinstance(values, dict):
            assert_same_where(rows, ours[key], values)
        else:
            np.testing.assert_array_equal(np.stack(values[rows]), np.stack(ours[key][rows]))
            assert key == "final_obs" or values.dtype == ours[key].dtype


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_vector_env_equals_gymnasium_sync_vector_env(scenario, mode):
    ours = rv.make_vec(scenario, TEAMS, autoreset_mode=mode, num_threads=2)
    theirs = SyncVectorEnv([lambda: make_env(scenario)] * TEAMS, autoreset_mode=mode)
    for space in ("single_observation_space", "observation_space", "action_space"):
        assert getattr(ours, space) == getattr(theirs, space)
    seeds = list(range(TEAMS, 0, -1))
    assert data_equivalence(ours.reset(seed=seeds), theirs.reset(seed=seeds))
    meetings = time_outs = 0
    for actions in tape_of(scenario):
        *mine, told = ours.step(actions)
        *other, infos = theirs.step(actions)
        assert data_equivalence(tuple(mine), tuple(other), exact=True)
        met, late = mine[2:]
        meetings, time_outs = meetings + met.sum(), time_outs + late.sum()
        over, last = met | late, []
        if mode is AutoresetMode.SAME_STEP:
            last = ["final_info", "final_obs"]
            for key in ("robot_rewards", *ours.simulator.costs):  # theirs start anew
                np.testing.assert_array_equal(told.pop(key)[~over], infos.pop(key)[~over])
            assert over.any() == ("final_info" in told)
        if over.any() and last:
            final, their_final = ({key: each.pop(key) for key in last} for each in (told, infos))
            assert_same_where(over, final, their_final)
        assert same(told, infos)
        if over.any() and mode is AutoresetMode.DISABLED:
            (seen, told), (other, infos) = (
                each.reset(options={"reset_mask": over}) for each in (ours, theirs)
            )
            np.testing.assert_array_equal(seen, other)
            assert_same_where(over, told, infos)
            np.testing.assert_array_equal(told["_active"], over)
    assert time_outs >= TEAMS and (scenario.dim == 3 or meetings >= 2)


def test_gymnasium_make_creates_environment():
    venv = gymnasium.make_vec(
        NAME, num_envs=3, scenario="duo", max_cycles=5, autoreset_mode=AutoresetMode.SAME_STEP
    )
    assert venv.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    obs, _ = venv.reset(seed=0)
    assert obs.shape == (3, 2, 1, 2) and obs in venv.observation_space
    lengths = [venv.step(np.zeros((3, 2, 2), np.float32))[3].all() for _ in range(10)]
    assert lengths == [False] * 4 + [True] + [False] * 4 + [True]


def test_disabled_team_stands_still_and_reports_its_end_once():
    venv = rv.make_vec("duo", 2, autoreset_mode="Disabled", max_cycles=2)
    venv.reset(seed=0)
    actions = np.ones((2, 2, 2), np.float32)
    venv.step(actions)
    obs, _, _, cut, _ = venv.step(actions)
    after, rewards, met, again, infos = venv.step(actions)
    assert cut.all() and not again.any() and not met.any() and not rewards.any()
    assert venv.simulator.ended.all() and not infos["success"].any()
    np.testing.assert_array_equal(after, obs)


def one_agent(scenario, **given):
    return type(make_env(scenario))(rv.make_vec(scenario, **given))


@pytest.mark.parametrize("make", [make_env, make_heading_env, rv.training_env, one_agent])
@pytest.mark.parametrize("given", [{"num_envs": 2}, {"autoreset_mode": "SAME_STEP"}])
def test_single_agent_env_does_not_autoreset(make, given):
    with pytest.raises(ValueError, match=r"must be 1.*AutoresetMode\.DISABLED"):
        make("duo", **given)
