"""Tables of bearings and poses: units, identifiers and clocks are checked and told."""

import numpy as np
import pytest

from rendezvous_env.calibration import LogError, from_tables

TURN = 0.5  # rad/s, of robot a


def tables(count=60):
    """Two robots at rest 2 m apart, the first turning, and exact bearings."""
    time = 0.2 * np.arange(count)
    heading = TURN * time
    names = np.repeat(["a", "b"], count)
    poses = {
        "time": np.tile(time, 2), "robot": names, "x": np.repeat([0.0, 1.2], count),
        "y": np.repeat([0.0, 1.6], count), "heading": np.concatenate([heading, np.zeros(count)]),
    }  # fmt: skip
    bearings = {
        "time": time, "observer": np.full(count, "a"), "target": np.full(count, "b"),
        "bearing": np.angle(np.exp(1j * (np.arctan2(1.6, 1.2) - heading))),
    }  # fmt: skip
    return bearings, poses


def error_of(log):
    truth = log.truth(log.observer, log.target, log.time)
    return np.abs(np.angle(np.exp(1j * (log.bearing - truth.bearing)))).max()


def test_bearings_and_headings_are_matched():
    log = from_tables(*tables())
    assert log.names == ("a", "b") and log.n_robots == 2 and log.dim == 2
    assert error_of(log) < 1e-9 and log.notes == ()


@pytest.mark.parametrize("what", ["bearing", "heading", "both"])
def test_degrees_are_recognised(what):
    bearings, poses = tables()
    if what != "heading":
        bearings["bearing"] = np.degrees(bearings["bearing"])
    if what != "bearing":
        poses["heading"] = np.degrees(poses["heading"])
    log = from_tables(bearings, poses)
    assert error_of(log) < 1e-9
    told = " ".join(log.notes)
    assert ("bearings are in degrees" in told) == (what != "heading")
    assert ("headings are in degrees" in told) == (what != "bearing")


def test_angles_from_0_to_2_pi_are_wrapped():
    bearings, poses = tables()
    bearings["bearing"] = bearings["bearing"] % (2.0 * np.pi)
    poses["heading"] = poses["heading"] % (2.0 * np.pi)
    log = from_tables(bearings, poses)
    assert error_of(log) < 1e-9 and "wrapped" in log.notes[0]


def test_clockwise_bearings_are_an_error():
    bearings, poses = tables()
    bearings["bearing"] = -bearings["bearing"]
    with pytest.raises(LogError, match="counter-clockwise"):
        from_tables(bearings, poses)


def test_clocks_that_do_not_overlap_are_an_error_with_the_offset():
    bearings, poses = tables()
    bearings["time"] = bearings["time"] + 1000.0
    with pytest.raises(LogError, match=r"clocks differ.*--clock-offset -1000.000"):
        from_tables(bearings, poses)
    assert error_of(from_tables(bearings, poses, clock_offset=-1000.0)) < 1e-9


def test_unknown_identifiers_are_dropped_and_told():
    bearings, poses = tables()
    bearings["target"] = bearings["target"].astype(object)
    bearings["target"][:5] = "ghost"
    log = from_tables(bearings, poses)
    assert len(log.time) == 55 and "5 rows (8.3%)" in log.notes[0] and "ghost" in log.notes[0]
    bearings["target"][:40] = "ghost"
    with pytest.raises(LogError, match=r"poses are of a, b: use the same identifiers"):
        from_tables(bearings, poses)


def test_numbers_and_texts_name_the_same_robot():
    bearings, poses = tables()
    bearings["observer"], bearings["target"] = np.full(60, 1), np.full(60, 2.0)
    poses["robot"] = np.repeat(["1", "2"], 60)
    assert from_tables(bearings, poses).names == ("1", "2")


def test_missing_ground_truth_is_an_error_or_leaves_rows_out():
    bearings, poses = tables()
    single = {name: column[[0, 60]] for name, column in poses.items()}
    with pytest.raises(LogError, match="ground truth is missing"):
        from_tables(bearings, single)
    kept = (poses["time"] < 4.0) | (poses["time"] > 8.0)
    log = from_tables(bearings, {name: column[kept] for name, column in poses.items()})
    known = log.truth(log.observer, log.target, log.time).known
    assert 0.6 < known.mean() < 0.7 and not known[(log.time > 4.3) & (log.time < 7.7)].any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bearing": None}, "no column 'bearing'"),
        ({"time": np.full(60, np.nan)}, "row 1: time is nan"),
        ({"time": np.zeros(3)}, "equal lengths"),
        ({"bearing": np.full(60, "x")}, "must hold numbers"),
        ({"bearing": np.full(60, np.nan)}, "row 1: bearing is not a finite number"),
    ],
)
def test_bad_columns_are_errors(change, message):
    bearings, poses = tables()
    given = {k: v for k, v in {**bearings, **change}.items() if v is not None}
    with pytest.raises(LogError, match=message):
        from_tables(given, poses)


def test_rows_of_numbers_need_the_right_number_of_columns():
    with pytest.raises(LogError, match=r"shape \(3, 3\); it must be rows of time, observer"):
        from_tables(np.zeros((3, 3)), np.zeros((3, 5)))


def test_landmarks_follow_robots():
    bearings, poses = tables()
    more = {"time": [0.0], "robot": ["7"], "x": [1.0], "y": [1.0], "heading": [0.0]}
    poses = {name: np.append(column, more[name]) for name, column in poses.items()}
    log = from_tables(bearings, poses)
    assert log.names == ("a", "b", "7") and log.n_robots == 2 and log.tracks[2].is_static
    place, _, known = log.tracks[2].at(np.array([-5.0, 99.0]))
    assert known.all() and place[:, :2].tolist() == [[1.0, 1.0], [1.0, 1.0]]


def test_elevations_are_read_in_3_d():
    bearings, poses = tables()
    poses["z"] = np.repeat([0.0, 1.0], 60)
    bearings["elevation"] = np.full(60, np.arctan2(1.0, 2.0))
    log = from_tables(bearings, poses)
    truth = log.truth(log.observer, log.target, log.time)
    assert log.dim == 3 and truth.elevation == pytest.approx(log.elevation)
    assert truth.distance == pytest.approx(np.sqrt(5.0))
