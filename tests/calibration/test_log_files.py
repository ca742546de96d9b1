"""Readers of rendezvous sensor: formats of a log agree, and bad files name line and remedy."""

import importlib.util
import json
import shutil

import numpy as np
import pytest
from conftest import ROOT
from log_files import CLOCK, WRITERS, write_csv, write_mrclam
from simulated_logs import KNOWN, simulate

import rendezvous_env as rv
from rendezvous_env.calibration import fit_sensor
from train.checks import UserError
from train.cli import main
from train.sensors.reading import read_log

SMALL = ROOT / "tests/data/sensor_logs"
NEEDS = {"parquet": "pyarrow", "mcap": "rosbags"}


def needed(name):
    """Skip a test of a format whose library is not installed."""
    if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None:
        pytest.skip(f"needs {NEEDS[name]}")


@pytest.fixture(params=WRITERS)
def form(request):
    needed(request.param)
    return request.param


@pytest.fixture
def folder(tmp_path):
    """A copy of a small log in CSV."""
    return shutil.copytree(SMALL / "csv", tmp_path / "log")


@pytest.fixture
def mrclam(tmp_path):
    """A copy of a small MRCLAM folder."""
    return shutil.copytree(SMALL / "mrclam", tmp_path / "mrclam")


def test_small_logs_have_equal_rows(form):
    """A recording has the same rows but for identities, which ground truth gives."""
    log, csv = read_log(SMALL / form), read_log(SMALL / "csv")
    rows, expected = log.robot_rows(), csv.robot_rows()
    assert log.n_robots == 3 and log.duration == pytest.approx(csv.duration, abs=0.5)
    assert len(log.names) == (7 if form == "mrclam" else 3)
    time = log.time[rows] - log.time[rows].min()
    assert rows.sum() == expected.sum() > 100
    assert time == pytest.approx(csv.time[expected] - csv.time[expected].min(), abs=1e-3)
    if form == "mcap":
        assert np.sort(log.bearing[rows]) == pytest.approx(np.sort(csv.bearing[expected]), abs=1e-4)
        same = log.target[rows] == csv.target[expected]
        assert same.mean() > 0.95 and log.frames == "listed"
    else:
        assert log.bearing[rows] == pytest.approx(csv.bearing[expected], abs=1e-4)
        assert (log.target[rows] == csv.target[expected]).all()


def test_fits_of_small_logs_agree(form):
    fit = fit_sensor(read_log(SMALL / form))
    one, delay = fit.parameters["noise"], fit.parameters["delay_time"]
    assert one.low < KNOWN["noise"] < one.high
    assert delay.value == pytest.approx(KNOWN["delay_time"], abs=0.02)
    assert fit.fields["sample_period"] == pytest.approx(KNOWN["sample_period"], rel=0.05)


def test_readers_keep_identities_with_other_bar_codes_and_gaps(tmp_path):
    """As in another data set: comments, a gap of ground truth, and codes of nothing."""
    ((bearings, poses),) = simulate(seeds=(7,), duration=60.0, n_robots=3)
    codes = {1: 5, 2: 14, 3: 32}
    folder = write_mrclam(tmp_path / "set", bearings, poses, codes)
    measured = folder / "Robot1_Measurement.dat"
    lines = measured.read_text(encoding="utf-8").splitlines()
    lines[5:5] = ["# a comment", "", f"{CLOCK + 3.0:.3f}  999  1.0  0.1"]
    measured.write_text("\n".join(lines), encoding="utf-8")
    truth = folder / "Robot2_Groundtruth.dat"
    lines = truth.read_text(encoding="utf-8").splitlines()
    truth.write_text("\n".join(lines[:200] + lines[400:]), encoding="utf-8")
    log = read_log(folder)
    assert log.names[:3] == ("1", "2", "3") and "barcode 999" in log.notes[0]
    assert log.robot_rows().sum() == len(bearings)
    assert fit_sensor(log).estimates.errors.error.size < len(bearings)


@pytest.mark.slow
def test_fit_command_writes_report_figures_and_scenario(tmp_path, capsys):
    out, told, page = (tmp_path / name for name in ("camera.toml", "camera.json", "camera.pdf"))
    files = ["--out", str(out), "--json", str(told), "--figures", str(page)]
    assert main(["sensor", "fit", str(SMALL / "mrclam"), *files]) == 0
    said = capsys.readouterr().out
    assert "3 robots" in said and "held-out half" in said and "not expressed" in said
    scenario = rv.Scenario.from_toml(out)
    report = json.loads(told.read_text(encoding="utf-8"))
    assert scenario.n_robots == 3 and scenario.sensing == rv.Sensing(**report["sensing"])
    noise = report["parameters"]["noise"]
    assert noise["low"] < scenario.sensing.noise < noise["high"] and noise["unit"] == "rad"
    assert report["confidence"] == 0.99 and report["held_out"]["rows"] > 50
    assert set(report["measures"]["observers"]) == {"1", "2", "3"}
    assert len(report["delay_scan"][0]) == len(report["delay_scan"][1]) > 50
    assert page.read_bytes()[:5] == b"%PDF-" and page.stat().st_size > 20_000


def test_per_robot_fit_writes_a_level_for_each(tmp_path):
    out = tmp_path / "own.toml"
    assert main(["sensor", "fit", str(SMALL / "csv"), "--per-robot", "--out", str(out)]) == 0
    assert len(rv.Scenario.from_toml(out).sensing.noise) == 3


def edited(path, line, text):
    """A file with one line replaced; lines count from 1."""
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[line - 1] = text
    path.write_text("\n".join(lines), encoding="utf-8")


@pytest.mark.parametrize(
    ("line", "text", "message"),
    [
        (4, "1.0,robot0,robot1,east", r"bearings.csv, line 4: bearing is 'east'"),
        (6, "1.0,robot0,robot1", r"bearings.csv, line 6: .* has 3 cells, the header has 4"),
        (1, "time,observer,target,angle", r"no column 'bearing'; .*columns are time"),
    ],
)
def test_bad_lines_of_tables_are_named(folder, line, text, message):
    edited(folder / "bearings.csv", line, text)
    with pytest.raises(UserError, match=message):
        read_log(folder)


def test_bad_lines_of_mrclam_files_are_named(mrclam):
    edited(mrclam / "Robot2_Groundtruth.dat", 9, "1248272273.0 0.5 nan 0.1")
    with pytest.raises(UserError, match=r"Robot2_Groundtruth.dat, line 9: .*heading rad: correct"):
        read_log(mrclam)
    (mrclam / "Robot2_Groundtruth.dat").unlink()
    with pytest.raises(UserError, match=r"Robot2_Groundtruth.dat: is missing; ground truth"):
        read_log(mrclam)


def test_a_bar_code_of_two_subjects_is_an_error(mrclam):
    with (mrclam / "Barcodes.dat").open("a", encoding="utf-8") as file:
        file.write(" 19  63\n")
    with pytest.raises(UserError, match=r"bar code 63 has two subjects"):
        read_log(mrclam)


def test_missing_tables_and_paths_are_named(folder, tmp_path):
    (folder / "poses.csv").unlink()
    with pytest.raises(UserError, match=r"no poses.csv or poses.parquet; .*ground truth"):
        read_log(folder)
    with pytest.raises(UserError, match="does not exist; give a folder of MRCLAM"):
        read_log(tmp_path / "nothing")
    with pytest.raises(UserError, match="format is unknown"):
        read_log(tmp_path)


def test_clock_offset_is_added_to_bearings(folder, capsys):
    rows = (folder / "bearings.csv").read_text(encoding="utf-8").splitlines()
    late = [rows[0]] + [f"{float(r.split(',')[0]) + 5000},{r.split(',', 1)[1]}" for r in rows[1:]]
    (folder / "bearings.csv").write_text("\n".join(late), encoding="utf-8")
    assert main(["sensor", "fit", str(folder)]) == 2
    said = capsys.readouterr().err
    assert "the clocks differ" in said and "--clock-offset -5000" in said
    assert len(read_log(folder, -5000.0).time) == len(rows) - 1


def test_empty_targets_are_frames_without_detections(folder):
    with (folder / "bearings.csv").open("a", encoding="utf-8") as file:
        file.write("30.0,robot1,,\n")
    log = read_log(folder)
    assert log.frames == "listed" and (log.target == -1).sum() == 1


def test_wsr_files_give_errors_without_time(tmp_path):
    """Two experiments with two transmitters; one bearing is off by 6°."""

    def packet(name, azimuth, x, y, measured):
        return {
            "a_INFO_Transmitting_robot": {
                "Name": name, "groundtruth_azimuth": azimuth,
                "groundtruth_position": {"x": x, "y": y, "z": 0.8},
            },
            "b_INFO_Receiving_robot": {"groundtruth_start_position": {"x": 0.0, "y": 0.0}},
            "d_INFO_AOA_profile": {"Top_N_peaks": {"1": {"estimated_azimuth": measured}}},
        }  # fmt: skip

    found = {
        "1": [packet("tx1", 90.0, 0.0, 2.0, 90.0), packet("tx2", 0.0, 3.0, 0.0, 6.0)],
        "2": [packet("tx1", 90.0, 0.0, 2.0, 90.0), packet("tx2", 0.0, 3.0, 0.0, 0.0)],
    }
    path = tmp_path / "found.json"
    path.write_text(json.dumps(found), encoding="utf-8")
    log = read_log(path)
    truth = log.truth(log.observer, log.target, log.time)
    assert np.sort(np.abs(log.bearing - truth.bearing)) == pytest.approx([0, 0, 0, np.radians(6.0)])
    assert not log.timed and "only number the experiments" in log.notes[0]
    path.write_text("{}", encoding="utf-8")


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--policy", "zero"], "--policy is zero; only replay uses it"),
        (["--figures", "page.svg"], "its ending must be .pdf or .png"),
        (["--out", "camera.json"], "its ending must be .toml"),
    ],
)
def test_flags_without_effect_are_errors(flags, message, capsys):
    assert main(["sensor", "fit", str(SMALL / "csv"), *flags]) == 2
    assert message in capsys.readouterr().err


def test_csv_with_semicolons_and_comments(tmp_path):
    ((bearings, poses),) = simulate({"noise": 0.01}, seeds=(0,), duration=2.0, n_robots=2)
    folder = write_csv(tmp_path / "log", bearings, poses)
    rows = (folder / "bearings.csv").read_text(encoding="utf-8")
    (folder / "bearings.csv").write_text("# a note\n" + rows.replace(",", ";"), encoding="utf-8")
    assert len(read_log(folder).time) == len(bearings)
