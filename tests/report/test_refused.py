"""``rendezvous report`` on folders that are not whole: a line that names the file, and no page."""

import json
import os
import shutil
from itertools import product

import numpy as np
import pytest
import test_report

from train import cli, results
from train.compare import compare
from train.report import build as report

folder = test_report.folder  # a fixture


@pytest.fixture
def refused(one_line):
    """A function: the one line that the command says of a folder; no page is left."""

    def refuse(folder):
        said = one_line("report", folder)
        assert not (folder / "report.html").exists()
        return said

    return refuse


def run_of(folder):
    return json.loads((folder / "run.json").read_text())


def test_no_folder(tmp_path, refused):
    assert "there is no such folder" in refused(tmp_path / "nowhere")
    assert "holds no run.json" in refused(tmp_path)


@pytest.mark.parametrize("name", ["results.csv", "episodes.csv", "paired.csv", "trajectories.npz"])
def test_a_file_is_missing_or_changed(name, folder, refused):
    content = (folder / name).read_bytes()
    for changed in (b"", content[: len(content) // 2], content[:-1] + b"?"):
        (folder / name).write_bytes(changed)
        assert f"{name}: is not of run" in refused(folder)
    (folder / name).unlink()
    assert f"{name}: missing" in refused(folder)


class TestRun:
    @pytest.mark.parametrize("version", [1, results.FORMAT_VERSION + 1, "new"])
    def test_another_version(self, version, folder, refused):
        changed = run_of(folder) | {"format_version": version}
        (folder / "run.json").write_text(json.dumps(changed))
        said = refused(folder)
        assert f"format_version is {version!r}" in said and str(results.FORMAT_VERSION) in said

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            *((text, "run.json: not readable") for text in ("", "{", "[]", "null")),
            ("[" * 100_000, "nested too deeply"),
        ],
        ids=["empty", "open", "list", "null", "deep"],
    )
    def test_it_is_not_readable(self, text, message, folder, refused):
        (folder / "run.json").write_text(text)
        assert message in refused(folder)

    def test_it_was_changed(self, folder, refused):
        (folder / "run.json").write_text(json.dumps(run_of(folder) | {"seed": 4}))
        assert "run.json: its content was changed" in refused(folder)


class TestForged:
    """One line, too, where digests were made to fit what ``compare`` would not have written."""

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"seed": "3"}, "not readable (TypeError"),
            ({"policies": ["zero"]}, "not readable (AttributeError"),
            ({"scenarios": {"fig4": {"n_robots": 0}}}, "run.json: a scenario is not readable: n_"),
            ({"scenarios": {"fig4": {"graph": "mine"}}}, "where a program of your own registers"),
        ],
    )
    def test_a_description(self, changes, message, folder, reseal, refused):
        reseal(folder, **changes)
        assert message in refused(folder)

    def test_it_leads_out_of_the_folder(self, folder, tmp_path, reseal, refused):
        (tmp_path / "secret.png").write_bytes(b"mine")
        reseal(folder, files=[*run_of(folder)["files"], "../secret.png"])
        assert "run.json: names '../secret.png', which compare does not write" in refused(folder)
        reseal(folder, files=["results.csv"])
        assert "run.json: names no paired.csv" in refused(folder)

    def test_a_table(self, folder, reseal, refused):
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
    def test_an_array(self, kind, change, message, folder, reseal, refused):
        with np.load(folder / "trajectories.npz") as file:
            arrays = dict(file)
        name = f"fig4/zero/0/{kind}"
        changed = arrays | {name: change(arrays[name])}
        results.write_arrays(folder / "trajectories.npz", changed, run_of(folder)["run"])
        reseal(folder)
        assert message in refused(folder)


class TestFiles:
    def test_every_file_of_another_comparison_is_named(self, folder, tmp_path, refused):
        other = tmp_path / "other"
        policies = ("bearing-only", "tangent-joined", "nonholonomic-3d", "zero")
        config = compare.Config(("fig4", "uav-6"), policies, episodes=4, seed=4, keep=2, out=other)
        assert compare.run(config) == 0
        content = {path.name: path.read_bytes() for path in folder.iterdir()}
        changed = [path.name for path in other.iterdir() if path.read_bytes() != content[path.name]]
        for name in changed:
            shutil.copyfile(other / name, folder / name)
            said = refused(folder)
            assert "is not of run" in said and (name in said or name == "run.json")
            (folder / name).write_bytes(content[name])
        assert len(changed) >= len(content) - 1  # every pair may compare alike

    def test_a_figure_that_run_json_does_not_name(self, folder, refused):
        (folder / "against-robots.png").write_bytes(b"old")
        (folder / "my-notes.png").write_bytes(b"mine")
        said = refused(folder)
        assert "against-robots.png: is not of run" in said and "remove it" in said
        (folder / "against-robots.png").unlink()
        assert cli.main(["report", str(folder)]) == 0
        assert "my-notes" not in (folder / "report.html").read_text(encoding="utf-8")

    def test_a_page_that_stood_there_stays(self, folder, monkeypatch):
        (folder / "report.html").write_text("old")

        def interrupted(found):
            raise KeyboardInterrupt

        monkeypatch.setattr(report, "page", interrupted)
        assert cli.main(["report", str(folder)]) == 130
        assert (folder / "report.html").read_text() == "old"

    @pytest.mark.parametrize(
        ("name", "kind"),
        [*product(("run.json", "success.png"), ("folder", "pipe", "device")),
         ("episodes.csv", "large")],
    )  # fmt: skip
    def test_what_is_no_file_or_never_ends(self, name, kind, folder, refused):
        (folder / name).unlink()
        if kind == "folder":
            (folder / name).mkdir()
        elif kind == "pipe":
            os.mkfifo(folder / name)
        elif kind == "device":
            (folder / name).symlink_to("/dev/zero")
        else:
            with (folder / name).open("wb") as file:
                file.truncate(2**40)  # takes no room on the disk
        what = "is not of run" if kind == "large" else "is no file"
        assert ("holds no run.json" if name == "run.json" else f"{name}: {what}") in refused(folder)
