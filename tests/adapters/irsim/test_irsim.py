"""Four differential drives meet in ir-sim, without a touch, by what their lidars return."""

from __future__ import annotations

import re
from importlib import util

import pytest
from test_examples import run

if util.find_spec("irsim") is None:
    pytest.skip("needs ir-sim", allow_module_level=True)


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["tangent-joined-tuned", "learned"])
def test_robots_meet_in_its_obstacles(policy):
    *runs, last = run("13_ir_sim.py", "--policy", policy, "--episodes", "2").splitlines()
    times = [float(re.fullmatch(r"\d: met True, touched False, (\S+) s", one)[1]) for one in runs]
    assert len(times) == 2 and all(3.0 < time < 90.0 for time in times)
    assert last == f"{policy}: 2 of 2 teams met without a touch"
