"""Trajectories as Minari has them, against the arrays and the environment they are made of."""

import sys

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

import baselines
import rendezvous_env as rv

ABOUT = {
    "author": "A. Nyone",
    "author_email": "a@example.org",
    "algorithm_name": "bearing-only",
    "code_permalink": "https://example.org/code",
}


@pytest.fixture(autouse=True)
def own_store(tmp_path, monkeypatch):
    """Minari writes into the user's home if it is not told otherwise."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def teams():
    """Two teams among obstacles, one of which is out of time."""
    scenario = rv.scenarios.get("fig4").replace(start_positions=None, time_limit=5.5)
    law = baselines.make("bearing-only", scenario)
    found = rv.rollout(scenario, law, seed=3, num_envs=2, record="all")
    assert sorted(found.success.tolist()) == [False, True]
    return found


def test_an_episode_is_what_a_team_lived_through(teams):
    import minari

    written = teams.to_minari("rendezvous/fig4-v0", **ABOUT)
    read = minari.load_dataset("rendezvous/fig4-v0")
    assert read.total_episodes == 2 and read.total_steps == written.total_steps
    assert read.total_steps == teams.running.sum()
    for team, episode in enumerate(read.iterate_episodes()):
        steps = teams.running[:, team].sum()
        for kept, name, count in (
            (episode.observations, "observations", steps + 1),
            (episode.actions, "actions", steps),
            (episode.rewards, "rewards", steps),
            (episode.infos["active"], "active", steps + 1),
        ):
            np.testing.assert_array_equal(kept, getattr(teams, name)[:count, team])
        met = teams.success[team]
        assert episode.terminations.tolist() == [False] * (steps - 1) + [met]
        assert episode.truncations.tolist() == [False] * (steps - 1) + [not met]


def test_the_environment_comes_back_and_relives_an_episode(teams):
    data = teams.to_minari("rendezvous/again-v0", **ABOUT)
    env = data.recover_environment(eval_env=True)
    assert env.unwrapped.scenario == teams.scenario
    assert data.observation_space == env.observation_space
    episode = data[1]
    seen, _ = env.reset(seed=3 + 1)
    for t, action in enumerate(episode.actions):
        assert data_equivalence(seen, episode.observations[t])
        seen, reward, terminated, truncated, _ = env.step(action)
        ends = episode.terminations[t], episode.truncations[t]
        assert (reward, terminated, truncated) == (episode.rewards[t], *ends)
    np.testing.assert_array_equal(seen, episode.observations[-1])


def test_what_was_not_recorded_is_named(teams, own_store):
    law = baselines.make("bearing-only", "duo")
    bare = rv.rollout("duo", law, record="actions")
    with pytest.raises(ValueError, match=r'needs observations.*rollout\(…, record="all"\)'):
        bare.to_minari("rendezvous/duo-v0", **ABOUT)
    assert not list(own_store.iterdir())


@pytest.mark.parametrize("name", ["no version/at all", "", 3])
def test_a_malformed_name_leaves_no_folder(teams, own_store, name):
    with pytest.raises(ValueError, match=r"name is .*; it must be like"):
        teams.to_minari(name, **ABOUT)
    assert not list(own_store.iterdir())


def test_a_name_is_taken_once(teams):
    teams.to_minari("rendezvous/one-v0", **ABOUT)
    with pytest.raises(ValueError, match="name is 'rendezvous/one-v0'; it must be new"):
        teams.to_minari("rendezvous/one-v0", **ABOUT)


@pytest.mark.parametrize("library", ["minari", "h5py"])
def test_a_library_that_is_missing_is_named_with_its_extra(teams, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"to_minari\(\) needs {library}: pip .*\[analysis\]"):
        teams.to_minari("rendezvous/none-v0")
