"""The search with Ray Tune, in a small setting."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("ray")

EXAMPLE = Path(__file__).parents[3] / "examples" / "10_ray_tune.py"


def test_a_search_finds_a_policy(tmp_path):
    small = (
        "--scenario", "clutter-4", "--trials", "2", "--steps", "2048", "--teams", "8",
        "--evaluations", "2", "--starts", "4", "--storage", str(tmp_path),
    )  # fmt: skip
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), *small],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
        env=os.environ | {"RAY_USAGE_STATS_ENABLED": "0"},
    )
    assert done.returncode == 0, done.stderr
    said = re.search(
        r"cleanly (\d+)% with min_alignment 0\.\d+, budget [\d.]+, learning_rate [\de.-]+: (.+)\n",
        done.stdout,
    )
    assert said, done.stdout
    assert int(said[1]) in (0, 25, 50, 75, 100)
    assert (Path(said[2]) / "checkpoints" / "latest.json").is_file()
    assert len(list(tmp_path.glob("clutter-4/attempt_*/run/evaluation.csv"))) == 2
