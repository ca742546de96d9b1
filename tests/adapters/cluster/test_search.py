"""Hyperparameter search with Ray Tune, in a small setting."""

import re
from pathlib import Path

import pytest
from test_examples import run

pytest.importorskip("ray")


def test_search_finds_policy(tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    small = (
        "--scenario", "clutter-4", "--trials", "2", "--steps", "2048", "--num-envs", "8",
        "--evaluations", "2", "--eval-episodes", "4", "--storage", str(tmp_path),
    )  # fmt: skip
    told = run("10_ray_tune.py", *small)
    said = re.search(
        r"collision-free (\d+)% with min_alignment 0\.\d+, budget [\d.]+, "
        r"learning_rate [\de.-]+: (.+)\n",
        told,
    )
    assert said, told
    assert int(said[1]) in (0, 25, 50, 75, 100)
    assert (Path(said[2]) / "checkpoints" / "latest.json").is_file()
    assert len(list(tmp_path.glob("clutter-4/attempt_*/run/evaluation.csv"))) == 2
