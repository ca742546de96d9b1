"""``rendezvous report``: what the page holds, and what it says of folders that are not whole."""

import base64
import csv
import gzip
import json
import os
import re
import shutil

import numpy as np
import pytest

from rendezvous_env import Scenario, scenarios
from train import cli, results
from train.compare import compare
from train.report import build as report
from train.report import encoding as report_encoding
from train.report.input import read


@pytest.fixture
def folder(compared, tmp_path):
    """A copy that a test may damage."""
    return shutil.copytree(compared, tmp_path / "out")


def refused(folder, capsys):
    """The one line that the command says; no page is left."""
    assert cli.main(["report", str(folder)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "Traceback" not in said
    assert not (folder / "report.html").exists()
    return said


def data_of(text):
    """The JSON and the decoded blobs of a page."""
    data = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', text, re.DOTALL)[1])
    for entry in data["recordings"]:
        names = ("name", "type", "shape", "scale")
        entry["fields"] = [dict(zip(names, field, strict=False)) for field in entry["fields"]]
    blobs = re.findall(r'<script id="recording-\d+"[^>]*>(.*?)</script>', text)
    return data, [gzip.decompress(base64.b64decode(blob)) for blob in blobs]


def decode(fields, raw):
    """Arrays of a recording: an independent reading of report_encoding's description."""
    arrays = {}
    for field in fields:
        shape, count = field["shape"], int(np.prod(field["shape"]))
        dtype = np.dtype(field["type"]).newbyteorder("<")
        part, raw = raw[: count * dtype.itemsize], raw[count * dtype.itemsize :]
        if field["type"] != "int16":
            arrays[field["name"]] = np.frombuffer(part, dtype).reshape(shape)
            continue
        low, high = np.frombuffer(part, np.uint8).reshape(2, count).astype(np.int64)
        sums = (low + 256 * high).reshape(*shape[1:], shape[0]).cumsum(axis=-1)
        whole = np.moveaxis((sums + 32768) % 65536 - 32768, -1, 0)
        arrays[field["name"]] = np.where(whole == -32768, np.nan, whole * field["scale"])
    assert raw == b""
    return arrays


def rows_of(shown):
    """Observations in the plane: row k of robot i is turned from its bearing of k or k + 1."""
    angles, lengths = shown["angles"].copy(), shown["lengths"]
    n = angles.shape[1]
    for i in range(n):
        for row, j in enumerate(j for j in range(n) if j != i):
            x, y = np.moveaxis(shown["positions"][:, j] - shown["positions"][:, i], -1, 0)
            frames = shown["frames"][:, i]
            along = frames[:, 0, 0] * x + frames[:, 1, 0] * y
            across = frames[:, 0, 1] * x + frames[:, 1, 1] * y
            angles[:, i, row] += np.arctan2(across, along)
    return lengths[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


class TestPage:
    def test_rows_are_those_of_the_files(self, folder):
        assert cli.main(["report", str(folder)]) == 0
        data, _ = data_of((folder / "report.html").read_text(encoding="utf-8"))
        for name, key in (("results.csv", "results"), ("paired.csv", "paired")):
            with (folder / name).open(newline="") as file:
                assert data[key] == list(csv.DictReader(file))
        assert len(data["results"]) == 5
        assert [p.name for p in folder.iterdir() if p.name.startswith(".")] == []

    def test_recordings_are_those_of_the_file_to_the_stated_rounding(self, folder):
        found = read(folder)
        data, blobs = data_of(report.page(found))
        assert len(data["recordings"]) == len(blobs) == 2 * 2 + 3  # fig4 has one start
        for entry, raw in zip(data["recordings"], blobs, strict=True):
            shown = decode(entry["fields"], raw)
            arrays = found.recordings[entry["scenario"], entry["policy"], entry["start"]]
            scales = {f["name"]: f.get("scale", 0.0) for f in entry["fields"]}
            seen = arrays["observations"].astype(float)
            for name in shown.keys() - {"lengths", "angles", "observations"}:
                recorded = arrays[name].astype(float)
                close = {"atol": 0.501 * scales[name], "rtol": 1e-7}
                np.testing.assert_allclose(shown[name], recorded, **close)
            if "angles" in shown:
                shown["observations"] = rows_of(shown)
            np.testing.assert_allclose(shown["observations"], seen, atol=2.3e-4)
            assert (shown["observations"][(seen == 0).all(axis=-1)] == 0).all()
            assert scales["positions"] < 1e-3

    def test_outcomes_and_obstacles_of_a_start(self, folder):
        data, _ = data_of(report.page(read(folder)))
        rows = results.read_csv(folder / "episodes.csv")
        scenario = Scenario.from_plain(
            json.loads((folder / "run.json").read_text())["scenarios"]["fig4"]
        )
        for entry in data["recordings"]:
            [row] = [row for row in rows if (row["scenario"], row["policy"], row["start"]) == (
                entry["scenario"], entry["policy"], str(entry["start"]))]  # fmt: skip
            assert entry["outcome"].items() <= row.items() and "clean" in entry["outcome"]
            obstacles = data["obstacles"][entry["obstacles"]]
            if entry["scenario"] == "fig4":
                corners = [len(obstacle["vertices"]) for obstacle in obstacles]
                assert sorted(corners) == [0, 0, 4] and len(scenario.obstacles) == 3
            else:
                assert obstacles == []

    def test_one_start_is_one_start(self, folder):
        found = read(folder)
        assert {row["scenario"]: row["episodes"] for row in found.rows} == {
            "fig4": "1",
            "uav-6": "4",
        }
        text = report.page(found)
        assert "4 starts each (seeds 3–6); one of fig4, whose start is given" in text

    def test_what_is_neither_clean_nor_not_may_be_empty(self, folder, reseal):
        path = folder / "results.csv"
        rows = results.read_csv(path)
        rows[0]["clean_success"] = ""
        results.write_csv(path, results.RESULT_COLUMNS, rows)
        reseal(folder)
        assert data_of(report.page(read(folder)))[0]["results"][0]["clean_success"] == ""

    def test_the_rounding_is_stated(self, folder):
        text = report.page(read(folder))
        with np.load(folder / "trajectories.npz") as arrays:
            reach = max(abs(arrays[n]).max() for n in arrays.files if n.endswith("/positions"))
        assert f"rounded to within {500 * reach / 32767:.2g} mm" in text

    def test_nothing_is_loaded_from_elsewhere(self, folder):
        text = report.page(read(folder))
        assert "default-src 'none'" in text
        assert not re.findall(r'(?:src|href)="(?!data:|#)', text)

    def test_figures_are_those_of_the_folder(self, folder):
        text = report.page(read(folder))
        images = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
        files = sorted(folder.glob("*.png"))
        assert [base64.b64decode(image) for image in images] == [f.read_bytes() for f in files]
        assert len(files) >= 3

    def test_names_are_text(self, folder, reseal):
        """A scenario called </script><b> stays a name."""
        name = "<b>&</b>"
        for file in ("results.csv", "episodes.csv", "paired.csv", "run.json"):
            path = folder / file
            text = path.read_text()
            for place in ('"fig4"', "fig4,", '"name": "fig4"'):
                text = text.replace(place, place.replace("fig4", "</script>" + name))
            path.write_text(text)
        (folder / "trajectories-fig4.png").unlink()
        reseal(folder)
        with pytest.raises(report.UserError, match=r"not in run\.json"):
            read(folder)
        run = json.loads((folder / "run.json").read_text())
        results.write_arrays(folder / "trajectories.npz", {}, run["run"])
        reseal(folder)
        text = report.page(read(folder))
        assert name not in text
        assert {row["scenario"] for row in data_of(text)[0]["results"]} == {
            "</script>" + name,
            "uav-6",
        }

    def test_without_trajectories_there_are_tables_and_a_word(self, folder, reseal, capsys):
        run = json.loads((folder / "run.json").read_text())
        results.write_arrays(folder / "trajectories.npz", {}, run["run"])
        reseal(folder)
        assert cli.main(["report", str(folder)]) == 0
        text = (folder / "report.html").read_text(encoding="utf-8")
        assert "--keep 0" in text and "--keep 0" in capsys.readouterr().out.replace("\n", " ")
        assert 'id="player"' not in text and len(data_of(text)[0]["results"]) == 5

    def test_a_policy_may_have_slashes_in_its_name(self, folder, reseal):
        run = json.loads((folder / "run.json").read_text())["run"]
        with np.load(folder / "trajectories.npz") as arrays:
            renamed = {n.replace("/zero/", "/learned:a/b/"): arrays[n] for n in arrays.files}
        results.write_arrays(folder / "trajectories.npz", renamed, run)
        for file in ("results.csv", "episodes.csv", "paired.csv", "run.json"):
            path = folder / file
            path.write_text(path.read_text().replace("zero", "learned:a/b"))
        reseal(folder)
        data, _ = data_of(report.page(read(folder)))
        assert ("fig4", "learned:a/b", 0) in {
            (r["scenario"], r["policy"], r["start"]) for r in data["recordings"]
        }

    def test_by_default_three_starts_are_kept_and_of_large_teams_among_obstacles_fewer(self):
        chosen = compare.Config()
        kept = {
            name: chosen.kept(scenarios.get(name)) for name in ("clutter-8", "fig4", "swarm-20")
        }
        assert set(kept.values()) == {3}
        assert chosen.kept(scenarios.get("clutter-16-team-32")) == 1


class TestSize:
    def test_what_exceeds_its_share_is_thinned_and_says_so(self, folder, monkeypatch):
        whole = read(folder)
        sizes = {k: len(report_encoding.encode(r).text) for k, r in whole.recordings.items()}
        largest = max(sizes, key=sizes.get)
        budget = sum(sizes.values()) // 2
        monkeypatch.setattr(report_encoding, "BUDGET", budget)
        text = report.page(whole)
        data, blobs = data_of(text)
        strides = {
            (r["scenario"], r["policy"], r["start"]): r["stride"] for r in data["recordings"]
        }
        thin = [key for key, stride in strides.items() if stride > 1]
        assert largest in thin and min(sizes, key=sizes.get) not in thin
        assert min(sizes[key] for key in thin) > budget / len(sizes)
        assert f"{sum(s > 1 for s in strides.values())} of 7 recordings are thinned out" in text
        assert sum(map(len, re.findall(r'type="application/gzip">(.*?)<', text))) <= budget
        for entry, raw in zip(data["recordings"], blobs, strict=True):
            recording = whole.recordings[entry["scenario"], entry["policy"], entry["start"]]
            times, recorded = decode(entry["fields"], raw)["times"], recording["times"]
            merges = ~np.isnan(recording["lyapunov_before_merge"])
            expected = {*recorded[:: entry["stride"]], *recorded[merges], recorded[-1]}
            np.testing.assert_allclose(times, sorted(expected), rtol=1e-6)


class TestRounding:
    def test_by_hand(self):
        assert report_encoding.rounding(np.array([-3.0, np.nan, 1.0])) == 3.0 / 32767
        assert report_encoding.rounding(np.zeros((2, 2))) == 1.0
        assert report_encoding.rounding(np.full(3, np.nan)) == 1.0


class TestRefusals:
    def test_no_folder(self, tmp_path, capsys):
        assert "there is no such folder" in refused(tmp_path / "nowhere", capsys)

    def test_not_a_result_folder(self, tmp_path, capsys):
        assert "holds no run.json" in refused(tmp_path, capsys)

    @pytest.mark.parametrize("name", ["results.csv", "episodes.csv", "paired.csv"])
    def test_a_table_is_missing(self, name, folder, capsys):
        (folder / name).unlink()
        assert f"{name}: missing" in refused(folder, capsys)

    @pytest.mark.parametrize("name", ["results.csv", "episodes.csv"])
    def test_a_table_is_cut_off(self, name, folder, reseal, capsys):
        text = (folder / name).read_text()
        (folder / name).write_text(text[: text.rstrip().rindex("\n") + 20])
        assert f"{name}: is not of run" in refused(folder, capsys)
        reseal(folder)
        assert f"{name}: line" in refused(folder, capsys)

    def test_rows_are_missing(self, folder, reseal, capsys):
        for name, message in (("results.csv", "not those that run.json"), ("episodes.csv", "3 st")):
            text = (folder / name).read_text()
            (folder / name).write_text(text[: text.rstrip().rindex("\n") + 1])
            reseal(folder)
            assert message in refused(folder, capsys)
            (folder / name).write_text(text)

    def test_a_column_is_missing(self, folder, reseal, capsys):
        path = folder / "results.csv"
        path.write_text(path.read_text().replace("time_low", "time_lowest"))
        reseal(folder)
        assert "has no column 'time_low'" in refused(folder, capsys)

    @pytest.mark.parametrize("name", ["results.csv", "episodes.csv", "paired.csv"])
    def test_a_table_of_no_bytes(self, name, folder, reseal, capsys):
        (folder / name).write_text("")
        assert f"{name}: is not of run" in refused(folder, capsys)
        reseal(folder)
        assert f"{name}: has no column 'scenario'" in refused(folder, capsys)

    @pytest.mark.parametrize(
        ("cell", "message"), [("four", "'four', no number"), ("4.5", "'4.5'; it must be a whole")]
    )
    def test_a_count_is_none(self, cell, message, folder, reseal, capsys):
        path = folder / "results.csv"
        lines = path.read_text().splitlines()
        lines[4] = lines[4].replace(",4,", f",{cell},", 1)
        path.write_text("\n".join(lines))
        reseal(folder)
        assert f"line 5: episodes is {message}" in refused(folder, capsys)

    @pytest.mark.parametrize("version", [1, 2, results.FORMAT_VERSION + 1, "new"])
    def test_another_version(self, version, folder, capsys):
        run = json.loads((folder / "run.json").read_text())
        (folder / "run.json").write_text(json.dumps(run | {"format_version": version}))
        said = refused(folder, capsys)
        assert f"format_version is {version!r}" in said and str(results.FORMAT_VERSION) in said

    @pytest.mark.parametrize("text", ["", "{", "[]", "null"])
    def test_run_json_is_not_readable(self, text, folder, capsys):
        (folder / "run.json").write_text(text)
        assert "run.json: not readable" in refused(folder, capsys)

    def test_run_json_lacks_something(self, folder, capsys):
        run = json.loads((folder / "run.json").read_text())
        del run["seed"]
        (folder / "run.json").write_text(json.dumps(run))
        assert "has no 'seed'" in refused(folder, capsys)

    @pytest.mark.parametrize(
        ("field", "value"),
        [("seed", "3"), ("policies", {"fig4": "zero"}), ("versions", []), ("command_line", "make")],
    )
    def test_a_wrong_type_in_run_json(self, field, value, folder, reseal, capsys):
        reseal(folder, **{field: value})
        said = refused(folder, capsys)
        assert f"run.json: {field} is {value!r}; it must be of type" in said

    def test_run_json_was_changed(self, folder, capsys):
        path = folder / "run.json"
        path.write_text(path.read_text().replace('"seed": 3', '"seed": 4'))
        assert "run.json: its content was changed" in refused(folder, capsys)

    def test_run_json_is_nested_too_deeply(self, folder, capsys):
        (folder / "run.json").write_text("[" * 100_000)
        assert "nested too deeply" in refused(folder, capsys)

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
    def test_trajectories_are_cut_off(self, share, folder, reseal, capsys):
        path = folder / "trajectories.npz"
        whole = path.read_bytes()
        path.write_bytes(whole[: int(share * len(whole))])
        assert "trajectories.npz: is not of run" in refused(folder, capsys)
        reseal(folder)
        assert "trajectories.npz: not readable" in refused(folder, capsys)

    @pytest.mark.parametrize(
        ("kind", "change", "message"),
        [
            ("frames", None, "has no 'frames'"),
            ("positions", lambda a: a[:, :-1], "positions has shape"),
            ("times", lambda a: a[:0], "times has shape (0,); it must be (1,)"),
            ("headings", lambda a: a.astype(str), "headings holds <U32, no numbers"),
            ("merged_into", lambda a: a + 1, "merged_into[0, 0] is 1; it must be"),
            ("weights", lambda a: a[:0], "weights has 0 rows; it must have 1"),
            ("lyapunov", lambda a: a / 0.0, "lyapunov holds a number that is not finite"),
            ("obstacles", lambda a: a + 0.5, "it must be a row that begins with one of"),
        ],
    )
    @pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
    def test_an_array_is_wrong(self, kind, change, message, folder, reseal, capsys):
        run = json.loads((folder / "run.json").read_text())["run"]
        with np.load(folder / "trajectories.npz") as file:
            arrays = {name: file[name] for name in file.files}
        name = f"fig4/zero/0/{kind}"
        changed = arrays.pop(name)
        if change is not None:
            arrays[name] = change(changed)
        results.write_arrays(folder / "trajectories.npz", arrays, run)
        reseal(folder)
        said = refused(folder, capsys)
        assert "trajectories.npz: fig4/zero/0" in said and message in said

    def test_trajectories_of_another_run(self, folder, reseal, capsys):
        results.write_arrays(folder / "trajectories.npz", {}, "another")
        reseal(folder)
        assert "trajectories.npz: not readable (it is of run 'another'" in refused(folder, capsys)

    def test_episodes_that_are_not_those_of_the_results(self, folder, reseal, capsys):
        path = folder / "episodes.csv"
        path.write_text(path.read_text().replace("fig4,zero,0,0", "fig4,zero,0,1"))
        reseal(folder)
        assert "differ in zero on fig4" in refused(folder, capsys)

    def test_every_file_of_another_comparison_is_named(self, folder, tmp_path, capsys):
        other = tmp_path / "other"
        policies = ("bearing-only", "tangent-joined", "nonholonomic-3d", "zero")
        config = compare.Config(("fig4", "uav-6"), policies, episodes=4, seed=4, keep=2, out=other)
        assert compare.run(config) == 0
        content = {path.name: path.read_bytes() for path in folder.iterdir()}
        changed = [path.name for path in other.iterdir() if path.read_bytes() != content[path.name]]
        for name in changed:
            shutil.copyfile(other / name, folder / name)
            said = refused(folder, capsys)
            assert "is not of run" in said and (name in said or name == "run.json")
            (folder / name).write_bytes(content[name])
        assert len(changed) >= len(content) - 1  # every pair may compare alike

    def test_half_a_copy_is_refused(self, folder, tmp_path, capsys):
        names = sorted(path.name for path in folder.iterdir())
        for count in range(len(names)):
            half = tmp_path / f"half-{count}"
            half.mkdir()
            for name in names[:count]:
                shutil.copyfile(folder / name, half / name)
            refused(half, capsys)

    def test_a_figure_that_run_json_does_not_name(self, folder, capsys):
        (folder / "against-robots.png").write_bytes(b"old")
        (folder / "my-notes.png").write_bytes(b"mine")
        said = refused(folder, capsys)
        assert "against-robots.png: is not of run" in said and "remove it" in said
        (folder / "against-robots.png").unlink()
        assert cli.main(["report", str(folder)]) == 0
        assert "my-notes" not in (folder / "report.html").read_text(encoding="utf-8")

    def test_a_picture_is_a_folder(self, folder, capsys):
        (folder / "success.png").unlink()
        (folder / "success.png").mkdir()
        assert "success.png: not readable (Is a directory)" in refused(folder, capsys)

    def test_a_page_that_stood_there_stays(self, folder, monkeypatch):
        (folder / "report.html").write_text("old")

        def interrupted(found):
            raise KeyboardInterrupt

        monkeypatch.setattr(report, "page", interrupted)
        assert cli.main(["report", str(folder)]) == 130
        assert (folder / "report.html").read_text() == "old"

    @pytest.mark.parametrize("name", ["run.json", "episodes.csv", "success.png"])
    @pytest.mark.parametrize("kind", ["pipe", "device", "large"])
    def test_a_file_that_never_ends(self, name, kind, folder, capsys):
        (folder / name).unlink()
        if kind == "pipe":
            os.mkfifo(folder / name)
        elif kind == "device":
            (folder / name).symlink_to("/dev/zero")
        else:
            with (folder / name).open("wb") as file:
                file.truncate(2**40)  # takes no room on the disk
        said = refused(folder, capsys)
        foreign = kind == "large" and name != "run.json"  # which says how large the others are
        assert f"{name}: {'is not of run' if foreign else 'not readable'}" in said
        assert ("bytes, more than" if kind == "large" else "is no regular file") in said
