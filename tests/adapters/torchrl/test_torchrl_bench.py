"""``rendezvous bench --only adapters`` times TorchRL where it is installed."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("torchrl.envs")

from train.bench import bench


def test_torchrl_is_timed_over_what_it_adapts(tmp_path):
    path = tmp_path / "bench.json"
    small = {"robots": (3,), "num_envs": 16, "num_threads": 1, "repeats": 1, "seconds": 0.01}
    bench.run(bench.Config(json=path, only=("adapters",), **small))
    written = json.loads(path.read_text())
    rows = {row["name"]: row for row in written["rows"]}
    for ours in ("make_vec", "training_env"):
        assert rows[ours]["ratio"] is None
        assert rows[f"TorchRL over {ours}"]["against"] == ours
        assert rows[f"TorchRL over {ours}"]["ratio"] > 0
    assert "torchrl" in written["versions"]
