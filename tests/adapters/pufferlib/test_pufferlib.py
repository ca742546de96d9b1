"""PufferLib buffers, compared with the environments."""

import numpy as np
import pytest
from small_scenario import BARE, ROBOTS, SCENARIO, SEED
from test_examples import JUDGED, run

import rendezvous_env as rv
from rendezvous_env.vector import training_env

vector = pytest.importorskip("pufferlib.vector")
from pufferlib import PufferEnv

from rendezvous_env.adapters.pufferlib import RobotPufferEnv, make

TEAMS = 6


def actions_of(steps, agents):
    random = np.random.default_rng(0)
    return random.uniform(-2, 2, (steps, agents, 2)).astype(np.float32)


def test_buffers_and_infos_match_environment():
    options = BARE | {"costs": ("rise",)}
    env, teams = make(SCENARIO, TEAMS, **options), training_env(SCENARIO, TEAMS, **options)
    seen, infos = env.reset(SEED)
    np.testing.assert_array_equal(
        seen, teams.reset(seed=SEED * TEAMS)[0].reshape(TEAMS * ROBOTS, -1)
    )
    assert infos == [] and seen is env.observations
    buffers = env.observations, env.rewards, env.terminals, env.truncations
    counts, sums = np.zeros(4, dtype=int), np.zeros((TEAMS, 3))
    for actions in actions_of(60, TEAMS * ROBOTS):
        *found, told = env.step(actions)
        assert all(array is own for array, own in zip(found, buffers, strict=True))
        seen, rewards, met, late, infos = teams.step(actions.reshape(TEAMS, ROBOTS, 2))
        np.testing.assert_array_equal(found[0], seen.reshape(TEAMS * ROBOTS, -1))
        np.testing.assert_array_equal(found[1], infos["robot_rewards"].ravel().astype(np.float32))
        np.testing.assert_array_equal(found[2].reshape(TEAMS, ROBOTS), met[:, None] | [False] * 3)
        np.testing.assert_array_equal(found[3].reshape(TEAMS, ROBOTS), late[:, None] | [False] * 3)
        np.testing.assert_array_equal(env.masks, infos["active"].ravel())
        for key in ("cost", "cost_rise"):
            np.testing.assert_array_equal(env.costs[key], infos[key].ravel())
        sums += np.stack([rewards, np.ones(TEAMS), infos["cost"].sum(axis=1)], axis=1)
        for team, info in zip(np.flatnonzero(met | late), told, strict=True):
            of_episode = [info[f"episode_{name}"] for name in ("return", "length", "cost")]
            assert of_episode == pytest.approx(sums[team], abs=1e-5)
            assert info["success"] is bool(met[team])
        sums[met | late] = 0.0
        counts += (~env.masks).any(), met.sum(), late.sum(), env.costs["cost"].any()
    assert counts.min() >= 3


def test_two_environments_share_vectorization_buffers():
    both = vector.make(
        make,
        env_args=[SCENARIO, TEAMS],
        env_kwargs=BARE,
        backend=vector.Serial,
        num_envs=2,
        seed=SEED,
    )
    seen, _ = both.reset(SEED)
    agents = TEAMS * ROBOTS
    singles = [make(SCENARIO, TEAMS, **BARE) for _ in range(2)]
    for k, env in enumerate(singles):  # each sub-environment has its own seed
        np.testing.assert_array_equal(seen[k * agents : (k + 1) * agents], env.reset(SEED + k)[0])
    starts = np.concatenate([env.simulator.positions for env in singles])
    assert len(np.unique(starts, axis=0)) == 2 * TEAMS  # no two teams begin alike
    for actions in actions_of(20, 2 * agents):
        seen, rewards, *_ = both.step(actions)
        for k, env in enumerate(singles):
            part = slice(k * agents, (k + 1) * agents)
            own = env.step(actions[part])
            np.testing.assert_array_equal(seen[part], own[0])
            np.testing.assert_array_equal(rewards[part], own[1])


def test_native_vectorization_supports_filter_and_discrete_angles():
    env = vector.make(
        make, env_args=["clutter-8", 2], env_kwargs={"discrete": True}, backend=PufferEnv
    )
    env.reset(SEED)
    choices = env.single_action_space.n
    assert env.single_observation_space.shape == env.observations.shape[1:]
    before = env.observations.copy()
    env.step(np.arange(env.num_agents) % choices)
    assert env.slots.simulator.time.min() > 0.0 and (env.observations != before).any()


def test_seeds_apply_and_bad_arguments_are_rejected():
    seeded, other = make(SCENARIO, 2, seed=7, **BARE), make(SCENARIO, 2, **BARE)
    first = seeded.reset()[0].copy()
    np.testing.assert_array_equal(first, other.reset(7)[0])
    assert (seeded.reset()[0] != first).any()
    teams = rv.make_vec(SCENARIO, 2, autoreset_mode="SameStep")
    with pytest.raises(ValueError, match="on_merge is 'remove'"):
        RobotPufferEnv(teams)
    with pytest.raises(ValueError, match="robot_1"):
        other.step(np.full((2 * ROBOTS, 2), [[0.0], [np.nan]] * 3, dtype=np.float32))


@pytest.mark.slow
def test_example_runs():
    told = run("09_pufferlib_ppo.py", "--updates", "2", "--num-envs", "64", "--held-out", "50")
    assert len(JUDGED.findall(told)) == 2


@pytest.mark.nightly
def test_example_learns():
    """Evaluated on held-out initial conditions."""
    told = run("09_pufferlib_ppo.py", "--updates", "15", "--num-envs", "64", "--held-out", "100")
    (_, met, clean), (_, met_after, clean_after) = JUDGED.findall(told)
    assert float(met_after) > float(met) + 20
    assert float(clean_after) > float(clean)
