"""Trajectories in pandas, xarray and Minari, compared with their arrays."""

import dataclasses
import json
import sys

import numpy as np
import pytest
from conftest import five
from gymnasium.utils.env_checker import data_equivalence

import baselines
import rendezvous_env as rv
from rendezvous_env import trajectory_formats
from rendezvous_env.robots.robot_models import MAX_ANGLES

ABOUT = {
    "author": "A. Nyone",
    "author_email": "a@example.org",
    "algorithm_name": "bearing-only",
    "code_permalink": "https://example.org/code",
}


@pytest.fixture(autouse=True)
def own_store(tmp_path, monkeypatch):
    """Redirect Minari, which writes into the home folder by default."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def fig4():
    """Two environments with obstacles, one of them timed out, with all optional recordings."""
    scenario = rv.scenarios.get("fig4").replace(start_positions=None, time_limit=5.5)
    law = baselines.make("bearing-only", scenario)
    found = rv.rollout(scenario, law, seed=3, num_envs=2, record="all")
    assert sorted(found.success.tolist()) == [False, True]
    return found


def test_dataframe_row_matches_arrays(fig4):
    table = fig4.to_dataframe()
    steps = len(fig4.times)
    assert table.index.names == ["env", "robot", "step"]
    assert len(table) == steps * 2 * 3 and fig4.contacts.any()
    for env, robot, step in ((0, 0, 0), (1, 2, 1), (1, 0, steps - 1), (0, 1, steps // 2)):
        row = table.loc[env, robot, step]
        assert (row["time"], row["lyapunov"]) == (fig4.times[step], fig4.lyapunov[step, env])
        assert (row["x"], row["y"]) == tuple(fig4.positions[step, env, robot])
        assert row["active"] == fig4.active[step, env, robot]
        if step == 0:
            assert np.isnan(row["reward"]) and not row["contact"]
        else:
            assert row["reward"] == fig4.rewards[step - 1, env]
            assert row["contact"] == fig4.contacts[step - 1, env, robot]
    assert "z" not in table and "yaw" not in table
    assert table["contact"].sum() == fig4.contacts.sum()


@pytest.mark.slow
def test_dataset_has_all_arrays_with_units(fig4):
    found = fig4.to_xarray()
    absent = {"headings", "obstacle_offsets"}
    assert set(found.data_vars) == set(trajectory_formats.DIMENSIONS) - absent
    for name in found.data_vars:
        np.testing.assert_array_equal(found[name], getattr(fig4, name))
    assert found.lyapunov.attrs["units"] == "m²/s"
    end = found.sel(time=fig4.times[-1], axis="y")
    np.testing.assert_array_equal(end.positions, fig4.positions[-1, ..., 1])
    np.testing.assert_array_equal(found.step_end, fig4.times[1:])
    again = rv.Scenario.from_plain(json.loads(found.attrs["scenario"]))
    assert again == fig4.scenario


def test_dataset_has_offsets_of_moving_obstacles():
    played = rv.rollout("crossing-traffic-8", baselines.make("bearing-only", "crossing-traffic-8"))
    found = played.to_xarray().obstacle_offsets
    assert found.dims == ("time", "env", "obstacle", "axis") and found.attrs["units"] == "m"
    np.testing.assert_array_equal(found, played.obstacle_offsets)


def test_z_and_all_angles_have_names():
    scenario = five("nonholonomic_3d", time_limit=0.1)
    flown = rv.rollout(scenario, baselines.make("nonholonomic-3d", scenario))
    angles = np.random.default_rng(0).normal(size=(*flown.active.shape, MAX_ANGLES))
    turned = dataclasses.replace(flown, headings=angles)
    table, found = turned.to_dataframe(), turned.to_xarray()
    names = ["yaw", "pitch", "roll", "angle_3"]
    np.testing.assert_array_equal(table.loc[0, 2][names], angles[:, 0, 2])
    np.testing.assert_array_equal(table.loc[0, 1]["z"], flown.positions[:, 0, 1, 2])
    np.testing.assert_array_equal(found.headings.sel(angle=names), angles)
    assert "observations" not in found


def test_netcdf_supports_missing_headings_and_obstacles(tmp_path):
    """The format that SciPy writes has no dimension of length zero."""
    import xarray

    written = rv.rollout("duo", baselines.make("bearing-only", "duo"), record="all").to_xarray()
    written.to_netcdf(tmp_path / "duo.nc", engine="scipy")
    assert written.equals(xarray.load_dataset(tmp_path / "duo.nc"))
    assert "headings" not in written and "obstacles" not in written


def test_minari_episode_matches_trajectory(fig4):
    import minari

    written = fig4.to_minari("rendezvous/fig4-v0", **ABOUT)
    read = minari.load_dataset("rendezvous/fig4-v0")
    assert read.total_episodes == 2
    assert read.total_steps == written.total_steps == fig4.running.sum()
    for team, episode in enumerate(read.iterate_episodes()):
        steps = fig4.running[:, team].sum()
        for kept, name, count in (
            (episode.observations, "observations", steps + 1),
            (episode.actions, "actions", steps),
            (episode.rewards, "rewards", steps),
            (episode.infos["active"], "active", steps + 1),
        ):
            np.testing.assert_array_equal(kept, getattr(fig4, name)[:count, team])
        met = fig4.success[team]
        assert episode.terminations.tolist() == [False] * (steps - 1) + [met]
        assert episode.truncations.tolist() == [False] * (steps - 1) + [not met]
    with pytest.raises(ValueError, match="name is 'rendezvous/fig4-v0'; it must be new"):
        fig4.to_minari("rendezvous/fig4-v0", **ABOUT)


def test_minari_recovers_environment(fig4):
    data = fig4.to_minari("rendezvous/again-v0", **ABOUT)
    env = data.recover_environment(eval_env=True)
    assert env.unwrapped.scenario == fig4.scenario
    assert data.observation_space == env.observation_space
    episode = data[1]
    seen, _ = env.reset(seed=3 + 1)
    for t, action in enumerate(episode.actions):
        assert data_equivalence(seen, episode.observations[t])
        seen, reward, terminated, truncated, _ = env.step(action)
        ends = episode.terminations[t], episode.truncations[t]
        assert (reward, terminated, truncated) == (episode.rewards[t], *ends)
    np.testing.assert_array_equal(seen, episode.observations[-1])


@pytest.mark.parametrize("name", ["no version/at all", "", 3])
def test_malformed_minari_name_leaves_no_folder(fig4, own_store, name):
    with pytest.raises(ValueError, match=r"name is .*; it must be like"):
        fig4.to_minari(name, **ABOUT)
    bare = rv.rollout("duo", baselines.make("bearing-only", "duo"), record="actions")
    with pytest.raises(ValueError, match=r'needs observations.*rollout\(…, record="all"\)'):
        bare.to_minari("rendezvous/duo-v0", **ABOUT)
    assert not list(own_store.iterdir())


@pytest.mark.parametrize(
    ("library", "method", "arguments"),
    [
        ("pandas", "to_dataframe", ()),
        ("xarray", "to_xarray", ()),
        ("minari", "to_minari", ("rendezvous/none-v0",)),
        ("h5py", "to_minari", ("rendezvous/none-v0",)),
    ],
)
def test_missing_library_names_extra(fig4, monkeypatch, library, method, arguments):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"{method}\(\) needs {library}: pip .*\[analysis\]"):
        getattr(fig4, method)(*arguments)


@pytest.mark.parametrize("dimension", ["run", "env"])
def test_datasets_of_rollouts_of_different_lengths_are_joined(dimension):
    import xarray

    scenario = rv.scenarios.get("clutter-4")
    law = baselines.make("bearing-only", scenario)
    runs = [rv.rollout(scenario, law, seed, num_envs=2, record="all") for seed in (0, 5)]
    short, long = sorted(runs, key=lambda run: len(run.times))
    assert len(short.times) < len(long.times)
    both = [short.to_xarray(), long.to_xarray()]
    joined = xarray.concat(both, dimension, join="outer", coords="different", compat="equals")
    assert joined.sizes["step"] == len(long.times) - 1 == joined.sizes["time"] - 1
    last = len(short.times) - 1
    parts = [{"run": 0}, {"run": 1}] if dimension == "run" else [slice(0, 2), slice(2, 4)]
    for run, part in zip((short, long), parts, strict=True):
        own = joined.isel(part) if dimension == "run" else joined.isel(env=part)
        assert own.rewards.dims == ("step", "env")
        steps = len(run.times) - 1
        np.testing.assert_array_equal(own.rewards[:steps], run.rewards)
        np.testing.assert_array_equal(own.actions[:steps], run.actions)
        np.testing.assert_array_equal(own.positions[: steps + 1], run.positions)
        assert np.isnan(own.rewards[steps:]).all()
    np.testing.assert_array_equal(joined.step, np.arange(len(long.times) - 1))
    assert joined.isel({dimension: 0}).rewards[last:].isnull().all()
