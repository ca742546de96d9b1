"""Examples: they run with the stated results."""

import re

import pytest
from conftest import ROOT, run_python

from train import results

EXAMPLES = ROOT / "examples"


def run(name, *words, **environment):
    return run_python(ROOT, EXAMPLES / name, *words, **environment).stdout


@pytest.mark.slow
def test_step_loop_and_custom_law_run():
    assert re.fullmatch(r"\d+ steps; met: True after \d\.\d\d s\n", run("01_step_loop.py"))
    law, fast = run("02_own_law.py").splitlines()
    assert law.startswith("law (1): 100% met") and fast.startswith("full speed along f:")


@pytest.mark.slow
def test_train_and_compare_run(tmp_path):
    small = ("--steps", "1000", "--num-envs", "8", "--episodes", "3", "--out", str(tmp_path))
    last = run("03_train_and_compare.py", *small).splitlines()[-3:]
    policies = ["bearing-only", "tangent-merged-tuned", "learned"]
    assert [line.split(":")[0] for line in last] == policies
    assert (tmp_path / "run" / "checkpoints" / "latest.json").is_file()


@pytest.mark.slow
def test_stable_baselines3_example_runs(tmp_path):
    program = (EXAMPLES / "11_sb3_ppo.py").read_text(encoding="utf-8")
    assert len([line for line in program.splitlines() if line.strip()]) <= 30
    small = ("--steps", "512", "--num-envs", "4", "--episodes", "2", "--out", str(tmp_path / "out"))
    run("11_sb3_ppo.py", *small)
    rows = results.read_csv(tmp_path / "out" / "results.csv")
    assert [row["policy"] for row in rows] == ["tangent-merged-tuned", "ppo"]
    assert "ppo" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


JUDGED = re.compile(
    r"(before|after [\d,]+ (?:decisions|steps) of robots): (\S+)% met, (\S+)% without a touch"
)
"""Printed success on held-out initial conditions, before and after."""


@pytest.mark.slow
def test_cleanrl_example_runs():
    small = ("--scenario", "duo", "--updates", "3", "--num-envs", "8", "--held-out", "20")
    first, update, last = run("04_cleanrl_ppo.py", *small).splitlines()
    loss = re.fullmatch(r"update 3: loss (\S+), reward \S+, .*", update)[1]
    assert abs(float(loss)) < 100
    judged = [JUDGED.fullmatch(line).groups() for line in (first, last)]
    assert judged[0][0] == "before" and judged[0][2] == judged[0][1]  # there is nothing to touch


@pytest.mark.nightly
def test_cleanrl_example_learns():
    size = ("--updates", "60", "--num-envs", "64", "--steps", "64", "--held-out", "200")
    text = run("04_cleanrl_ppo.py", *size)
    (_, met, clean), (_, met_after, clean_after) = JUDGED.findall(text)
    assert float(met_after) > float(met) + 30
    assert float(clean_after) > float(clean) + 5


@pytest.mark.slow
def test_noisy_sensors_example_runs(tmp_path):
    table, figure = tmp_path / "rows.csv", tmp_path / "clean.png"
    counts = ("--scenarios", "clutter-4", "--episodes", "3", "--sensors", "exact", "noise 0.2")
    policies = ("bearing-only", "learned", "learned@0.6")
    files = ("--out", str(table), "--figure", str(figure))
    said = run("05_noisy_sensors.py", *counts, "--policies", *policies, *files)
    head, _, *rows = said.splitlines()
    assert head == "| clutter-4 | exact | noise 0.2 |"
    found = results.read_csv(table)
    assert [row["policy"] for row in found[::2]] == list(policies)
    for line, exact, noisy in zip(rows, found[::2], found[1::2], strict=True):
        clean = [f"{100 * float(row['collision_free']):.1f}" for row in (exact, noisy)]
        assert line == f"| {exact['policy']} | {clean[0]} | {clean[1]} |"
    times = {row["policy"]: float(row["time"]) for row in found if row["sensor"] == "noise 0.2"}
    assert times["learned"] != times["learned@0.6"]
    assert figure.stat().st_size > 5000


@pytest.mark.nightly
def test_jax_ppo_example_runs():
    pytest.importorskip("jax")
    program = (EXAMPLES / "15_jax_ppo.py").read_text(encoding="utf-8")
    assert len([line for line in program.splitlines() if line.strip()]) <= 200
    sizes = ("--updates", "2", "--report", "1", "--envs", "8", "--steps", "4", "--held-out", "8")
    quick = {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}  # in compiling
    said = run("15_jax_ppo.py", "--scenario", "duo", *sizes, **quick)
    from device_bench import RATE

    assert len(RATE.findall(said)) == 2
    told = said.splitlines()
    shares = re.compile(r"(\d+\.\d)% met, (\d+\.\d)% without contact, \d+\.\d s")
    names, results = zip(*(line.split(": ") for line in told), strict=True)
    assert names[:2] == ("bearing-only", "before")
    assert [name.split(",")[0] for name in names[2:]] == ["update 1", "update 2"]
    found = [shares.fullmatch(line).groups() for line in results]
    assert found[0] == ("100.0", "100.0") and all(a == b for a, b in found)


@pytest.mark.nightly
def test_jax_gradient_example_improves_the_slowest(tmp_path):
    pytest.importorskip("jax")
    figure = tmp_path / "gradient.png"
    sizes = ("--iterations", "8", "--num-envs", "20", "--seconds", "4", "--figure", str(figure))
    told = run("16_jax_gradient.py", *sizes)
    costs = [float(cost) for cost in re.findall(r"cost (\S+) s", told)]
    before, after = map(float, re.search(r"(\S+) s before, (\S+) s after", told).groups())
    assert costs[-1] < costs[0] - 0.02 and after < before
    assert figure.stat().st_size > 20_000
