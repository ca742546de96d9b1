"""Resumption of stopped, killed and damaged training runs."""

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time

import pytest
import tyro
from conftest import contents
from parameters import first_fast, slow
from training_runs import (
    UPDATE,
    assert_goes_on,
    assert_same_run,
    config,
    flags,
    metrics,
    network,
    resumed,
    stopped_after,
)

from baselines.learned import checkpoints, learned_policy
from rendezvous_env.scenario import scenarios
from train import cli, results
from train.learn import checkpoint, ppo, settings, trainer


@pytest.fixture
def copied(whole, tmp_path):
    """Folder of a finished run, to be damaged."""
    return shutil.copytree(whole, tmp_path / "run")


class TestResume:
    def test_signal_keeps_whole_updates(self, whole, tmp_path, capsys):
        """The signal comes during the log of update four; every other update has a checkpoint."""
        folder = tmp_path / "run"
        assert stopped_after(config(folder), 4, signal.SIGINT) == 128 + signal.SIGINT
        assert checkpoints.find(folder).name == f"step-{3 * UPDATE:012d}"
        resumed(folder)
        said = capsys.readouterr().out
        assert f"at step {3 * UPDATE:,}" in said and f"step-{3 * UPDATE:012d}" in said
        assert_same_run(whole, folder)

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "more",
        [
            {"memory": "features", "eval_every": 1500},
            slow({"memory": "recurrent", "critic": "global", "eval_every": 1500}),
            slow({"memory": "features", "set": ("robot_model=unicycle", "max_turn_rate=2.0")}),
            slow({"memory": "features", "scenario": "clutter-3d"}),
            slow({"memory": "features", "scenario": "uav-clutter-16"}),
        ],
        ids=["features", "recurrent and global", "unicycle", "space", "nonholonomic"],
    )
    def test_tank_run_resumes_bitwise(self, tmp_path, more):
        """Checkpoints contain stored energies and memory of running episodes."""
        tank = {"guarantee": "tank", "budget": 2.0, "prior": 0.5, "eval_every": 0} | more
        folder = assert_goes_on(tmp_path, 2, **tank, total_steps=3 * UPDATE)
        about, tables = checkpoints.read(checkpoints.find(folder), trainer.STATE_FILES)
        levels, policy = tables["state"]["robots/teams/tank/levels"], about["policy"]
        assert len(levels) == 8 and (levels >= 0.0).all() and (levels != 2.0).any()
        assert policy["guarantee"] == "tank"
        assert policy["budget"] == pytest.approx(2.0 / (0.2 * (levels.shape[1] - 1)))

    def test_heading_run_with_memory_resumes(self, tmp_path):
        more = {"memory": "recurrent", "memory_units": 4, "total_steps": 2 * UPDATE}
        assert ppo.run(config(tmp_path, eval_every=UPDATE, **more)).status == 0
        rows = results.read_csv(tmp_path / "evaluation.csv")
        assert len(rows) == 2
        assert all(float(row["min_alignment"]) >= 0.05 - 1e-6 for row in rows)
        assert network(tmp_path)["memory.weight_hh"].shape == (12, 4)

    def test_second_signal_exits_immediately(self, tmp_path, monkeypatch):
        def update(self):
            monkeypatch.setattr(trainer.Trainer, "save", interrupt)
            interrupt(self)

        def interrupt(self, state=None):
            os.kill(os.getpid(), signal.SIGINT)
            raise AssertionError("still here")

        monkeypatch.setattr(trainer.Trainer, "update", update)
        before = signal.getsignal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            ppo.run(config(tmp_path / "run"))
        assert signal.getsignal(signal.SIGINT) is before

    @pytest.mark.slow
    def test_rows_after_checkpoint_are_removed(self, tmp_path):
        """A kill leaves rows of updates that will be repeated, and half a row."""
        folder = tmp_path / "run"
        stopped_after(config(folder), 4)
        resumed(folder, total_steps=6 * UPDATE)
        shutil.rmtree(checkpoints.candidates(folder)[0])
        with (folder / "metrics.csv").open("a") as file:
            file.write("99999,")
        resumed(folder, total_steps=8 * UPDATE)
        steps = [int(row["step"]) for row in metrics(folder)]
        assert steps == [UPDATE * (k + 1) for k in range(8)]

    @pytest.mark.slow
    def test_damaged_checkpoint_is_skipped(self, whole, tmp_path, capsys):
        folder = tmp_path / "run"
        stopped_after(config(folder), 5)
        newest, older = checkpoints.candidates(folder)
        file = newest / "optimizer.safetensors"
        file.write_bytes(file.read_bytes()[:-10])
        resumed(folder)
        said = capsys.readouterr().out
        assert "truncated" in said and f"resumes {older}" in said
        assert_same_run(whole, folder)

    def test_finished_and_old_runs_resume(self, copied, capsys):
        before = metrics(copied)
        resumed(copied)
        assert "the run was already complete" in capsys.readouterr().out
        assert metrics(copied) == before
        plain = json.loads((copied / "config.json").read_text())
        for name in [name for name in plain if name.startswith("sensing")]:
            del plain[name]
        for name in ("guarantee", "budget", "memory", "memory_units", "critic", "set"):
            del plain[name]
        (copied / "config.json").write_text(json.dumps(plain))
        assert resumed(copied, total_steps=13 * UPDATE).steps == 13 * UPDATE

    def test_explicit_default_flag_counts_as_given(self, copied):
        """An explicit default adds three million decisions; otherwise the run is finished."""
        asked = ppo.Config(resume=copied, total_steps=3_000_000, eval_episodes=200, eval_every=0)
        assert ppo.run(asked, lambda update, metrics: True).steps == 13 * UPDATE
        stored = json.loads((copied / "config.json").read_text())
        assert (stored["total_steps"], stored["eval_episodes"]) == (3_000_000, 200)
        words = ["--total-steps", "3000000", "--eval-episodes", "200"]
        command = tyro.cli(ppo.Config, args=["--resume", str(copied), *words])
        kept = tyro.cli(ppo.Config, args=["--resume", str(copied)])
        run = ppo.Config(total_steps=UPDATE, eval_episodes=4, checkpoint_every=1000)
        for given, found in ((command, (3_000_000, 200, 1000)), (kept, (UPDATE, 4, 1000))):
            on = settings.resumed(given, run)
            assert (on.total_steps, on.eval_episodes, on.checkpoint_every) == found

    @pytest.mark.slow
    def test_interrupt_before_first_checkpoint_resumes(self, whole, tmp_path, monkeypatch):
        folder = tmp_path / "run"
        monkeypatch.setattr(trainer.Trainer, "save", lambda *state: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            ppo.run(config(folder))
        monkeypatch.undo()
        resumed(folder)
        assert_same_run(whole, folder)

    @pytest.mark.slow
    @pytest.mark.parametrize("kills", first_fast([1, 4]))
    def test_kill_at_random_times_resumes(self, kills, whole, tmp_path):
        folder, moments = tmp_path / "run", random.Random(kills)
        words = flags(folder)
        for _ in range(kills):
            before, deadline = self.step_of(folder), time.monotonic() + 120
            command = [sys.executable, "-m", "train.cli", "train", *words]
            pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
            process = subprocess.Popen(command, text=True, **pipes)
            while self.step_of(folder) == before and process.poll() is None:
                assert time.monotonic() < deadline
                time.sleep(0.01)
            time.sleep(moments.uniform(0.0, 0.3))
            process.kill()
            _, said = process.communicate()
            assert process.returncode in (0, -signal.SIGKILL), said
            words = ["--resume", str(folder)]
        resumed(folder)
        assert_same_run(whole, folder)

    def step_of(self, folder):
        """Description of the newest checkpoint."""
        try:
            return checkpoints.describe(checkpoints.find(folder))["step"]
        except checkpoints.CheckpointError:
            return -1


class TestRefusals:
    """One-line error without side effects."""

    @pytest.fixture
    def refused(self, one_line):
        """Function that asserts that resuming a folder fails with a message."""

        def refuse(message, folder, *words):
            before = contents(folder)
            assert message in one_line("train", "--resume", folder, *words)
            assert contents(folder) == before

        return refuse

    def test_missing_run_or_occupied_folder_is_rejected(self, whole, tmp_path, refused, one_line):
        refused("it contains no run to resume", tmp_path)
        refused("No such file or directory", tmp_path / "nowhere")
        assert not (tmp_path / "nowhere").exists()
        assert "contains a run; --resume it" in one_line("train", *flags(whole))
        words = "--scenario", "clutter-8"
        refused("was trained with clutter-4: omit it", whole, *words)
        refused("--hidden is 8 16; ", whole, "--hidden", "8", "16")
        refused("resumes in its own folder: omit it", whole, "--out", "elsewhere")
        refused("--num-threads is 0; it must be 1", whole, "--num-threads", "0")

    def test_changed_scenario_is_rejected(self, tmp_path, refused):
        file, folder = tmp_path / "own.toml", tmp_path / "run"
        scenarios.get("clutter-4").to_toml(file)
        said = {"scenario": str(file), "total_steps": UPDATE, "eval_every": 0}
        assert ppo.run(config(folder, **said)).status == 0
        assert resumed(folder).steps == UPDATE
        scenarios.get("clutter-4").replace(time_limit=5.0, max_speed=0.5).to_toml(file)
        refused("has changed since", folder)
        refused("other time_limit, max_speed; restore it, or begin a new run", folder)
        file.unlink()
        refused(f"scenario {file} cannot be read: No such file or directory", folder)

    def test_run_without_valid_checkpoint_is_rejected(self, copied, refused):
        for place in (copied / "checkpoints").glob("step-*"):
            (place / "state.safetensors").unlink()
        refused("state.safetensors: cannot be read", copied)

    def test_unwritable_folder_is_rejected(self, copied, tmp_path, one_line, without_rights):
        with without_rights(copied):
            assert "Permission denied" in one_line("train", "--resume", copied)
        with without_rights(tmp_path):
            assert "Permission denied" in one_line("train", *flags(tmp_path / "new"))

    @pytest.mark.slow
    def test_full_disk_is_reported(self, tmp_path, one_line, monkeypatch):
        folder, real = tmp_path / "run", checkpoint.write

        def write(run, step, *content):
            if step > 2000:
                raise OSError(errno.ENOSPC, "No space left on device")
            return real(run, step, *content)

        monkeypatch.setattr(checkpoint, "write", write)
        said = one_line("train", *flags(folder))
        good = checkpoints.find(folder)
        assert "No space left on device" in said and f"last valid checkpoint is {good}" in said
        monkeypatch.undo()
        learned_policy.load(folder, scenarios.get("clutter-4"))
        assert cli.main(["train", "--resume", str(folder)]) == 0

    def test_folder_in_place_of_file_is_rejected(self, copied, one_line):
        pointer = copied / "checkpoints" / "latest.json"
        pointer.unlink()
        pointer.mkdir()
        said = one_line("train", "--resume", copied, "--total-steps", 20 * UPDATE)
        assert f"cannot write {pointer}: Is a directory; the last valid checkpoint" in said
        assert f"fix the error, then --resume {copied}" in said

    @pytest.mark.parametrize(
        ("name", "old", "new", "message"),
        [
            ("metrics.csv", None, b"step\xff\n", "metrics.csv: not readable ('utf-8' codec"),
            ("metrics.csv", None, b"step\n1\n", "metrics.csv: line 1 is not step,update"),
            (
                "metrics.csv",
                b"\n2048,",
                b"\nx2048,",
                "line 5: step is 'x2048'; it must be an integer",
            ),
            ("metrics.csv", b"\n2048,", b"\n7,8\n2048,", "line 5 has 2 cells, not 19"),
            ("evaluation.csv", None, b"a,b\n", "evaluation.csv: line 1 is not step,scenario"),
            ("config.json", None, b"[" * 100_000, "config.json: it is nested too deeply"),
            ("config.json", None, b"\xff", "config.json: 'utf-8' codec"),
            ("config.json", None, b"[]", "config.json: the configuration is a list"),
            ("config.json", b'clearance": 0.2', b'clearance": NaN', "--clearance is nan; it must"),
            (
                "config.json",
                b'num_envs": 8',
                b'num_envs": "8"',
                "num_envs is '8'; it must be of type",
            ),
            ("config.json", b" 16\n", b' 16, "6"\n', "hidden is (16, '6'); it must be of type"),
            ("config.json", b"clutter-4", b"clutter-8", "belongs to another run"),
        ],
    )
    def test_damaged_file_is_rejected(self, copied, refused, name, old, new, message):
        was = (copied / name).read_bytes()
        assert old is None or was.count(old) == 1
        (copied / name).write_bytes(new if old is None else was.replace(old, new))
        refused(message, copied)
