"""Output folder: atomic, resumable, and with one writing process at a time."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import contents
from training_runs import UPDATE
from training_runs import config as training

from rendezvous_env.checks import counted
from train import cli, resume
from train.checks import UserError
from train.compare import compare, out_folder, playing, upper_bound
from train.compare.out_folder import part_of
from train.learn import ppo
from train.report.input import read

SAME = ("results.csv", "episodes.csv", "paired.csv", "ceiling.csv", "trajectories.npz")


def config(out, **changes):
    given = {
        "scenarios": ("duo", "clutter-4"), "policies": ("bearing-only", "zero", "tangent-merged"),
        "episodes": 3, "keep": 1, "ceiling": 2, "set": ("time_limit=3",), "figures": False,
    }  # fmt: skip
    return compare.Config(**given | {"out": out} | changes)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Files of an uninterrupted comparison."""
    out = tmp_path_factory.mktemp("whole") / "out"
    assert compare.run(config(out)) == 0
    return contents(out)


def stopped(settings, after):
    """Run a comparison and interrupt it after some jobs."""
    real, done = playing.play_job, 0

    def play_job(job, **options):
        nonlocal done
        whole = options.get("steps") is None and options["episodes"] > 1  # no failure played again
        if whole and (done := done + 1) > after:
            raise KeyboardInterrupt
        return real(job, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(playing, "play_job", play_job)
        with pytest.raises(KeyboardInterrupt) as caught:
            compare.run(settings)
    return caught.value


class TestGoingOn:
    def test_resumed_compare_equals_uninterrupted(self, whole, tmp_path, capsys):
        out, after = tmp_path / "out", 4
        notes = stopped(config(out), after).__notes__
        assert (
            f"resumes with {counted(after, 'finished task')} in {part_of(out)}" in notes[0]
            and not out.exists()
        )
        assert compare.run(config(out)) == 0
        assert f"resumes with {counted(after, 'finished task')}" in " ".join(
            capsys.readouterr().out.split()
        )
        found = contents(out)
        assert {name: found[name] for name in SAME} == {name: whole[name] for name in SAME}
        assert not part_of(out).exists() and read(out).run["run"]

    def test_resume_runs_only_missing_tasks(self, tmp_path, monkeypatch):
        stopped(config(tmp_path / "out"), 3)
        real, played = playing.play_block, []
        monkeypatch.setattr(playing, "play_block", lambda *job: played.append(job[0]) or real(*job))
        assert compare.run(config(tmp_path / "out")) == 0
        assert [job.policy for job in played] == ["zero", "tangent-merged"]
        assert {job.scenario.name for job in played} == {"clutter-4-time-limit-3"}

    def test_resume_keeps_ceiling(self, tmp_path, monkeypatch, whole):
        monkeypatch.setattr(compare, "write", lambda *given: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            compare.run(config(tmp_path / "out"))
        monkeypatch.undo()
        monkeypatch.setattr(upper_bound, "play_run", lambda *given: 1 / 0)
        assert compare.run(config(tmp_path / "out")) == 0
        assert (tmp_path / "out" / "ceiling.csv").read_bytes() == whole["ceiling.csv"]

    def test_damaged_task_result_is_recomputed(self, whole, tmp_path):
        out = tmp_path / "out"
        stopped(config(out), 4)
        paths = sorted(part_of(out).glob("cells/*.cell"))
        content = paths[2].read_bytes()
        middle = len(content) // 2
        flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
        for path, damage in zip(paths, (b"", b"PK", flipped), strict=False):
            path.write_bytes(damage)
        assert compare.run(config(out)) == 0
        assert (out / "episodes.csv").read_bytes() == whole["episodes.csv"]

    def test_interrupt_before_first_task_leaves_nothing(self, tmp_path):
        assert not hasattr(stopped(config(tmp_path / "a" / "b" / "out"), 0), "__notes__")
        assert list(tmp_path.iterdir()) == []

    def test_other_command_is_rejected_unless_fresh(self, tmp_path):
        out = tmp_path / "out"
        stopped(config(out), 2)
        before = contents(tmp_path)
        for changes, field in (
            ({"episodes": 4}, "episodes (3, here 4)"),
            ({"seed": 1}, "seed (0, here 1)"),
            ({"keep": 0}, "keep (1, here 0)"),
            ({"scenarios": ("duo",)}, "scenarios"),
            ({"policies": ("zero",)}, "policies"),
        ):
            with pytest.raises(UserError, match="holds an unfinished comparison") as caught:
                compare.run(config(out, **changes))
            assert field in str(caught.value) and "--overwrite" in str(caught.value)
            assert contents(tmp_path) == before
        assert compare.run(config(out, seed=1, fresh=True)) == 0
        assert read(out).run["seed"] == 1 and not part_of(out).exists()

    @pytest.mark.slow
    def test_figure_options_may_change_on_resume(self, tmp_path):
        stopped(config(tmp_path / "out"), 2)
        assert compare.run(config(tmp_path / "out", figures=True)) == 0
        assert {path.name for path in read(tmp_path / "out").figures} >= {"success.png"}

    @pytest.mark.slow
    def test_changed_weights_or_law_are_another_comparison(self, tmp_path, monkeypatch, registry):
        settings = config(tmp_path, policies=("learned", "zero"))
        jobs, found = compare.plan(settings), []
        found.append(playing.plan_of(jobs, settings))
        monkeypatch.setattr(playing.checkpoints, "describe", lambda place: {"sha256": "other"})
        found.append(playing.plan_of(jobs, settings))
        registry["zero"] = registry["zero"]._replace(build=lambda scenario: None)
        found.append(playing.plan_of(jobs, settings))
        assert len(set(map(resume.run_id, found))) == 3


class TestPlace:
    """Results of a kill at each final stage, and their repair."""

    @pytest.fixture
    def finished(self, tmp_path):
        """A finished OUT, and settings of another comparison with the same OUT."""
        settings = config(tmp_path / "out", ceiling=0)
        assert compare.run(settings) == 0
        return settings

    def killed_at(self, settings, monkeypatch, name, call):
        """Run another seed up to call number ``call`` of a function on a folder."""
        where = out_folder if name == "seal" else Path
        real, calls = getattr(where, name), 0

        def gone(*given, **options):
            nonlocal calls
            calls += given[0].is_dir()
            if calls == call:
                raise SystemExit("killed")
            return real(*given, **options)

        changed = replace(settings, seed=9)
        with monkeypatch.context() as patch:
            patch.setattr(where, name, gone)
            with pytest.raises(SystemExit):
                compare.run(changed)
        return changed

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("name", "call", "seed"),
        [("seal", 1, 0), ("rename", 1, 0), ("replace", 1, None), ("rename", 2, 9)],
    )
    def test_destination_holds_old_or_new_results(self, name, call, seed, finished, monkeypatch):
        changed = self.killed_at(finished, monkeypatch, name, call)
        if seed is None:  # the one moment at which OUT is not there
            assert not finished.out.exists()
        else:
            assert read(finished.out).run["seed"] == seed
        assert compare.run(changed) == 0
        assert read(finished.out).run["seed"] == 9
        assert [path.name for path in finished.out.parent.iterdir()] == ["out"]

    @pytest.mark.slow
    def test_finished_tasks_are_not_repeated(self, finished, monkeypatch):
        summary = finished.out.with_name("short.json")
        changed = self.killed_at(replace(finished, json=summary), monkeypatch, "replace", 1)
        with monkeypatch.context() as patch:
            patch.setattr(playing, "play_job", lambda *given, **options: 1 / 0)
            assert compare.run(changed) == 0
        assert read(finished.out).run["seed"] == json.loads(summary.read_text())["seed"] == 9

    @pytest.mark.slow
    def test_older_results_are_restored(self, finished, monkeypatch):
        self.killed_at(finished, monkeypatch, "replace", 1)
        other = replace(finished, seed=3)
        with pytest.raises(UserError, match=r"holds an unfinished comparison of other seed \(9,"):
            compare.run(other)
        with pytest.raises(SystemExit), monkeypatch.context() as patch:
            patch.setattr(out_folder, "seal", lambda *given: sys.exit("killed"))
            compare.run(replace(other, fresh=True))
        assert read(finished.out).run["seed"] == 0

    @pytest.mark.slow
    def test_older_results_are_removed_completely(self, finished):
        assert compare.run(replace(finished, figures=True, pdf=True)) == 0
        assert cli.main(["report", str(finished.out)]) == 0
        assert (finished.out / "times.pdf").exists() and (finished.out / "report.html").exists()
        assert compare.run(finished) == 0
        assert not list(finished.out.glob("*.p[nd][gf]"))
        assert not (finished.out / "report.html").exists()


class TestRefusals:
    @pytest.mark.parametrize(
        ("file", "said"),
        [
            ("out/notes.txt", "contains 'notes.txt', which compare did not write"),
            ("out.part/thesis.tex", r"has no plan\.json"),
        ],
    )
    def test_foreign_files_are_not_removed(self, file, said, tmp_path):
        (tmp_path / file).parent.mkdir()
        (tmp_path / file).write_text("mine")
        before = contents(tmp_path)
        with pytest.raises(UserError, match=said):
            compare.run(config(tmp_path / "out", fresh=True))
        assert contents(tmp_path) == before

    def test_current_folder_is_rejected_as_out(self, tmp_path, monkeypatch):
        (tmp_path / "a").mkdir()
        monkeypatch.chdir(tmp_path / "a")
        for out in (".", "..", "/"):
            with pytest.raises(UserError, match="cannot be replaced as a whole"):
                compare.run(config(Path(out)))

    def test_symbolic_link_is_followed(self, tmp_path):
        (tmp_path / "real").mkdir()
        (tmp_path / "link").symlink_to(tmp_path / "real")
        assert compare.run(config(tmp_path / "link", ceiling=0)) == 0
        assert (tmp_path / "link").is_symlink() and read(tmp_path / "real").run["seed"] == 0

    def test_unfinished_and_damaged_plans_are_named(self, tmp_path, one_line):
        stopped(config(tmp_path / "out"), 2)
        said = one_line("report", tmp_path / "out")
        assert f"{part_of(tmp_path / 'out')} is unfinished" in said
        (part_of(tmp_path / "out") / "plan.json").write_text("[" * 100_000)
        with pytest.raises(UserError, match=r"plan\.json: not readable"):
            compare.run(config(tmp_path / "out"))


class TestLocks:
    @pytest.mark.slow
    def test_concurrent_compare_is_rejected(self, tmp_path, one_line):
        """A killed process releases its lock."""
        out, words = tmp_path / "out", "compare --scenarios duo --episodes 1 --no-figures".split()
        code = (
            "import sys, time, pathlib, train.resume\n"
            "with train.resume.claimed(pathlib.Path(sys.argv[1]), '.out.lock', 'it'):\n"
            "    print('held', flush=True)\n    time.sleep(60)"
        )
        command = [sys.executable, "-c", code, tmp_path]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
            try:
                assert other.stdout.readline() == "held\n"
                said = one_line(*words, "--out", out)
            finally:
                other.kill()
        assert f"--out {out} is in use by process {other.pid} on" in said
        assert not out.exists() and not part_of(out).exists()
        assert cli.main([*words, "--out", str(out)]) == 0
        assert [path.name for path in tmp_path.iterdir()] == ["out"]

    @pytest.mark.slow
    def test_concurrent_train_is_rejected(self, tmp_path, one_line):
        folder = tmp_path / "run"
        assert ppo.run(training(folder, total_steps=UPDATE, eval_every=0)).status == 0
        with resume.claimed(folder, ".lock", "it"):
            before = contents(folder)
            said = one_line("train", "--resume", folder)
            assert f"{folder} is in use by process {os.getpid()} on" in said
            assert contents(folder) == before
            shutil.rmtree(folder / "checkpoints")  # a run that has only just begun
            assert "is in use by process" in one_line("train", "--out", folder)

    def test_lock_and_empty_folders_are_removed(self, tmp_path):
        with resume.claimed(tmp_path / "a" / "b", ".lock", "it"):
            pass
        assert not (tmp_path / "a").exists()
        with resume.claimed(tmp_path / "a" / "b", ".lock", "it"):
            (tmp_path / "a" / "kept").write_text("")
        assert [path.name for path in tmp_path.rglob("*")] == ["a", "kept"]
