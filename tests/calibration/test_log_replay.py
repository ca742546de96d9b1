"""Open-loop replay of logs through policies."""

import json

import numpy as np
import pytest
from conftest import ROOT
from simulated_logs import simulate

from rendezvous_env.calibration import from_tables
from train.cli import main
from train.sensors import figures
from train.sensors.replay import replay, summary

SMALL = ROOT / "tests/data/sensor_logs"


@pytest.fixture(scope="module")
def exact():
    """An all-round log without errors."""
    return simulate({}, seeds=(0,), duration=15.0, n_robots=3)[0]


def test_law_1_descends_v_at_every_frame_of_an_exact_log(exact):
    found = replay(from_tables(*exact), "bearing-only")
    told = summary(found)
    assert found.moves.all() and (found.rate < 0.0).all() and (found.team_rate < 0.0).all()
    assert found.margin == pytest.approx(1.0, abs=1e-6)
    assert told["decreases"] == pytest.approx(1.0, abs=0.02) and told["increases"] == 0.0
    speed = np.linalg.norm(found.velocity, axis=-1)
    assert speed.max() <= 0.075 + 1e-9


def test_opposite_bearings_raise_v(exact):
    bearings, poses = exact
    turned = bearings.copy()
    turned[:, 3] += np.pi
    told = summary(replay(from_tables(turned, poses), "bearing-only"))
    assert told["decreases"] == 0.0 and told["increases"] > 0.95
    assert told["margin_quantiles"] == pytest.approx([-1.0] * 3, abs=1e-6)


def test_rate_is_that_of_v_by_finite_differences(exact):
    """The rate of all robots against the change of V along their commands."""
    log = from_tables(*exact)
    found = replay(log, "bearing-only")
    time = found.time[found.observer == 0][40]
    now = np.flatnonzero(np.isclose(found.time, time))
    assert len(now) == 3
    place = np.stack([log.tracks[i].at(np.array([time]))[0][0, :2] for i in range(3)])

    def v(places):
        return np.linalg.norm(places[:, None] - places, axis=-1).sum()

    moved = place + 1e-6 * found.velocity[now[np.argsort(found.observer[now])]]
    assert found.team_rate[now] == pytest.approx((v(moved) - v(place)) / 1e-6, rel=1e-4)
    assert found.rate[now].sum() == pytest.approx(found.team_rate[now[0]])


def test_filters_descend_v_under_random_choices(exact):
    """Headings keep the alignment of the filter in an exact log; a tank may store energy."""
    log = from_tables(*exact)
    headings = replay(log, "headings")
    long = np.linalg.norm(headings.net_bearing, axis=-1) > 0.5  # others have a smaller bound
    moving = headings.margin[headings.moves & long]
    assert (headings.rate <= 1e-12).all() and moving.min() >= 0.0999
    assert moving.max() < 1.0 and moving.std() > 0.1
    assert summary(replay(log, "tank"))["decreases"] > 0.3


def test_unicycles_descend_v_along_their_heading(exact):
    found = replay(from_tables(*exact), "unicycle", "unicycle")
    assert (found.rate <= 1e-9).all() and 0.0 < summary(found)["decreases"] <= 1.0


def test_robots_rest_without_robots_in_view():
    """A frame of only a landmark gives no command, and a command is held for 1 s at most."""
    time = np.arange(20.0)
    poses = {
        "time": np.concatenate([time, time, [0.0]]), "robot": ["1"] * 20 + ["2"] * 20 + ["9"],
        "x": np.repeat([0.0, 3.0, 0.0], [20, 20, 1]), "y": np.repeat([0.0, 0.0, 4.0], [20, 20, 1]),
        "heading": np.zeros(41),
    }  # fmt: skip
    poses = {name: np.array(column) for name, column in poses.items()}
    times, seen = np.array([0.0, 2.0, 4.0, 8.0]), np.array(["2", "9", "2", "2"])
    bearings = {
        "time": times, "observer": np.full(4, "1"), "target": seen,
        "bearing": np.where(seen == "9", np.pi / 2, 0.0),
    }  # fmt: skip
    found = replay(from_tables(bearings, poses, frames="detected"), "bearing-only")
    assert found.moves.tolist() == [True, False, True, True]
    assert found.seen.tolist() == [1, 0, 1, 1]
    assert summary(found)["decreases"] == pytest.approx(2.0 / 8.0)


def test_replay_command_writes_table_and_figure(tmp_path, capsys):
    told, page = tmp_path / "replay.json", tmp_path / "replay.png"
    files = ["--json", str(told), "--figures", str(page)]
    assert main(["sensor", "replay", str(SMALL / "csv"), *files]) == 0
    assert "V falls" in capsys.readouterr().out
    rows = json.loads(told.read_text(encoding="utf-8"))["policies"]
    assert [row["policy"] for row in rows] == ["bearing-only", "headings", "tank"]
    for row in rows:
        assert row["decreases"] + row["increases"] + row["rests"] == pytest.approx(1.0, abs=1e-6)
    assert rows[0]["decreases"] > rows[1]["decreases"] > 0.0
    assert page.stat().st_size > 10_000


def test_unknown_policies_are_errors(capsys):
    words = ["sensor", "replay", str(SMALL / "csv"), "--policy", "bearing-onli"]
    assert main(words) == 2 and "bearing-only" in capsys.readouterr().err
    words[-1] = "privileged-consensus"
    assert main(words) == 2 and "--policy privileged-consensus" in capsys.readouterr().err


def test_replay_figure_has_a_bar_for_each_share(exact):
    found = [replay(from_tables(*exact), "bearing-only")]
    left, right = figures.replay_figure(found).axes
    assert [bar.get_width() for bar in left.patches][:2] == pytest.approx([1.0, 0.0], abs=0.02)
    assert "cosine" in right.get_xlabel()
