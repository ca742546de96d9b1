"""``rendezvous train``: it learns, repeats, stops, goes on, and says what is wrong."""

import dataclasses
import errno
import importlib.util
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from baselines.learned import checkpoints, learned_policy
from baselines.learned.policy_settings import CHOICES
from rendezvous_env.obstacles.fields import ObstacleField
from rendezvous_env.scenario import scenarios
from train import cli, results
from train.checks import UserError
from train.learn import checkpoint, ppo, rollout_buffer, trainer
from train.learn.log import EVALUATION, METRICS, WALL_TIME, Table
from train.learn.ppo import Config

SMALL = {
    "scenario": "clutter-4",
    "num_teams": 8,
    "n_steps": 16,
    "batch_size": 128,
    "epochs": 2,
    "total_steps": 12 * 8 * 4 * 16,
    "set_width": 8,
    "hidden": (16,),
    "eval_every": 2000,
    "eval_starts": 4,
    "checkpoint_every": 1000,
    "tensorboard": False,
    "num_threads": 1,
}
"""Twelve updates of 512 steps."""
UPDATE = 512


def config(out, **changes):
    return Config(**SMALL | {"out": out} | changes)


def flags(out, **changes):
    """The same as words of a command line."""
    words = ["--out", str(out)]
    for name, value in (SMALL | changes).items():
        flag = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", *map(str, value if isinstance(value, tuple) else (value,))]
    return words


def metrics(folder):
    """Rows without the columns that tell of time."""
    rows = results.read_csv(folder / "metrics.csv")
    return [{key: value for key, value in row.items() if key not in WALL_TIME} for row in rows]


def network(folder):
    return checkpoints.read(checkpoints.find(folder), ["network"])[1]["network"]


def assert_same_run(one, other):
    assert metrics(one) == metrics(other)
    assert (one / "evaluation.csv").read_text() == (other / "evaluation.csv").read_text()
    for name, weights in network(one).items():
        np.testing.assert_array_equal(weights, network(other)[name], name)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of a run that nothing stopped."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    assert ppo.run(config(folder)).status == 0
    return folder


class TestFiles:
    def test_metrics(self, whole):
        rows = results.read_csv(whole / "metrics.csv")
        assert tuple(rows[0]) == METRICS
        assert [int(row["step"]) for row in rows] == [UPDATE * (k + 1) for k in range(12)]
        assert [int(row["update"]) for row in rows] == list(range(1, 13))
        rates = [float(row["learning_rate"]) for row in rows]
        first = config(whole).learning_rate
        expected = [first * max(1 - (k + 1) / 12, 0.05) for k in range(12)]
        np.testing.assert_allclose(rates, expected)
        ended = [row for row in rows if int(row["episodes"])]
        assert ended and all(0 <= float(row["clean_success"]) <= 1 for row in ended)
        for row in rows:
            assert 0.05 <= float(row["alignment"]) <= 1
            assert 0 < float(row["environment_share"]) < 1 and float(row["wall_s"]) > 0

    def test_evaluation_is_that_of_compare(self, whole):
        from train.compare.compare import Job, play_job, summary

        rows = results.read_csv(whole / "evaluation.csv")
        assert tuple(rows[0]) == EVALUATION
        assert [int(row["step"]) for row in rows] == [2048, 4096, 6144]
        scenario = scenarios.get("clutter-4")
        job = Job(scenario, f"learned:{whole}")
        expected = summary(play_job(job, episodes=4, seed=ppo.EVALUATION_SEEDS))
        for name in results.RESULT_COLUMNS[2:]:
            assert rows[-1][name] == str(results.plain(expected[name])), name

    def test_starts_are_apart(self, whole):
        """Training from 2^62, evaluation from 2^61, compare from 0: none meets another."""
        assert config(whole, seed=2**29 - 1).first_seed + 2**32 < 2**63
        assert ppo.EVALUATION_SEEDS + 10**9 < config(whole).first_seed
        state = checkpoints.read(checkpoints.find(whole), ["state"])[1]["state"]
        seeds = state["robots/teams/env/seed"]
        np.testing.assert_array_equal(seeds, config(whole).first_seed + np.arange(8))

    def test_checkpoint(self, whole):
        about, tables = checkpoints.read(checkpoints.find(whole), trainer.STATE_FILES)
        assert about["step"] == 12 * UPDATE
        assert Config.from_plain(about["config"]) == config(whole)
        assert {"torch", "stable-baselines3", "numpy"} <= about["provenance"]["versions"].keys()
        assert {name.split("/")[1] for name in tables["optimizer"]} >= {"exp_avg", "exp_avg_sq"}
        assert len(list((whole / "checkpoints").glob("step-*"))) == checkpoint.KEPT
        size = (checkpoints.find(whole) / "network.safetensors").stat().st_size
        assert size < 2_000_000

    def test_the_policy_can_be_compared(self, whole, tmp_path):
        words = ["--scenarios", "clutter-4", "--policies", "bearing-only", f"learned:{whole}"]
        out = ["--episodes", "3", "--keep", "1", "--no-figures", "--out", str(tmp_path)]
        assert cli.main(["compare", *words, *out]) == 0
        rows = results.read_csv(tmp_path / "results.csv")
        assert [row["policy"] for row in rows] == ["bearing-only", f"learned:{whole}"]
        assert float(rows[1]["min_alignment"]) >= 0.05 - 1e-6

    def test_what_is_shipped_is_enough(self, whole, tmp_path):
        checkpoint.ship(whole, tmp_path / "pretrained")
        written = {path.name for path in (tmp_path / "pretrained").iterdir()}
        assert written == {
            "checkpoint.json", "network.safetensors", "metrics.csv", "evaluation.csv"
        }  # fmt: skip
        loaded = learned_policy.load(tmp_path / "pretrained", scenarios.get("fig4"))
        assert loaded.settings == config(whole).policy_settings()
        about = checkpoints.describe(tmp_path / "pretrained")
        assert about["config"]["total_steps"] == 12 * UPDATE

    def test_tensorboard(self, tmp_path):
        folder = tmp_path / "run"
        changed = config(folder, tensorboard=True, total_steps=UPDATE, eval_every=0)
        assert ppo.run(changed).status == 0
        assert [path.stat().st_size > 500 for path in (folder / "tensorboard").iterdir()] == [True]


class TestLearning:
    def test_weights_move_and_the_rule_is_where_it_starts(self, whole, tmp_path):
        begun = trainer.Trainer(config(tmp_path))
        begun.model.policy.set_training_mode(False)
        start = {k: v.numpy() for k, v in begun.model.policy.state_dict().items()}
        assert start["action_net.bias"].tolist() == [3.0, *[0.0] * (CHOICES - 1)]
        moved = [name for name, value in network(whole).items() if (value != start[name]).any()]
        assert set(moved) == set(start)

    def test_a_reward_is_learned(self, tmp_path):
        """Where only progress counts, straight towards f is best, however random it begins."""
        changed = config(
            tmp_path / "run", total_steps=16 * 2048, num_teams=32, prior=0.0, touch_penalty=0.0,
            learning_rate=3e-3, epochs=4, batch_size=512, progress=20.0, time_penalty=0.0,
            rendezvous_bonus=0.0, curriculum=(0,), eval_every=0, gamma=0.9,
        )  # fmt: skip
        assert ppo.run(changed).status == 0
        rows = results.read_csv(tmp_path / "run" / "metrics.csv")
        alignment = [float(row["alignment"]) for row in rows]
        assert np.mean(alignment[-4:]) > np.mean(alignment[:4]) + 0.1

    def test_curriculum(self, tmp_path):
        changed = config(
            tmp_path / "run", curriculum=(0, 3), fewest_obstacles=1, total_steps=4 * UPDATE
        )
        assert changed.stage_scenario(0).obstacles.count == (0, 0)
        assert changed.stage_scenario(1).obstacles.count == (1, 3)
        assert changed.obstacle_slots() == 3
        assert ppo.run(changed).status == 0
        rows = results.read_csv(tmp_path / "run" / "metrics.csv")
        assert [row["stage"] for row in rows] == ["0", "0", "1", "1"]
        other = dataclasses.replace(changed, out=tmp_path / "other")
        stopped_after(other, 3)
        assert ppo.run(Config(resume=other.out)).status == 0
        assert_same_run(changed.out, other.out)

    def test_weights_of_another_run_to_start_from(self, whole, tmp_path):
        begun = trainer.Trainer(config(tmp_path, start_from=whole))
        begun.begin()
        for name, weights in network(whole).items():
            np.testing.assert_array_equal(network(tmp_path)[name], weights)
        wider = config(tmp_path / "wider", start_from=whole, set_width=9)
        with pytest.raises(UserError, match="another network"):
            ppo.run(wider)


def stopped_after(settings, updates, number=signal.SIGTERM):
    """Run until a signal comes after some updates; the exit status."""
    real, done = trainer.Trainer.report, 0

    def report(self):
        nonlocal done
        done += 1
        if done == updates:
            os.kill(os.getpid(), number)
        return real(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer.Trainer, "report", report)
        return ppo.run(settings).status


class TestResult:
    """What the program that called gets, and what it is told on the way."""

    def test_it_holds_the_last_metrics_and_the_best_evaluation(self, tmp_path):
        told = []
        result = ppo.run(
            config(tmp_path, eval_every=2 * UPDATE, eval_starts=6),
            on_update=lambda update, metrics: told.append((update, metrics)),
        )
        assert result.folder == tmp_path and result.status == 0 and not result.stopped
        assert [update for update, _ in told] == list(range(1, len(told) + 1))
        assert result.steps == told[-1][1]["step"] == len(told) * UPDATE
        assert dict(result.metrics) | {"evaluation": told[-1][1]["evaluation"]} == told[-1][1]
        evaluated = [metrics["evaluation"][0] for _, metrics in told if metrics["evaluation"]]
        assert [row["step"] for row in evaluated] == [row["step"] for row in result.evaluations]
        for one, other in zip(evaluated, result.evaluations, strict=True):
            assert one["clean_success"] == other["clean_success"] and one["scenario"] == "clutter-4"
        assert result.final[0]["step"] == result.steps
        clean = [row["clean_success"] for row in evaluated]
        assert result.best[0]["step"] == evaluated[clean.index(max(clean))]["step"]

    def test_the_best_is_that_of_all_scenarios(self, tmp_path):
        def row(step, clean, success=1.0):
            return {"step": step, "clean_success": clean, "success": success}

        rows = (row(1, 0.9), row(1, 0.1), row(2, 0.6), row(2, 0.6), row(3, 0.6), row(3, 0.6))
        result = ppo.Result(tmp_path, 0, False, 3, {}, rows)
        assert result.best == rows[2:4] and result.final == rows[4:]
        nothing = ppo.Result(tmp_path, 0, False, 3, {}, ())
        assert nothing.best == nothing.final == ()
        through = (row(1, math.nan, 0.2), row(2, math.nan, 0.3))
        assert ppo.Result(tmp_path, 0, False, 2, {}, through).best == through[1:]

    def test_who_returns_true_ends_it_and_it_can_go_on(self, whole, tmp_path, capsys):
        folder = tmp_path / "run"
        result = ppo.run(config(folder), on_update=lambda update, metrics: update == 3)
        assert result.stopped and result.status == 0 and result.steps == 3 * UPDATE
        assert f"stopped by on_update: {3 * UPDATE:,} steps" in capsys.readouterr().out
        assert checkpoints.find(folder).name == f"step-{3 * UPDATE:012d}"
        assert ppo.run(Config(resume=folder)).status == 0
        assert_same_run(folder, whole)

    def test_a_pruned_trial_passes_through(self, tmp_path):
        """As Optuna's, which is raised in the middle."""

        class TrialPrunedError(Exception):
            pass

        def prune(update, metrics):
            raise TrialPrunedError

        with pytest.raises(TrialPrunedError):
            ppo.run(config(tmp_path / "run"), on_update=prune)
        assert ppo.run(Config(resume=tmp_path / "run", total_steps=UPDATE)).steps == UPDATE


class TestResume:
    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
    def test_a_signal_keeps_all_whole_updates(self, whole, tmp_path, number, capsys):
        """It comes while the fourth is being told; checkpoints are written every other update."""
        folder = tmp_path / "run"
        assert stopped_after(config(folder), 4, number) == 128 + number
        assert checkpoints.find(folder).name == f"step-{3 * UPDATE:012d}"
        assert ppo.run(Config(resume=folder)).status == 0
        said = capsys.readouterr().out
        assert f"at step {3 * UPDATE:,}" in said and f"step-{3 * UPDATE:012d}" in said
        assert_same_run(whole, folder)

    def test_a_second_signal_leaves_at_once(self, tmp_path, monkeypatch):
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

    def test_rows_after_the_checkpoint_go(self, whole, tmp_path):
        """What a kill leaves: rows of updates that will be done again, and half a row."""
        folder = tmp_path / "run"
        stopped_after(config(folder), 4)
        assert ppo.run(Config(resume=folder, total_steps=6 * UPDATE)).status == 0
        for place in checkpoints.candidates(folder)[:1]:
            shutil.rmtree(place)
        with (folder / "metrics.csv").open("a") as file:
            file.write("99999,")
        assert ppo.run(Config(resume=folder, total_steps=12 * UPDATE)).status == 0
        steps = [int(row["step"]) for row in metrics(folder)]
        assert steps == [UPDATE * (k + 1) for k in range(12)]

    def test_a_broken_checkpoint_is_left_out(self, whole, tmp_path, capsys):
        folder = tmp_path / "run"
        stopped_after(config(folder), 5)
        newest, older = checkpoints.candidates(folder)
        file = newest / "optimizer.safetensors"
        file.write_bytes(file.read_bytes()[:-10])
        assert ppo.run(Config(resume=folder)).status == 0
        said = capsys.readouterr().out
        assert "truncated" in said and f"resumes {older}" in said
        assert_same_run(whole, folder)

    def test_a_finished_run(self, whole, tmp_path, capsys):
        folder = tmp_path / "run"
        shutil.copytree(whole, folder)
        before = metrics(folder)
        assert ppo.run(Config(resume=folder)).status == 0
        assert "nothing was left to do" in capsys.readouterr().out
        assert metrics(folder) == before

    @pytest.mark.parametrize(
        "more",
        [{}, {"memory": "features"}, {"memory": "recurrent", "critic": "global"}],
        ids=["plain", "features", "recurrent and global"],
    )
    def test_with_a_tank(self, tmp_path, more):
        """Ledgers and memory of running episodes are part of a checkpoint."""
        tank = {"guarantee": "tank", "budget": 2.0, "eval_every": 1500, "prior": 0.5} | more
        short = tank | {"total_steps": 4 * UPDATE}
        assert ppo.run(config(tmp_path / "whole", **short)).status == 0
        assert stopped_after(config(tmp_path / "run", **short), 3) == 128 + signal.SIGTERM
        assert ppo.run(Config(resume=tmp_path / "run")).status == 0
        assert_same_run(tmp_path / "whole", tmp_path / "run")
        about, tables = checkpoints.read(checkpoints.find(tmp_path / "run"), trainer.STATE_FILES)
        levels = tables["state"]["robots/teams/tank/levels"]
        assert levels.shape == (8, 4) and (levels >= 0.0).all() and (levels != 2.0).any()
        assert about["policy"]["guarantee"] == "tank" and about["policy"]["budget"] == 2.0 / (
            0.2 * 3
        )

    def test_memory_with_certified_headings(self, tmp_path):
        more = {"memory": "recurrent", "memory_units": 4, "total_steps": 2 * UPDATE}
        assert ppo.run(config(tmp_path, eval_every=UPDATE, **more)).status == 0
        rows = results.read_csv(tmp_path / "evaluation.csv")
        assert len(rows) == 2
        assert all(float(row["min_alignment"]) >= 0.05 - 1e-6 for row in rows)
        assert network(tmp_path)["memory.weight_hh"].shape == (12, 4)

    def test_a_run_of_a_version_without_tanks(self, whole, tmp_path):
        folder = shutil.copytree(whole, tmp_path / "run")
        plain = json.loads((folder / "config.json").read_text())
        for name in ("guarantee", "budget", "memory", "memory_units", "critic"):
            del plain[name]
        (folder / "config.json").write_text(json.dumps(plain))
        assert ppo.run(Config(resume=folder)).status == 0
        assert ppo.run(Config(resume=folder, total_steps=13 * UPDATE)).status == 0

    def test_before_the_first_checkpoint(self, whole, tmp_path, monkeypatch):
        folder = tmp_path / "run"

        def killed(self):
            raise KeyboardInterrupt

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(trainer.Trainer, "save", killed)
            with pytest.raises(KeyboardInterrupt):
                ppo.run(config(folder))
        assert ppo.run(Config(resume=folder)).status == 0
        assert_same_run(whole, folder)


class TestMistakes:
    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["--scenario", "clutter-5"], "did you mean 'clutter-"),
            (["--scenario", "uav-6"], "train teaches single_integrator robots in 2-D"),
            (["--eval-scenarios", "unicycle-6"], "learned policies steer"),
            (["--scenario", "fig4", "--curriculum", "3"], "fig4 draws no obstacles"),
            (["--curriculum", "-1"], "must be ≥ 0"),
            (["--num-teams", "0"], "--num-teams is 0; it must be 1 or more"),
            (["--gamma", "1.5"], "--gamma is 1.5; it must be in [0, 1]"),
            (["--min-alignment", "1"], "--min-alignment is 1.0; it must be in (0, 1)"),
            (["--learning-rate", "nan"], "--learning-rate is nan; it must be a finite number"),
            (["--seed", str(2**29)], "must be below 2^29"),
            (["--budget", "3"], "--budget is 3.0; headings have none: add --guarantee tank"),
            (
                ["--memory", "features"],
                "--memory is features; headings have none: add --guarantee tank",
            ),
            (
                ["--memory-units", "9"],
                "--memory-units is 9; there are none without --memory recurrent",
            ),
            (["--memory-units", "0"], "--memory-units is 0; it must be 1 or more"),
            (["--guarantee", "tank", "--budget", "-1"], "--budget is -1.0; it must be 0 or more"),
            (["--start-from", "nowhere"], "nowhere: no such folder"),
        ],
    )
    def test_one_line_and_status_2(self, words, message, capsys, tmp_path):
        assert cli.main(["train", *flags(tmp_path / "out"), *words]) == 2
        said = capsys.readouterr().err
        assert message in said and said.count("\n") == 1 and "Traceback" not in said

    def test_resume_what_is_not_there(self, tmp_path, capsys):
        assert cli.main(["train", "--resume", str(tmp_path)]) == 2
        assert "it holds no run that can go on" in capsys.readouterr().err

    def test_the_folder_of_another_run(self, whole, capsys):
        assert cli.main(["train", *flags(whole)]) == 2
        assert "holds a run; --resume it" in capsys.readouterr().err

    def test_a_flag_that_would_make_it_another_run(self, whole, capsys):
        assert cli.main(["train", "--resume", str(whole), "--scenario", "clutter-8"]) == 2
        assert "was trained with clutter-4: leave it out" in capsys.readouterr().err

    def test_checkpoints_of_another_run(self, whole, tmp_path, capsys):
        folder = tmp_path / "run"
        shutil.copytree(whole, folder)
        plain = json.loads((folder / "config.json").read_text())
        (folder / "config.json").write_text(json.dumps(plain | {"scenario": "clutter-8"}))
        assert cli.main(["train", "--resume", str(folder)]) == 2
        assert "is of another run" in capsys.readouterr().err

    def test_no_good_checkpoint(self, whole, tmp_path, capsys):
        folder = tmp_path / "run"
        shutil.copytree(whole, folder)
        for place in (folder / "checkpoints").glob("step-*"):
            (place / "state.safetensors").unlink()
        assert cli.main(["train", "--resume", str(folder)]) == 2
        assert "state.safetensors: cannot be read" in capsys.readouterr().err

    def test_a_folder_without_permission(self, whole, tmp_path, capsys, without_rights):
        folder = tmp_path / "run"
        shutil.copytree(whole, folder)
        with without_rights(folder):
            assert cli.main(["train", "--resume", str(folder)]) == 2
        with without_rights(tmp_path):
            assert cli.main(["train", *flags(tmp_path / "new")]) == 2
        said = capsys.readouterr().err
        assert said.count("Permission denied") == 2 and said.count("\n") == 2

    def test_a_full_disk(self, tmp_path, capsys, monkeypatch):
        folder, real = tmp_path / "run", checkpoint.write

        def write(run, step, *content):
            if step > 2000:
                raise OSError(errno.ENOSPC, "No space left on device")
            return real(run, step, *content)

        monkeypatch.setattr(checkpoint, "write", write)
        assert cli.main(["train", *flags(folder)]) == 2
        said = capsys.readouterr().err
        good = checkpoints.find(folder)
        assert "No space left on device" in said and f"last good checkpoint is {good}" in said
        monkeypatch.undo()
        learned_policy.load(folder, scenarios.get("clutter-4"))
        assert cli.main(["train", "--resume", str(folder)]) == 0

    def test_no_extra(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
        assert cli.main(["train", *flags(tmp_path / "run")]) == 2
        assert "pip install" in capsys.readouterr().err


class TestKilled:
    def start(self, words):
        command = [sys.executable, "-m", "train.cli", "train", *words]
        return subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )

    def step_of(self, folder):
        try:
            return checkpoints.describe(checkpoints.find(folder))["step"]
        except checkpoints.CheckpointError:
            return -1

    def kill_often(self, folder, kills, seed, **changes):
        """Kill runs at random moments after a sign of life; every resume must go on."""
        moments = random.Random(seed)
        words = flags(folder, **changes)
        for _ in range(kills):
            process = self.start(words)
            before, deadline = self.step_of(folder), time.monotonic() + 120
            while self.step_of(folder) == before and process.poll() is None:
                assert time.monotonic() < deadline
                time.sleep(0.01)
            time.sleep(moments.uniform(0.0, 0.3))
            process.kill()
            _, said = process.communicate()
            assert process.returncode in (0, -signal.SIGKILL), said
            steps = [int(row["step"]) for row in _readable_rows(folder)]
            lost = max(steps, default=0) - self.step_of(folder)
            assert lost <= changes.get("checkpoint_every", 1000) + UPDATE
            words = ["--resume", str(folder)]
        assert ppo.run(Config(resume=folder)).status == 0

    def test_twice(self, whole, tmp_path):
        self.kill_often(tmp_path / "run", 2, seed=0)
        assert_same_run(whole, tmp_path / "run")

    @pytest.mark.slow
    def test_ten_times(self, tmp_path):
        more = {"total_steps": 80 * UPDATE, "eval_every": 10_000}
        assert ppo.run(config(tmp_path / "whole", **more)).status == 0
        self.kill_often(tmp_path / "run", 10, seed=1, **more)
        assert_same_run(tmp_path / "whole", tmp_path / "run")
        learned_policy.load(tmp_path / "run", scenarios.get("clutter-4"))


def _readable_rows(folder):
    path = folder / "metrics.csv"
    rows = results.read_csv(path) if path.exists() else []
    return [row for row in rows if None not in row.values()]


class TestTable:
    def test_it_is_cut_back_to_a_step(self, tmp_path):
        path = tmp_path / "table.csv"
        table = Table(path, ("step", "value"), 0)
        table.begin()
        for step in (1, 2, 3):
            table.add({"step": step, "value": step / 3})
        with path.open("a") as file:
            file.write("4,0.")
        again = Table(path, ("step", "value"), 2)
        again.begin()
        again.add({"step": 3, "value": float("nan")})
        rows = results.read_csv(path)
        assert [row["step"] for row in rows] == ["1", "2", "3"]
        assert float(rows[0]["value"]) == 1 / 3 and rows[2]["value"] == ""


class TestDamaged:
    """What was written by a run and hurt since; the refusal changes nothing."""

    @pytest.mark.parametrize(
        ("name", "content", "message"),
        [
            ("metrics.csv", b"step\xff\n", "metrics.csv: not readable ('utf-8' codec"),
            ("metrics.csv", b"step\n1\n", "metrics.csv: line 1 is not step,update"),
            ("evaluation.csv", b"a,b\n", "evaluation.csv: line 1 is not step,scenario"),
            ("config.json", b"[" * 100_000, "config.json: it is nested too deeply"),
            ("config.json", b"\xff", "config.json: 'utf-8' codec"),
            ("config.json", b"[]", "config.json: the configuration is a list"),
        ],
    )
    def test_a_file(self, whole, tmp_path, capsys, name, content, message):
        folder = shutil.copytree(whole, tmp_path / "run")
        (folder / name).write_bytes(content)
        self.refused(folder, message, capsys)

    def test_a_row_in_the_middle(self, whole, tmp_path, capsys):
        folder = shutil.copytree(whole, tmp_path / "run")
        lines = (folder / "metrics.csv").read_text().splitlines(keepends=True)
        (folder / "metrics.csv").write_text("".join([*lines[:4], "x" + lines[4], *lines[5:]]))
        self.refused(folder, "line 5: step is 'x2048'; it must be a whole number", capsys)
        (folder / "metrics.csv").write_text("".join([*lines[:4], "7,8\n", *lines[5:]]))
        self.refused(folder, "line 5 has 2 cells, not 19", capsys)

    @pytest.mark.parametrize(
        ("field", "value", "message"),
        [
            ("clearance", float("nan"), "--clearance is nan; it must be a finite number"),
            ("num_teams", "8", "num_teams is '8'; it must be of type int"),
            ("hidden", [16, "16"], "hidden is (16, '16'); it must be of type tuple[int, ...]"),
        ],
    )
    def test_a_setting(self, whole, tmp_path, capsys, field, value, message):
        folder = shutil.copytree(whole, tmp_path / "run")
        plain = json.loads((folder / "config.json").read_text()) | {field: value}
        (folder / "config.json").write_text(json.dumps(plain))
        self.refused(folder, message, capsys)

    def test_no_folder_is_made(self, tmp_path, capsys):
        self.refused(tmp_path / "nowhere", "No such file or directory", capsys)
        assert not (tmp_path / "nowhere").exists()

    def test_threads(self, whole, tmp_path, capsys):
        folder = shutil.copytree(whole, tmp_path / "run")
        message = "--num-threads is 0; it must be 1 or more"
        self.refused(folder, message, capsys, "--num-threads", "0")

    def refused(self, folder, message, capsys, *words):
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        assert cli.main(["train", "--resume", str(folder), *words]) == 2
        said = capsys.readouterr().err
        assert message in said and said.count("\n") == 1 and "Traceback" not in said
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_training_that_diverges_is_a_message(tmp_path, capsys, monkeypatch):
    real = rollout_buffer.RobotPPO.learn

    def learn(self, *given, **options):
        real(self, *given, **options)
        next(self.policy.parameters()).data[0] = np.nan

    monkeypatch.setattr(rollout_buffer.RobotPPO, "learn", learn)
    assert cli.main(["train", *flags(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "training diverged" in said and "--learning-rate below 0.001" in said
    assert checkpoints.find(tmp_path / "run").name == f"step-{0:012d}"


def test_settings_as_plain_data():
    given = Config(out=Path("a"), curriculum=(3, 5), start_from=Path("b"))
    assert Config.from_plain(json.loads(json.dumps(given.to_plain()))) == given
    with pytest.raises(ValueError, match="field 'colour'"):
        Config.from_plain(given.to_plain() | {"colour": 1})
    assert isinstance(given.base_scenario().obstacles, ObstacleField)
