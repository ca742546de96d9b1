"""Collision-free rendezvous of four differential drives with lidars in ir-sim."""

import re
from importlib import util

import pytest
from test_examples import run

if util.find_spec("irsim") is None:
    pytest.skip("needs ir-sim", allow_module_level=True)


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["tangent-merged-tuned", "learned"])
def test_robots_meet_in_irsim_without_contact(policy):
    told, last = run("13_ir_sim.py", "--policy", policy, "--episodes", "1").splitlines()
    assert 3.0 < float(re.fullmatch(r"0: met True, touched False, (\S+) s", told)[1]) < 90.0
    assert last == f"{policy}: 1 of 1 episodes met without a contact"
