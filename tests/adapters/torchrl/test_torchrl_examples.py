"""The examples with TorchRL and BenchMARL learn, judged on starts they were not trained on."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from conftest import ROOT

pytest.importorskip("torchrl.envs")
pytest.importorskip("benchmarl.experiment")

SMALL = ("--teams", "64", "--held-out", "50")


def met(name, *words):
    """Shares of the held-out teams that met, before and after."""
    command = [sys.executable, str(ROOT / "examples" / name), *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    found = re.findall(
        r"^(before|after): (\d+\.\d)% met, \d+\.\d% cleanly, median (\S+) s", done.stdout, re.M
    )
    assert [moment for moment, _, _ in found] == ["before", "after"]
    return [float(share) for _, share, _ in found]


@pytest.mark.slow
def test_torchrl_learns():
    before, after = met("06_torchrl_ppo.py", "--updates", "25", *SMALL)
    assert after > max(before, 90.0)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["mappo", "vdn"])
def test_benchmarl_learns(algorithm, tmp_path):
    choices = ("--algorithm", algorithm, "--updates", "25", "--out", str(tmp_path))
    before, after = met("07_benchmarl.py", *choices, *SMALL)
    assert after > max(before, 90.0)
