"""TorchRL and BenchMARL examples: learning, evaluated on held-out initial conditions."""

import re

import pytest
from test_examples import run

pytest.importorskip("torchrl.envs")
pytest.importorskip("benchmarl.experiment")

SMALL = ("--updates", "14", "--num-envs", "64", "--held-out", "50")


def judged(told):
    """Fractions of held-out teams with (collision-free) rendezvous, before and after."""
    found = re.findall(r"^(.+): (\S+)% met, (\S+)% collision-free, median \S+ s$", told, re.M)
    assert [moment for moment, *_ in found] == ["before", "after"]
    return [tuple(map(float, shares)) for _, *shares in found]


@pytest.mark.slow
def test_torchrl_example_learns():
    (before, _), after = judged(told := run("06_torchrl_ppo.py", *SMALL))
    assert after[0] > max(before, 90.0)
    (played,) = re.findall(r"^as a policy: (\S+)% met, (\S+)% collision-free$", told, re.M)
    assert tuple(map(float, played)) == pytest.approx(after, abs=2.0)  # of the same 50 starts


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["mappo", "vdn"])
def test_benchmarl_example_learns(algorithm, tmp_path):
    choices = ("--algorithm", algorithm, "--out", str(tmp_path))
    (before, _), (after, _) = judged(run("07_benchmarl.py", *choices, *SMALL))
    assert after > max(before, 90.0)
