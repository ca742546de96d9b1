"""``rendezvous report``: contents of the page, and incomplete folders."""

import base64
import json
import os
import re
import shutil
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from report_data import arrays_of, data_of

from rendezvous_env import Disc
from rendezvous_env.checks import counted
from rendezvous_env.obstacles.obstacle_set import pack
from train import cli, results
from train import encoding as report_encoding
from train.report import build as report
from train.report.build import rankings
from train.report.input import read


@pytest.fixture
def folder(compared, tmp_path):
    """Copy for damage by a test."""
    return shutil.copytree(compared, tmp_path / "out", ignore=shutil.ignore_patterns("report.html"))


def rows_of(shown):
    """Planar observations: row k of robot i is rotated from its bearing of k or k + 1."""
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


def run_of(folder):
    return json.loads((folder / "run.json").read_text())


def rewrite(folder, change):
    """Replace the names of scenarios and policies in the files."""
    for name in ("results.csv", "episodes.csv", "paired.csv", "run.json"):
        path = folder / name
        path.write_text(change(path.read_text()))


@pytest.fixture(scope="module")
def text(compared):
    """Page of ``compared``."""
    return report.page(read(compared))


class TestPage:
    @pytest.mark.slow
    def test_page_rows_equal_files(self, folder):
        assert cli.main(["report", str(folder)]) == 0
        data, _ = data_of((folder / "report.html").read_text(encoding="utf-8"))
        for name, key in (("results.csv", "results"), ("paired.csv", "paired")):
            assert data[key] == results.read_csv(folder / name)
        assert len(data["results"]) == 5
        assert [p.name for p in folder.iterdir() if p.name.startswith(".")] == []

    def test_page_recordings_equal_file_within_rounding(self, compared, text):
        found = read(compared)
        data, blobs = data_of(text)
        assert len(data["recordings"]) == len(blobs) == 2 * 2 + 3  # fig4 has one start
        for entry, blob in zip(data["recordings"], blobs, strict=True):
            shown = arrays_of(entry["fields"], blob)
            arrays = found.recordings[entry["scenario"], entry["policy"], entry["start"]]
            scales = {name: (*scale, 0.0)[0] for name, _, _, *scale in entry["fields"]}
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

    def test_page_shows_results_and_obstacles_of_episode(self, compared, text):
        data, _ = data_of(text)
        rows = results.read_csv(compared / "episodes.csv")
        for entry in data["recordings"]:
            place = entry["scenario"], entry["policy"], str(entry["start"])
            keys = "scenario", "policy", "initial_condition"
            [row] = [row for row in rows if tuple(row[key] for key in keys) == place]
            assert entry["outcome"].items() <= row.items() and "collision_free" in entry["outcome"]
            corners = [len(one["vertices"]) for one in data["obstacles"][entry["obstacles"]]]
            assert sorted(corners) == ([0, 0, 4] if entry["scenario"] == "fig4" else [])

    def test_obstacles_of_small_world_are_not_rounded_away(self, compared):
        recording = read(compared).recordings["fig4", "bearing-only", 0]
        small = {
            "positions": 1e-4 * recording["positions"],
            "obstacles": pack([Disc((1.234e-4, 0.0), 3.21e-5)], 1),
        }
        [kept] = report_encoding.encode(recording | small).obstacles
        assert kept["radius"] == pytest.approx(3.21e-5, rel=1e-3)
        assert kept["centre"] == pytest.approx([1.234e-4, 0.0], rel=1e-3)

    def test_page_states_episodes_and_rounding(self, compared, text):
        assert (
            "4 initial conditions each (seeds 3–6); one of fig4, whose initial condition is given"
            in text
        )
        with np.load(compared / "trajectories.npz") as arrays:
            reach = max(abs(arrays[n]).max() for n in arrays.files if n.endswith("/positions"))
        assert f"rounded to within {500 * reach / 32767:.2g} mm" in text

    def test_page_embeds_figures_without_network(self, compared, text):
        images = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
        files = sorted(compared.glob("*.png"))
        assert [base64.b64decode(image) for image in images] == [f.read_bytes() for f in files]
        assert len(files) >= 3
        assert "default-src 'none'" in text
        assert not re.findall(r'(?:src|href)="(?!data:|#)', text)

    def test_names_are_escaped_and_trajectories_optional(self, folder, reseal, capsys):
        """The scenario name </script><b> is displayed as text."""
        name = "</script><b>&</b>"
        rewrite(folder, lambda text: re.sub(r'(?<=")fig4(?=")|fig4(?=,)', name, text))
        (folder / "trajectories-fig4.png").unlink()
        results.write_arrays(folder / "trajectories.npz", {}, run_of(folder)["run"])
        reseal(folder)
        assert cli.main(["report", str(folder)]) == 0
        text = (folder / "report.html").read_text(encoding="utf-8")
        assert "<b>&</b>" not in text
        rows = data_of(text)[0]["results"]
        assert len(rows) == 5 and {row["scenario"] for row in rows} == {name, "uav-6"}
        for said in (text, capsys.readouterr().out.replace("\n", " ")):
            assert "--keep-trajectories 0" in said
        assert 'id="player"' not in text

    def test_policy_names_may_contain_slashes(self, folder, reseal):
        with np.load(folder / "trajectories.npz") as arrays:
            renamed = {n.replace("/zero/", "/learned:a/b/"): arrays[n] for n in arrays.files}
        results.write_arrays(folder / "trajectories.npz", renamed, run_of(folder)["run"])
        rewrite(folder, lambda text: text.replace("zero", "learned:a/b"))
        reseal(folder)
        assert ("fig4", "learned:a/b", 0) in read(folder).recordings


def test_oversized_recordings_are_subsampled_and_stated(compared, monkeypatch):
    whole = read(compared)
    sizes = {k: len(report_encoding.encode(r).text) for k, r in whole.recordings.items()}
    budget = sum(sizes.values()) // 2
    monkeypatch.setattr(report_encoding, "BUDGET", budget)
    text = report.page(whole)
    data, blobs = data_of(text)
    thin = [key for key, one in zip(sizes, data["recordings"], strict=True) if one["stride"] > 1]
    assert max(sizes, key=sizes.get) in thin and min(sizes, key=sizes.get) not in thin
    assert min(sizes[key] for key in thin) > budget / len(sizes)
    assert f"{len(thin)} of 7 recordings are subsampled" in text
    assert sum(map(len, blobs)) <= budget
    for entry, blob in zip(data["recordings"], blobs, strict=True):
        recording = whole.recordings[entry["scenario"], entry["policy"], entry["start"]]
        times, recorded = arrays_of(entry["fields"], blob)["times"], recording["times"]
        merges = ~np.isnan(recording["lyapunov_before_merge"])
        expected = {*recorded[:: entry["stride"]], *recorded[merges], recorded[-1]}
        np.testing.assert_allclose(times, sorted(expected), rtol=1e-6)


def test_rounding_matches_hand_computation():
    assert report_encoding.rounding(np.array([-3.0, np.nan, 1.0])) == 3.0 / 32767
    assert report_encoding.rounding(np.zeros((2, 2))) == 1.0
    assert report_encoding.rounding(np.full(3, np.nan)) == 1.0


@pytest.fixture
def refused(one_line):
    """Function that returns the one-line message about a folder; no page is left."""

    def refuse(folder):
        said = one_line("report", folder)
        assert not (folder / "report.html").exists()
        return said

    return refuse


def test_missing_folder_is_rejected(tmp_path, refused):
    assert "the folder does not exist" in refused(tmp_path / "nowhere")
    assert "has no run.json" in refused(tmp_path)


FILES = ["results.csv", "episodes.csv", "paired.csv", "trajectories.npz"]


@pytest.mark.parametrize("name", [*FILES, "success.png"])
def test_missing_or_modified_file_is_rejected(name, folder, refused):
    content = (folder / name).read_bytes()
    for changed in (b"", content[: len(content) // 2], content[:-1] + b"?"):
        (folder / name).write_bytes(changed)
        assert f"{name}: is not of run" in refused(folder)
    (folder / name).unlink()
    assert f"{name}: missing" in refused(folder)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        *((text, "run.json: not readable") for text in ("", "{", "[]", "null")),
        pytest.param("[" * 100_000, "nested too deeply", id="deep"),
        ({"format_version": 1}, f"is 1; this version of rendezvous reads {results.FORMAT_VERSION}"),
        ({"format_version": "new"}, "run.json: format_version is 'new'; this version"),
        ({"seed": 4}, "run.json: its content was changed"),
    ],
)
def test_modified_description_is_rejected(content, message, folder, refused):
    text = content if isinstance(content, str) else json.dumps(run_of(folder) | content)
    (folder / "run.json").write_text(text)
    assert message in refused(folder)


@pytest.mark.parametrize(
    ("version", "renamed"),
    [(5, ("results", "paired", "episodes")), (6, ("episodes",)), (7, ())],
)
def test_folder_of_a_former_format_is_read(version, renamed, folder, compared, reseal):
    for name in renamed:
        path = folder / f"{name}.csv"
        text = path.read_text()
        assert "collision_free" in text
        path.write_text(text.replace("collision_free", "clean"))
    path, run = folder / "episodes.csv", run_of(folder)
    path.write_text(path.read_text().replace(",initial_condition,", ",start,", 1))
    assert ",start," in path.read_text()
    run["starts"] = run.pop("initial_conditions")
    (folder / "run.json").write_text(json.dumps(run))
    reseal(folder, format_version=version)
    former, current = read(folder), read(compared)
    assert former.run["initial_conditions"] == current.run["initial_conditions"]
    assert "starts" not in former.run
    assert former.rows == current.rows and "collision_free_success" in former.rows[0]
    assert former.paired == current.paired and former.episodes == current.episodes
    assert rankings(former) == rankings(current)


class TestForged:
    """One-line message also for invalid content with valid digests."""

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"seed": "3"}, "not readable (TypeError"),
            ({"policies": ["zero"]}, "not readable (AttributeError"),
            ({"scenarios": {"fig4": {"n_robots": 0}}}, "run.json: a scenario is not readable: n_"),
            ({"scenarios": {"fig4": {"graph": "mine"}}}, "if your program registers"),
            ({"files": FILES[:1]}, "run.json: names no paired.csv"),
            ({"files": [*FILES, "../secret.png"]}, "run.json: names '../secret.png', which com"),
        ],
    )
    def test_forged_description_is_escaped(
        self, changes, message, folder, tmp_path, reseal, refused
    ):
        (tmp_path / "secret.png").write_bytes(b"mine")  # beside the folder
        reseal(folder, **changes)
        assert message in refused(folder)

    def test_forged_table_is_rejected(self, folder, reseal, refused):
        path = folder / "episodes.csv"
        path.write_text(path.read_text().replace("fig4,zero,0,0", "fig4,zero,0,none"))
        reseal(folder)
        assert "not readable (ValueError" in refused(folder)

    @pytest.mark.parametrize(
        ("kind", "change", "message"),
        [
            ("positions", lambda a: a[:, :-1], "positions must be an array of shape (301, 3, 2)"),
            ("merged_into", lambda a: a + 1, "fig4/zero/0: state: merged_into[0, 0] is 1; it must"),
            ("weights", lambda a: a[:0], "fig4/zero/0: weights has 0 rows; it must have 1"),
            ("obstacles", lambda a: a + 0.5, "it must be a row that begins with one of"),
        ],
    )
    def test_forged_array_is_rejected(self, kind, change, message, folder, reseal, refused):
        with np.load(folder / "trajectories.npz") as file:
            arrays = dict(file)
        name = f"fig4/zero/0/{kind}"
        changed = arrays | {name: change(arrays[name])}
        results.write_arrays(folder / "trajectories.npz", changed, run_of(folder)["run"])
        reseal(folder)
        assert message in refused(folder)


class TestFiles:
    def test_unlisted_figure_is_ignored(self, folder, refused):
        (folder / "against-robots.png").write_bytes(b"old")
        (folder / "my-notes.png").write_bytes(b"mine")
        said = refused(folder)
        assert "against-robots.png: is not of run" in said and "remove it" in said
        (folder / "against-robots.png").unlink()
        assert cli.main(["report", str(folder)]) == 0
        assert "my-notes" not in (folder / "report.html").read_text(encoding="utf-8")

    def test_existing_page_is_kept_on_failure(self, folder, one_line, monkeypatch):
        (folder / "report.html").write_text("old")
        monkeypatch.setattr(report, "page", lambda found: 1 / 0)
        assert "not readable (ZeroDivisionError" in one_line("report", folder)
        assert (folder / "report.html").read_text() == "old"

    @pytest.mark.parametrize(
        ("name", "kind"),
        [*product(("run.json", "success.png"), ("folder", "pipe", "device")),
         ("episodes.csv", "large")],
    )  # fmt: skip
    def test_special_files_are_rejected(self, name, kind, folder, refused):
        (path := folder / name).unlink()
        if kind == "folder":
            path.mkdir()
        elif kind == "pipe":
            os.mkfifo(path)
        elif kind == "device":
            path.symlink_to("/dev/zero")
        else:
            path.touch()
            os.truncate(path, 2**40)  # takes no room on the disk
        what = "is not of run" if kind == "large" else "is not a file"
        assert ("has no run.json" if name == "run.json" else f"{name}: {what}") in refused(folder)


@pytest.mark.parametrize(
    ("counts", "scenarios", "policies", "said"),
    [
        ({"duo": 1}, ["duo"], ["zero"], "1 scenario, 1 policy, 1 initial condition each (seed 3)"),
        (
            {"duo": 2, "fig4": 1},
            ["duo", "fig4"],
            ["zero", "random"],
            "2 scenarios, 2 policies, 2 initial conditions each (seeds 3–4); one of fig4, whose "
            "initial condition is given",
        ),
    ],
)
def test_counts_are_said_in_the_singular_and_the_plural(counts, scenarios, policies, said):
    played = {name: policies for name in scenarios}
    run = {"policies": played, "seed": 3, "episodes": max(counts.values())}
    run["initial_conditions"] = counts
    found = SimpleNamespace(run=run, scenarios=scenarios)
    assert report._counts(found) == said


@pytest.mark.parametrize(
    ("count", "said"), [(0, "0 links"), (1, "1 link"), (2, "2 links"), (1000, "1000 links")]
)
def test_counted_has_a_plural_unless_there_is_one(count, said):
    assert counted(count, "link") == said
