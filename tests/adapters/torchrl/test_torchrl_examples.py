"""TorchRL and BenchMARL examples: learning, evaluated on held-out initial conditions."""

import re

import pytest
from test_examples import run

pytest.importorskip("torchrl.envs")
pytest.importorskip("benchmarl.experiment")

SIZE = ("--num-envs", "64", "--held-out", "50")
FEW, MORE = ("--updates", "2", *SIZE), ("--updates", "14", *SIZE)


def judged(told):
    """Fractions of held-out teams with (collision-free) rendezvous, before and after."""
    found = re.findall(r"^(.+): (\S+)% met, (\S+)% collision-free, median \S+ s$", told, re.M)
    assert [moment for moment, *_ in found] == ["before", "after"]
    return [tuple(map(float, shares)) for _, *shares in found]


@pytest.mark.slow
def test_torchrl_example_runs():
    judged(told := run("06_torchrl_ppo.py", *FEW))
    assert "\nas a policy: " in told


@pytest.mark.slow
def test_benchmarl_example_runs(tmp_path):
    judged(run("07_benchmarl.py", "--algorithm", "vdn", "--out", str(tmp_path), *FEW))


@pytest.mark.nightly
def test_torchrl_example_learns():
    (before, _), after = judged(told := run("06_torchrl_ppo.py", *MORE))
    assert after[0] > max(before, 90.0)
    (played,) = re.findall(r"^as a policy: (\S+)% met, (\S+)% collision-free$", told, re.M)
    assert tuple(map(float, played)) == pytest.approx(after, abs=2.0)  # of the same 50 starts


@pytest.mark.nightly
@pytest.mark.parametrize("algorithm", ["mappo", "vdn"])
def test_benchmarl_example_learns(algorithm, tmp_path):
    choices = ("--algorithm", algorithm, "--out", str(tmp_path))
    (before, _), (after, _) = judged(run("07_benchmarl.py", *choices, *MORE))
    assert after > max(before, 90.0)
