"""``rendezvous train``: learning, reproducibility and logs."""

import json
import math
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import ROOT
from training_runs import UPDATE, assert_goes_on, assert_same_run, config, flags, network, resumed

import rendezvous_env as rv
from baselines.learned import checkpoints, learned_policy
from baselines.learned.policy_settings import CHOICES
from rendezvous_env.safety.safety_filter import FILTERS
from rendezvous_env.scenario import scenarios
from rendezvous_env.scenario.scenario import Scenario
from train import cli, results
from train.checks import UserError
from train.compare.compare import Job, play_job, summary
from train.learn import checkpoint, ppo, rollout_buffer, trainer
from train.learn.log import EVALUATION, METRICS, Table, read_evaluations
from train.learn.ppo import Config


class TestFiles:
    def test_metrics_csv_is_complete(self, whole):
        rows = results.read_csv(whole / "metrics.csv")
        assert tuple(rows[0]) == METRICS
        assert [int(row["step"]) for row in rows] == [UPDATE * (k + 1) for k in range(12)]
        assert [int(row["update"]) for row in rows] == list(range(1, 13))
        rates = [float(row["learning_rate"]) for row in rows]
        first = config(whole).learning_rate
        expected = [first * max(1 - (k + 1) / 12, 0.05) for k in range(12)]
        np.testing.assert_allclose(rates, expected)
        ended = [row for row in rows if int(row["episodes"])]
        assert ended and all(0 <= float(row["collision_free_success"]) <= 1 for row in ended)
        for row in rows:
            assert 0.05 <= float(row["alignment"]) <= 1
            assert 0 < float(row["environment_share"]) < 1 and float(row["wall_s"]) > 0

    def test_evaluation_equals_compare(self, whole):
        rows = results.read_csv(whole / "evaluation.csv")
        assert tuple(rows[0]) == EVALUATION
        assert [int(row["step"]) for row in rows] == [2048, 4096, 6144]
        job = Job(scenarios.get("clutter-4"), f"learned:{whole}")
        expected = summary(play_job(job, episodes=4, seed=ppo.EVALUATION_SEEDS))
        for name in results.RESULT_COLUMNS[2:]:
            assert rows[-1][name] == str(results.plain(expected[name])), name

    def test_checkpoint_is_complete(self, whole):
        """Seeds of training (from 2^62), evaluation (2^61) and compare (0) are disjoint."""
        own, place = config(whole), checkpoints.find(whole)
        about, tables = checkpoints.read(place, trainer.STATE_FILES)
        assert about["step"] == 12 * UPDATE and Config.from_plain(about["config"]) == own
        assert {"torch", "stable-baselines3", "numpy"} <= about["provenance"]["versions"].keys()
        assert {name.split("/")[1] for name in tables["optimizer"]} >= {"exp_avg", "exp_avg_sq"}
        assert len(list((whole / "checkpoints").glob("step-*"))) == checkpoint.KEPT
        assert (place / "network.safetensors").stat().st_size < 2_000_000
        loaded = learned_policy.load(whole, scenarios.get("fig4"))
        assert loaded.settings == own.policy_settings()
        seeds = tables["state"]["robots/teams/env/seed"]
        np.testing.assert_array_equal(seeds, own.first_seed + np.arange(8))
        assert ppo.EVALUATION_SEEDS + 10**9 < own.first_seed
        assert config(whole, seed=2**29 - 1).first_seed + 2**32 < 2**63

    def test_tensorboard_events_are_written(self, tmp_path):
        changed = config(tmp_path, tensorboard=True, total_steps=UPDATE, eval_every=0)
        assert ppo.run(changed).status == 0
        (events,) = (tmp_path / "tensorboard").iterdir()
        assert events.stat().st_size > 500


class TestLearning:
    def test_weights_change_and_policy_starts_as_rule(self, whole, tmp_path):
        policy = trainer.Trainer(config(tmp_path)).model.policy
        assert policy.action_net.bias.tolist() == [3.0, *[0.0] * (CHOICES - 1)]
        tank = trainer.Trainer(config(tmp_path, guarantee="tank", budget=2.0))
        assert not tank.model.policy.action_net.bias.any()
        for name, start in policy.state_dict().items():
            assert (network(whole)[name] != start.numpy()).any(), name

    def test_reward_is_learned(self, tmp_path):
        """With a reward for progress only, motion along f is optimal from any initialisation."""
        changed = config(
            tmp_path / "run", total_steps=16 * 2048, num_envs=32, prior=0.0, contact_penalty=0.0,
            learning_rate=3e-3, epochs=4, batch_size=512, progress=20.0, time_penalty=0.0,
            rendezvous_bonus=0.0, curriculum=(0,), eval_every=0, gamma=0.9,
        )  # fmt: skip
        assert ppo.run(changed).status == 0
        rows = results.read_csv(tmp_path / "run" / "metrics.csv")
        alignment = [float(row["alignment"]) for row in rows]
        assert np.mean(alignment[-4:]) > np.mean(alignment[:4]) + 0.1

    @pytest.mark.slow
    def test_curriculum_changes_obstacles(self, tmp_path):
        stages = {"curriculum": (0, 3), "fewest_obstacles": 1, "total_steps": 4 * UPDATE}
        changed = config(tmp_path, **stages)
        assert changed.stage_scenario(0).obstacles.count == (0, 0)
        assert changed.stage_scenario(1).obstacles.count == (1, 3)
        assert changed.obstacle_slots() == 3
        rows = results.read_csv(assert_goes_on(tmp_path, 3, **stages) / "metrics.csv")
        assert [row["stage"] for row in rows] == ["0", "0", "1", "1"]

    def test_start_from_loads_weights(self, whole, tmp_path):
        trainer.Trainer(config(tmp_path, start_from=whole)).begin()
        for name, weights in network(whole).items():
            np.testing.assert_array_equal(network(tmp_path)[name], weights)
        with pytest.raises(UserError, match="another network"):
            ppo.run(config(tmp_path / "wider", start_from=whole, set_width=9))

    @pytest.mark.slow
    def test_scenario_overrides_apply(self, tmp_path, capsys):
        """As ``compare --set``; held-out initial conditions also use the changed scenario."""
        more = {"total_steps": 2 * 8 * 3 * 16, "eval_every": 1}
        words = flags(tmp_path / "run", **more, set=("n_robots=3", "time_limit=20"))
        assert cli.main(["train", *words]) == 0
        (row, _) = results.read_csv(tmp_path / "run" / "evaluation.csv")
        name = "clutter-4-n-robots-3-time-limit-20"
        assert row["scenario"] == name and float(row["median_time"]) <= 20
        about = checkpoints.describe(checkpoints.find(tmp_path / "run"))
        assert about["scenario"]["n_robots"] == 3 and about["scenario"]["name"] == name
        assert cli.main(["train", "--resume", str(tmp_path / "run"), "--set", "n_robots=4"]) == 2
        assert "was trained with n_robots=3 time_limit=20" in capsys.readouterr().err
        resumed(tmp_path / "run", total_steps=3 * 8 * 3 * 16)

    def test_divergence_is_reported(self, tmp_path, capsys, monkeypatch):
        real = rollout_buffer.RobotPPO.learn

        def learn(self, *given, **options):
            real(self, *given, **options)
            next(self.policy.parameters()).data[0] = np.nan

        monkeypatch.setattr(rollout_buffer.RobotPPO, "learn", learn)
        assert cli.main(["train", *flags(tmp_path / "run")]) == 2
        said = capsys.readouterr().err
        assert "training diverged" in said and "--learning-rate below 0.001" in said
        assert checkpoints.find(tmp_path / "run").name == f"step-{0:012d}"


class TestResult:
    """Results of the Python API, and its callbacks."""

    @pytest.mark.slow
    def test_result_holds_last_metrics_and_best_evaluation(self, tmp_path):
        told = []
        result = ppo.run(
            config(tmp_path, eval_every=2 * UPDATE, eval_episodes=6),
            on_update=lambda update, metrics: told.append((update, metrics)),
        )
        assert result.folder == tmp_path and result.status == 0 and not result.stopped
        assert [update for update, _ in told] == list(range(1, len(told) + 1))
        assert result.steps == told[-1][1]["step"] == len(told) * UPDATE
        assert dict(result.metrics) | {"evaluation": told[-1][1]["evaluation"]} == told[-1][1]
        evaluated = [metrics["evaluation"][0] for _, metrics in told if metrics["evaluation"]]
        for one, other in zip(evaluated, result.evaluations, strict=True):
            for name in ("step", "scenario", "collision_free_success"):
                assert one[name] == other[name]
        assert result.final[0]["step"] == result.steps
        clean = [row["collision_free_success"] for row in evaluated]
        assert result.best[0]["step"] == evaluated[clean.index(max(clean))]["step"]

    def test_former_columns_of_logs_are_read_and_replaced(self, whole, tmp_path):
        path = tmp_path / "metrics.csv"
        text = (whole / "metrics.csv").read_text(encoding="utf-8")
        path.write_text(text.replace("collision_free_", "clean_"), encoding="utf-8")
        assert "clean_success" in path.read_text(encoding="utf-8")
        Table(path, METRICS, step=10**9).begin()
        assert path.read_text(encoding="utf-8") == text
        shipped = ROOT / "baselines/learned/pretrained/evaluation.csv"  # of an earlier version
        (first, *_) = read_evaluations(shipped, 10**9)
        assert 0.0 < first["collision_free_low"] <= first["collision_free_success"] <= 1.0
        with pytest.warns(DeprecationWarning, match="'clean_success' is called 'collision_free_s"):
            assert first["clean_success"] == first["collision_free_success"]

    def test_progress_line_omits_missing_values(self, tmp_path, capsys):
        """No rendezvous in two seconds, and no contacts where robots pass through obstacles."""
        fields = ("obstacle_contact=ignore", "time_limit=2")
        ppo.run(config(tmp_path, total_steps=UPDATE, eval_every=1, set=fields))
        said = capsys.readouterr().out
        assert "met 0 % · collision-free 0 % · – s" in said and "collision-free – [–, –] %" in said
        assert "nan" not in said

    def test_best_evaluation_is_over_all_scenarios(self, tmp_path):
        def row(step, clean, success=1.0):
            return {"step": step, "collision_free_success": clean, "success": success}

        def result_of(*rows):
            return ppo.Result(tmp_path, 0, False, 3, {}, rows)

        rows = (row(1, 0.9), row(1, 0.1), row(2, 0.6), row(2, 0.6), row(3, 0.6), row(3, 0.6))
        assert result_of(*rows).best == rows[2:4] and result_of(*rows).final == rows[4:]
        assert result_of().best == result_of().final == ()
        through = (row(1, math.nan, 0.2), row(2, math.nan, 0.3))
        assert result_of(*through).best == through[1:]

    @pytest.mark.slow
    def test_callback_returning_true_ends_resumable_run(self, whole, tmp_path, capsys):
        folder = tmp_path / "run"
        result = ppo.run(config(folder), on_update=lambda update, metrics: update == 3)
        assert result.stopped and result.status == 0 and result.steps == 3 * UPDATE
        assert f"stopped by on_update: {3 * UPDATE:,} steps" in capsys.readouterr().out
        assert checkpoints.find(folder).name == f"step-{3 * UPDATE:012d}"
        resumed(folder)
        assert_same_run(folder, whole)

    @pytest.mark.slow
    def test_double_precision_default_does_not_change_run(self, whole, tmp_path):
        torch.set_default_dtype(torch.float64)
        try:
            ppo.run(config(tmp_path / "run"))
            assert torch.get_default_dtype() is torch.float64
        finally:
            torch.set_default_dtype(torch.float32)
        assert_same_run(tmp_path / "run", whole)

    @pytest.mark.slow
    def test_pruned_trial_exception_propagates(self, tmp_path):
        """As Optuna's exception, which is raised in the middle."""
        with pytest.raises(ZeroDivisionError):
            ppo.run(config(tmp_path / "run"), on_update=lambda update, metrics: 1 / 0)
        assert resumed(tmp_path / "run", total_steps=UPDATE).steps == UPDATE


class TestSettings:
    def test_evaluation_rejects_unsupported_robots(self, tmp_path, one_line):
        Scenario(robot_model="double_integrator").to_toml(tmp_path / "heavy.toml")
        words = [*flags(tmp_path / "out"), "--eval-scenarios", tmp_path / "heavy.toml"]
        assert "learned policies steer" in one_line("train", *words)

    @pytest.mark.parametrize("guarantee", ["heading", "tank"])
    @pytest.mark.parametrize(
        ("margin", "fits"), [(0.0, False), (9e-7, False), (1e-6, True), (0.999, True), (1.0, False)]
    )
    def test_min_alignment_must_be_valid_for_filter(self, margin, fits, guarantee, tmp_path):
        scenario = config(tmp_path).plain_scenario()
        said = r"min.alignment is .* it must be (at least )?(1e-06|less than 1)"
        refused = pytest.raises((UserError, ValueError), match=said)
        with nullcontext() if fits else refused:
            config(tmp_path, min_alignment=margin, guarantee=guarantee)
        with nullcontext() if fits else refused:
            FILTERS[guarantee](scenario, 1, min_alignment=margin)

    @pytest.mark.parametrize(
        ("given", "said", "weights"),
        [
            ("", {}, (0.5, 0.1, 0.0, 1.0, 0.0)),
            ("", {"time_penalty": 0.3}, (0.5, 0.3, 0.0, 1.0, 0.0)),
            ("progress=5.0, clearance_penalty=2.0", {}, (5.0, 0.1, 0.1, 1.0, 2.0)),
            ("progress=5.0", {"progress": 0.5, "rendezvous_bonus": 3.0}, (0.5, 0.1, 0.1, 3.0, 0.0)),
        ],
    )
    def test_reward_defaults_to_scenario(self, given, said, weights, tmp_path):
        file = tmp_path / "own.toml"
        file.write_text(f"n_robots = 3\nreward = {{ {given} }}\n")
        assert Config(scenario=str(file), **said).base_scenario().reward.built_in == weights
        if given:
            set_here = Config(scenario="fig4", set=(f"reward={{{given}}}",), **said)
            assert set_here.base_scenario().reward.built_in == weights
        same = Config(scenario="fig4", set=("reward={progress=1.0}",))  # the default, but said
        assert same.base_scenario().reward == rv.RewardWeights()
        rv.reward_term("none", lambda step: np.zeros(len(step.time)))
        own = Config(scenario="fig4", set=("reward={custom={none=2.0}}",)).base_scenario()
        assert own.reward.custom == (("none", 2.0),)

    def test_config_round_trips_as_plain_data(self):
        given = Config(
            out=Path("a"), curriculum=(3, 5), start_from=Path("b"), set=("n_robots=3",),
            sensing_noise=(0.1, 0.2), sensing_occlusion=("both",), sensing_groups=3,
        )  # fmt: skip
        plain = json.loads(json.dumps(given.to_plain()))
        assert Config.from_plain(plain) == given
        with pytest.raises(ValueError, match="field 'colour'"):
            Config.from_plain(plain | {"colour": 1})
