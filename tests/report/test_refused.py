"""``rendezvous report`` on folders that are not whole: a line that names the file, and no page."""

import json
import os
import shutil

import numpy as np
import pytest

from train import cli, results
from train.compare import compare
from train.report import build as report


@pytest.fixture
def folder(compared, tmp_path):
    """A copy that a test may damage."""
    return shutil.copytree(compared, tmp_path / "out", ignore=shutil.ignore_patterns("report.html"))


@pytest.fixture
def refused(capsys):
    """A function: the one line that the command says of a folder; no page is left."""

    def refuse(folder):
        assert cli.main(["report", str(folder)]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and "Traceback" not in said
        assert not (folder / "report.html").exists()
        return said

    return refuse


def replaced(path, old, new, count=-1):
    """Write other text into a file."""
    path.write_text(path.read_text().replace(old, new, count))


def without_last_line(path):
    text = path.read_text()
    path.write_text(text[: text.rstrip().rindex("\n") + 1])


def run_of(folder):
    return json.loads((folder / "run.json").read_text())


def test_no_folder(tmp_path, refused):
    assert "there is no such folder" in refused(tmp_path / "nowhere")
    assert "holds no run.json" in refused(tmp_path)


class TestTables:
    @pytest.mark.parametrize("name", ["results.csv", "episodes.csv", "paired.csv"])
    def test_one_is_missing(self, name, folder, refused):
        (folder / name).unlink()
        assert f"{name}: missing" in refused(folder)

    @pytest.mark.parametrize(
        ("name", "damage", "message"),
        [
            ("results.csv", lambda path: path.write_text(path.read_text()[:-30]), "line "),
            ("episodes.csv", lambda path: path.write_text(path.read_text()[:-30]), "line "),
            ("results.csv", lambda path: replaced(path, "time_low", "lowest"), "no column 'time_l"),
            ("results.csv", lambda path: path.write_text(""), "has no column 'scenario'"),
            ("paired.csv", lambda path: path.write_text(""), "has no column 'scenario'"),
            (
                "results.csv",
                lambda path: replaced(path, ",4,", ",four,", 1),
                "is 'four', no number",
            ),
            ("results.csv", lambda path: replaced(path, ",4,", ",4.5,", 1), "must be a whole"),
            ("results.csv", without_last_line, "not those that run.json names"),
            ("episodes.csv", without_last_line, "3 starts of"),
            (
                "episodes.csv",
                lambda path: replaced(path, "fig4,zero,0,0", "fig4,zero,0,1"),
                "differ in zero on fig4",
            ),
        ],
    )
    def test_one_is_damaged(self, name, damage, message, folder, reseal, refused):
        """Its digest tells, and where that has been made to fit what it holds."""
        damage(folder / name)
        assert f"{name}: is not of run" in refused(folder)
        reseal(folder)
        assert message in refused(folder)


class TestRun:
    @pytest.mark.parametrize("version", [1, 2, results.FORMAT_VERSION + 1, "new"])
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

    def test_it_lacks_something_or_was_changed(self, folder, refused):
        run = run_of(folder)
        replaced(folder / "run.json", '"seed": 3', '"seed": 4')
        assert "run.json: its content was changed" in refused(folder)
        del run["seed"]
        (folder / "run.json").write_text(json.dumps(run))
        assert "has no 'seed'" in refused(folder)

    @pytest.mark.parametrize(
        ("field", "value"),
        [("seed", "3"), ("policies", {"fig4": "zero"}), ("versions", []), ("command_line", "make")],
    )
    def test_a_wrong_type(self, field, value, folder, reseal, refused):
        reseal(folder, **{field: value})
        assert f"run.json: {field} is {value!r}; it must be of type" in refused(folder)


class TestTrajectories:
    @pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
    def test_they_are_cut_off(self, share, folder, reseal, refused):
        path = folder / "trajectories.npz"
        whole = path.read_bytes()
        path.write_bytes(whole[: int(share * len(whole))])
        assert "trajectories.npz: is not of run" in refused(folder)
        reseal(folder)
        assert "trajectories.npz: not readable" in refused(folder)

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
    def test_an_array_is_wrong(self, kind, change, message, folder, reseal, refused):
        with np.load(folder / "trajectories.npz") as file:
            arrays = {name: file[name] for name in file.files}
        name = f"fig4/zero/0/{kind}"
        changed = arrays.pop(name)
        if change is not None:
            arrays[name] = change(changed)
        results.write_arrays(folder / "trajectories.npz", arrays, run_of(folder)["run"])
        reseal(folder)
        said = refused(folder)
        assert "trajectories.npz: fig4/zero/0" in said and message in said

    def test_they_are_of_another_run(self, folder, reseal, refused):
        results.write_arrays(folder / "trajectories.npz", {}, "another")
        reseal(folder)
        assert "trajectories.npz: not readable (it is of run 'another'" in refused(folder)


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

    def test_half_a_copy_is_refused(self, folder, tmp_path, refused):
        names = sorted(path.name for path in folder.iterdir())
        for count in range(len(names)):
            half = tmp_path / f"half-{count}"
            half.mkdir()
            for name in names[:count]:
                shutil.copyfile(folder / name, half / name)
            refused(half)

    def test_a_figure_that_run_json_does_not_name(self, folder, refused):
        (folder / "against-robots.png").write_bytes(b"old")
        (folder / "my-notes.png").write_bytes(b"mine")
        said = refused(folder)
        assert "against-robots.png: is not of run" in said and "remove it" in said
        (folder / "against-robots.png").unlink()
        assert cli.main(["report", str(folder)]) == 0
        assert "my-notes" not in (folder / "report.html").read_text(encoding="utf-8")

    def test_a_picture_is_a_folder(self, folder, refused):
        (folder / "success.png").unlink()
        (folder / "success.png").mkdir()
        assert "success.png: not readable (Is a directory)" in refused(folder)

    def test_a_page_that_stood_there_stays(self, folder, monkeypatch):
        (folder / "report.html").write_text("old")

        def interrupted(found):
            raise KeyboardInterrupt

        monkeypatch.setattr(report, "page", interrupted)
        assert cli.main(["report", str(folder)]) == 130
        assert (folder / "report.html").read_text() == "old"

    @pytest.mark.parametrize("name", ["run.json", "episodes.csv", "success.png"])
    @pytest.mark.parametrize("kind", ["pipe", "device", "large"])
    def test_a_file_that_never_ends(self, name, kind, folder, refused):
        (folder / name).unlink()
        if kind == "pipe":
            os.mkfifo(folder / name)
        elif kind == "device":
            (folder / name).symlink_to("/dev/zero")
        else:
            with (folder / name).open("wb") as file:
                file.truncate(2**40)  # takes no room on the disk
        said = refused(folder)
        foreign = kind == "large" and name != "run.json"  # which says how large the others are
        assert f"{name}: {'is not of run' if foreign else 'not readable'}" in said
        assert ("bytes, more than" if kind == "large" else "is no regular file") in said
