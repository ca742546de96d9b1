"""Upper bounds of law (4): randomised runs that satisfy theorem C."""

from types import SimpleNamespace

import numpy as np
import pytest

import baselines
from rendezvous_env import rollout
from rendezvous_env.scenario import scenarios
from train import cli, results
from train.compare import Config, plan, upper_bound
from train.compare.evaluation import play

CLUTTER = scenarios.get("clutter-12").replace(time_limit=40.0)


def runs(scenario, count, episodes, seed):
    """Results of several runs and of the planner, and the corresponding row."""
    settings = Config(episodes=episodes, seed=seed, ceiling=count)
    found = [task.work() for task in upper_bound.tasks_of(scenario, settings)]
    return found, upper_bound.row_of(scenario, found)


@pytest.mark.slow
def test_first_run_is_merged_interval_rule():
    """The other runs differ from it and from each other."""
    found, _ = runs(CLUTTER, 4, episodes=20, seed=5)
    assert len(found) == 4 + 1  # the planner's is the last
    assert all(
        run.collision_free.shape == (20,) and (run.collision_free <= run.success).all()
        for run in found
    )

    first = upper_bound.randomised(CLUTTER, seed=0, spread=0.0)
    rule = baselines.make(
        "tangent-merged-tuned", CLUTTER, clearance=first.rule.clearance, persistence=0.0
    )
    done, _ = play(CLUTTER, lambda: rule, margin=0.05, episodes=20, seed=5)
    assert (done.collision_free == found[0].collision_free).mean() >= 0.9
    others = (upper_bound.randomised(CLUTTER, seed=run, spread=0.6) for run in (1, 2, 3))
    assert len({rollout(CLUTTER, other, seed=5).times[-1] for other in others}) == 3


def test_every_run_keeps_minimum_alignment():
    policy = upper_bound.randomised(CLUTTER, seed=3, spread=1.0)
    done, _ = play(CLUTTER, lambda: policy, margin=upper_bound.MIN_ALIGNMENT, episodes=20, seed=5)
    assert np.nanmin(done.min_alignment) >= upper_bound.MIN_ALIGNMENT - 1e-6


def test_ceiling_row_counts_initial_conditions():
    planned = [1, 1, 1, 0]
    starts = [([1, 1, 0, 0], [1, 0, 0, 0]), ([0, 1, 1, 0], [0, 1, 0, 0]), (planned, planned)]
    found = [
        SimpleNamespace(success=np.array(success, bool), collision_free=np.array(free, float))
        for success, free in starts
    ]
    row = upper_bound.row_of(CLUTTER, found)
    assert row == {
        "scenario": "clutter-12", "episodes": 4, "runs": 2,
        "collision_free_planner": 0.75, "collision_free_best": 0.5, "success_best": 0.75,
        "collision_free_mean": 0.25, "never_collision_free": 2, "never_met": 1,
    }  # fmt: skip


def test_planner_is_upper_bound():
    trap = scenarios.get("trap")
    found, row = runs(trap, 1, episodes=20, seed=1000)
    assert (
        row["collision_free_planner"] == 1.0
        and found[-1].collision_free.mean() > found[0].collision_free.mean()
    )
    found, row = runs(scenarios.get("clutter-3d"), 1, episodes=2, seed=0)
    assert len(found) == 2 and row["collision_free_planner"] == 1.0


@pytest.mark.slow
def test_compare_writes_ceiling_and_planner(tmp_path, capsys):
    """The bound has a separate row, with a legend in the table."""
    names = {job.policy for job in plan(Config(("duo",), out=tmp_path))}
    assert "bearing-only" in names and "privileged-planner" not in names
    words = ["--scenarios", "duo", "clutter-4", "--policies", "bearing-only", "privileged-planner"]
    words += ["--episodes", "3", "--ceiling", "2", "--no-figures", "--out", str(tmp_path)]
    assert cli.main(["compare", *words]) == 0
    (row,) = results.read_csv(tmp_path / "ceiling.csv")
    assert row["scenario"] == "clutter-4" and row["runs"] == "2" and row["episodes"] == "3"
    rows = {(r["scenario"], r["policy"]): r for r in results.read_csv(tmp_path / "results.csv")}
    share = rows["clutter-4", "privileged-planner"]["collision_free_success"]
    assert float(share) == float(row["collision_free_planner"]) == 1.0
    said = capsys.readouterr().out
    assert "What can be reached" in said and "with the map and all positions" in said
