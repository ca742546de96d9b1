"""Displays of trajectories: a line, a table, figures, a page, files."""

import dataclasses
import pickle

import numpy as np
import pytest
from conftest import needs_browser
from report_data import arrays_of, data_of

import rendezvous_env as rv
from rendezvous_env import baselines

WALL = rv.scenarios.resolve("fig4")


@pytest.fixture(scope="module")
def found():
    """Two environments with obstacles: one rendezvous, one time-out."""
    scenario = WALL.replace(start_positions=None, time_limit=5.5)
    return rv.rollout(scenario, baselines.make("bearing-only", scenario), seed=3, num_envs=2)


def noisy(observations, time):
    """Random values without repetition."""
    return noisy.random.normal(size=(*observations.shape[:-2], 2))


noisy.random = np.random.default_rng(0)


def test_repr_says_what_was_run_and_how_it_ended(found):
    assert repr(found).startswith(
        "<Trajectory of 'fig4' under BearingOnly: 2 environments, 3 robots"
    )
    assert "1 of 2 met" in repr(found)
    assert "\n" not in repr(found) and len(repr(found)) < 200
    free = WALL.replace(obstacles=())
    alone = rv.rollout(free, baselines.make("bearing-only", free), record="all")
    assert repr(alone).endswith("; met, recorded: observations, actions>")


def test_collision_free_is_where_no_robot_touched_an_obstacle(found):
    assert found.collision_free.shape == (2,)
    assert found.collision_free.tolist() == [not env.any() for env in found.contacts.swapaxes(0, 1)]
    both = zip(found.success, found.collision_free, strict=True)
    assert found.collision_free_success.tolist() == [bool(met and free) for met, free in both]
    assert 0 < found.success.sum() < 2
    passing = rv.rollout(WALL, baselines.make("zero", WALL.replace(time_limit=0.2)))
    assert passing.collision_free.tolist() == [True]


def test_summary_is_a_table_of_environments(found):
    summary = found.summary()
    rows = list(summary)
    assert len(summary) == len(rows) == 2
    for env, row in enumerate(rows):
        steps = int(found.running[:, env].sum())
        ended = "met" if found.success[env] else "time limit"
        assert (row["env"], row["outcome"]) == (env, ended)
        assert row["time"] == pytest.approx(steps * found.scenario.tau)
        assert row["merges"] == sum(len(one.robots) for one in found.merges if one.env == env)
        assert row["contacts"] == found.contacts[:, env].sum()
        assert row["return"] == pytest.approx(found.rewards[:steps, env].sum())
        assert row["initial_lyapunov"] == found.lyapunov[0, env]
        assert row["largest_rise"] == found.largest_rise_between_merges[env]
    moved = np.linalg.norm(np.diff(found.positions[:, 0], axis=0), axis=-1)
    assert rows[0]["path_length"] == pytest.approx((moved * found.active[:-1, 0]).sum())
    text = str(summary)
    assert text.splitlines()[0].split()[:2] == ["env", "outcome"]
    assert text.endswith("median time " + f"{found.rendezvous_time.min():.3g} s")
    assert summary._repr_html_().count("<tr>") == 3
    assert summary.to_dataframe().shape == (2, len(rows[0]))


def test_summary_of_many_environments_prints_the_first_ten():
    many = rv.rollout("duo", baselines.make("bearing-only", "duo"), num_envs=30)
    lines = str(many.summary()).splitlines()
    assert len(lines) == 2 + 10 + 2
    assert lines[-2] == "… and 20 environments more"
    assert lines[-1].startswith("30 of 30 met, 30 of 30 met collision-free")


def test_plot_draws_paths_and_v_of_one_environment(found):
    figure = found.plot(1)
    paths, values = figure.axes[:2]
    starts = [line.get_xydata()[0] for line in paths.lines if line.get_marker() == "o"]
    assert np.allclose(sorted(map(tuple, starts)), sorted(map(tuple, found.positions[0, 1])))
    assert values.lines[0].get_ydata()[0] == found.lyapunov[0, 1]
    assert "BearingOnly" in figure.get_suptitle()
    with pytest.raises(ValueError, match="env is 2"):
        found.plot(2)


def test_plot_ends_where_the_environment_does(found):
    met = int(np.flatnonzero(found.success)[0])
    values = found.plot(met).axes[1]
    last = max(line.get_xdata().max() for line in values.lines)
    assert last == pytest.approx(found.rendezvous_time[met])


def test_plot_lyapunov_draws_every_environment_and_the_bounds():
    ring = rv.rollout("ring-12", baselines.make("bearing-only", "ring-12"), num_envs=3)
    certificate = rv.certificate("ring-12", policy=ring.played_by)
    axes = ring.plot_lyapunov(certificate).axes[0]
    curves = [line for line in axes.lines if len(line.get_xdata()) > 3]
    assert [curve.get_ydata()[0] for curve in curves] == ring.lyapunov[0].tolist()
    labels = {line.get_label(): line for line in axes.lines}
    bound = next(line for label, line in labels.items() if label.startswith("bound on V"))
    assert set(bound.get_ydata()) == {certificate.lyapunov_bound}
    time = next(line for label, line in labels.items() if label.startswith("bound on the time"))
    assert set(time.get_xdata()) == {certificate.time_bound}
    assert axes.get_xlim()[1] > certificate.time_bound
    # as they are read they hold: no less than the numbers
    for label, value in ((bound, certificate.lyapunov_bound), (time, certificate.time_bound)):
        assert float(label.get_label().split(": ")[1].split()[0]) >= value
    plain = ring.plot_lyapunov().axes[0]
    assert not any(line.get_label().startswith("bound") for line in plain.lines)


def test_plot_lyapunov_refuses_the_certificate_of_another_scenario(found):
    with pytest.raises(ValueError, match="certificate is 'ring-12'"):
        found.plot_lyapunov(rv.certificate("ring-12"))


def test_save_and_load_keep_every_array(found, tmp_path):
    scenario = found.scenario
    kept = rv.rollout(scenario, found.played_by, seed=3, num_envs=2, record="all")
    path = kept.save(tmp_path / "rollout.npz")
    assert [one.name for one in tmp_path.iterdir()] == ["rollout.npz"]
    again = rv.Trajectory.load(path)
    for field in dataclasses.fields(kept):
        if field.name not in ("played_by", "recorded", "start"):
            np.testing.assert_array_equal(getattr(again, field.name), getattr(kept, field.name))
    np.testing.assert_array_equal(again.observations, kept.observations)
    np.testing.assert_array_equal(again.actions, kept.actions)
    assert again.scenario == scenario
    assert again.played_by is None
    assert str(again.summary()) == str(kept.summary())
    rv.Simulator(scenario, 2).set_state(again.start)


def test_load_refuses_what_is_no_trajectory(tmp_path):
    other = tmp_path / "other.npz"
    np.savez(other, x=np.zeros(3))
    text = tmp_path / "text.npz"
    text.write_text("no archive")
    for path in (other, text):
        with pytest.raises(
            ValueError, match=r"is no trajectory: (it has no entry 'about'|.*pickle)"
        ):
            rv.Trajectory.load(path)
    with pytest.raises(FileNotFoundError):
        rv.Trajectory.load(tmp_path / "none.npz")


def test_pickle_leaves_the_policy_out(found):
    played = dataclasses.replace(found, played_by=lambda observations, time: None)
    again = pickle.loads(pickle.dumps(played))
    assert again.played_by is None
    assert again.policy == "BearingOnly"
    np.testing.assert_array_equal(again.positions, found.positions)


def test_report_replays_the_rollout_as_it_was(found, tmp_path):
    path = found.to_report(tmp_path / "replay.html")
    data, recordings = data_of(path.read_text(encoding="utf-8"))
    assert [one["start"] for one in data["recordings"]] == [0, 1]
    assert {one["policy"] for one in data["recordings"]} == {"BearingOnly"}
    for env, (one, text) in enumerate(zip(data["recordings"], recordings, strict=True)):
        arrays = arrays_of(one["fields"], text)
        steps = int(found.running[:, env].sum())
        assert arrays["times"][-1] == pytest.approx(found.times[steps], rel=1e-6)
        assert arrays["positions"][-1] == pytest.approx(found.positions[steps, env], abs=1e-3)
        assert one["outcome"]["success"] == str(int(found.success[env]))
        assert one["outcome"]["contacts"] == str(found.contacts[:, env].sum())
    assert "1 of 2 met" in path.read_text(encoding="utf-8")
    _, few = data_of(found.to_report(tmp_path / "few.html", envs=1).read_text(encoding="utf-8"))
    assert len(few) == 1


def test_report_of_a_loaded_rollout_needs_its_actions(found, tmp_path):
    bare = rv.Trajectory.load(found.save(tmp_path / "bare.npz"))
    with pytest.raises(ValueError, match=r"not available.*record=\"actions\""):
        bare.to_report(tmp_path / "bare.html")
    kept = rv.rollout(WALL, noisy, record="actions")
    again = rv.Trajectory.load(kept.save(tmp_path / "kept.npz"))
    data, _ = data_of(again.to_report(tmp_path / "kept.html").read_text(encoding="utf-8"))
    assert data["recordings"][0]["policy"] == "noisy"


def test_report_refuses_a_policy_that_does_not_repeat_itself(tmp_path):
    once = rv.rollout(WALL.replace(time_limit=1.0), noisy)
    with pytest.raises(ValueError, match="'noisy' chose other actions in step 1"):
        once.to_report(tmp_path / "page.html")
    assert list(tmp_path.iterdir()) == []


def test_report_shows_what_delayed_noisy_sensors_showed(tmp_path):
    scenario = rv.scenarios.resolve("noisy-8").replace(time_limit=2.0)
    played = rv.rollout(scenario, baselines.make("bearing-only", scenario), seed=None, record="all")
    data, (text,) = data_of(played.to_report(tmp_path / "r.html").read_text(encoding="utf-8"))
    lengths = arrays_of(data["recordings"][0]["fields"], text)["lengths"]
    wanted = np.linalg.norm(played.observations[: len(lengths), 0], axis=-1)
    assert lengths == pytest.approx(wanted, abs=1e-3)


@pytest.mark.slow
@needs_browser
def test_report_opens_in_a_browser(found, browser, tmp_path):
    from report.browsing import visited

    with visited(browser, found.to_report(tmp_path / "replay.html").as_uri()) as page:
        assert "fig4 under BearingOnly" in page.text_content("h2")
        assert page.locator("#start option").all_text_contents() == ["0", "1"]
