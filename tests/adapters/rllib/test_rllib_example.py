"""The example learns something, on starts that it never saw."""

import re
import subprocess
import sys

import pytest
from conftest import ROOT

pytest.importorskip("ray.rllib")


@pytest.mark.slow
def test_the_example_learns():
    words = "--updates", "40", "--held-out", "100"
    command = [sys.executable, str(ROOT / "examples" / "08_rllib_ppo.py"), *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    judged = re.findall(r"(before|after)[^:]*: (\S+)% met, (\S+)% without", done.stdout)
    assert [when for when, *_ in judged] == ["before", "after"]
    (_, met, clean), (_, met_after, clean_after) = judged
    assert float(met_after) > float(met) + 20
    assert float(clean_after) > float(clean)
