"""A comparison with a sensor that errs: what was seen is kept, and the page knows that it errs."""

from __future__ import annotations

import json
import re

import numpy as np

import baselines
import rendezvous_env as rv
from rendezvous_env.trajectory import run
from train.compare import compare
from train.report import build as report


def test_what_was_seen_is_kept_and_said_to_err(tmp_path):
    sensor = rv.Sensing(noise=0.3, dropout=0.2, delay=2)
    scenario = rv.Scenario(name="blurred", n_robots=5, time_limit=3.0, sensing=sensor)
    scenario.to_toml(tmp_path / "blurred.toml")
    scenario.replace(name="sharp", sensing=rv.Sensing()).to_toml(tmp_path / "sharp.toml")
    names = tuple(str(tmp_path / f"{name}.toml") for name in ("blurred", "sharp"))
    out = tmp_path / "out"
    config = compare.Config(names, ("bearing-only",), episodes=2, seed=7, keep=1, out=out)
    assert compare.run(config) == 0
    with np.load(out / "trajectories.npz") as arrays:
        kept = {key: arrays[key] for key in arrays if "blurred" in key}
    (times,) = (value for key, value in kept.items() if key.endswith("times"))
    (observations,) = (value for key, value in kept.items() if key.endswith("observations"))
    sim = rv.Simulator(scenario)
    seen = [sim.reset(7)[0]]
    policy = baselines.make("bearing-only", scenario)
    seen += [step.outcome.observations[0] for step in run(sim, policy, sim.observe())]
    at = np.rint(times / scenario.tau).astype(int)
    assert len(at) > 20 and (observations == np.stack(seen)[at]).all()

    assert report.run(report.Config(out)) == 0
    text = (out / "report.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', text, re.DOTALL)[1])
    assert {name: one["exact"] for name, one in data["scenarios"].items()} == {
        "blurred": False,
        "sharp": True,
    }
    bounds = {row["scenario"]: row["time_over_bound"] for row in data["results"]}
    assert bounds["blurred"] in ("", None) and bounds["sharp"] not in ("", None)
