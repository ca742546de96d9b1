"""Trajectories as pandas and xarray have them, against the arrays they are made of."""

import json
import sys

import numpy as np
import pytest
from conftest import five

import baselines
import rendezvous_env as rv
from rendezvous_env import trajectory_formats


@pytest.fixture(scope="module")
def fig4():
    """Two teams among obstacles, with all that a rollout can keep."""
    scenario = rv.scenarios.get("fig4").replace(start_positions=None)
    law = baselines.make("bearing-only", scenario)
    return rv.rollout(scenario, law, seed=3, num_envs=2, record="all")


def test_a_row_holds_what_its_moment_team_and_robot_had(fig4):
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


def test_a_dataset_holds_every_array_with_dimensions_and_units(fig4):
    found = fig4.to_xarray()
    assert set(found.data_vars) == set(trajectory_formats.DIMENSIONS)
    for name in found.data_vars:
        np.testing.assert_array_equal(found[name], getattr(fig4, name))
    assert found.lyapunov.attrs["units"] == "m²/s"
    end = found.sel(time=fig4.times[-1], axis="y")
    np.testing.assert_array_equal(end.positions, fig4.positions[-1, ..., 1])
    np.testing.assert_array_equal(found.step_end, fig4.times[1:])
    again = rv.Scenario.from_plain(json.loads(found.attrs["scenario"]))
    assert again == fig4.scenario


def test_attitudes_have_names_in_space():
    scenario = five("nonholonomic_3d", time_limit=0.1)
    flown = rv.rollout(scenario, baselines.make("nonholonomic-3d", scenario))
    table = flown.to_dataframe()
    np.testing.assert_array_equal(table.loc[0, 4]["pitch"], flown.headings[:, 0, 4, 1])
    np.testing.assert_array_equal(table.loc[0, 1]["z"], flown.positions[:, 0, 1, 2])
    found = flown.to_xarray()
    np.testing.assert_array_equal(found.headings.sel(angle="yaw"), flown.headings[..., 0])
    assert "observations" not in found


@pytest.mark.parametrize(
    ("library", "method"), [("pandas", "to_dataframe"), ("xarray", "to_xarray")]
)
def test_a_library_that_is_missing_is_named_with_its_extra(fig4, monkeypatch, library, method):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"{method}\(\) needs {library}: pip .*\[analysis\]"):
        getattr(fig4, method)()
