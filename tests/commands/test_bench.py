"""Benchmark cases, their files, and messages about compilation."""

import json

import numpy as np
import pytest
from conftest import run_python

from rendezvous_env import compilation, kernel_cache
from train import checks, cli
from train.bench import learners
from train.bench.bench import GROUPS, Config, measure, run
from train.bench.cases import Case, Running, Size, among_discs, bare_step, batched, tape_of
from train.checks import installed

QUICK = {"robots": (3,), "num_envs": 48, "repeats": 2, "seconds": 0.004, "num_threads": 1}


def measured(folder, **choices):
    """Rows of a quick run, read from its file, and the file's content."""
    path = folder / "bench.json"
    run(Config(json=path, **choices, **QUICK))
    written = json.loads(path.read_text())
    return written["rows"], written


@pytest.mark.kernels
def test_bare_kernel_computes_bearings_sums_and_step():
    n, lanes = 4, 64
    positions = np.random.default_rng(0).uniform(-1, 1, (1, n, 2, lanes))
    p = np.moveaxis(positions[0].copy(), -1, 0)  # (lanes, n, 2)
    bearings = np.zeros((1, n, n - 1, 2, lanes))
    bare_step(positions, bearings, np.zeros((n, 2, lanes)))
    g = p[:, None] - p[:, :, None]
    lengths = np.linalg.norm(g, axis=-1, keepdims=True)
    g = np.divide(g, lengths, where=lengths > 0, out=np.zeros_like(g))
    seen = np.moveaxis(bearings[0], -1, 0)
    for i in range(n):
        np.testing.assert_allclose(seen[:, i], np.delete(g[:, i], i, axis=1), atol=1e-12)
    moved = np.moveaxis(positions[0], -1, 0) - p
    np.testing.assert_allclose(moved, 1e-9 * g.sum(axis=2), atol=1e-15)


LONG = {"features", "many-shapes"}
"""Groups that compile and build more than others."""


@pytest.mark.slow
def test_bench_measures_clocks_failures_and_many_shapes(tmp_path):
    rows, _ = measured(tmp_path, only=tuple(LONG))
    ratios = {(row["group"], row["name"]): row["ratio"] for row in rows}
    assert {group for group, _ in ratios} == LONG
    named = [("features", "adversarial clocks"), ("features", "crash"), ("features", "mixed team")]
    named += [("many-shapes", f"2,000 shapes, {rows}") for rows in ("all rows", "8 nearest")]
    assert all(ratios[name] > 0 for name in named)
    assert ratios["features", "none"] is ratios["many-shapes", "20 shapes, all rows"] is None


def test_bench_measures_and_writes_all_rows(tmp_path):
    rows, written = measured(tmp_path, only=tuple({*GROUPS} - LONG))
    assert {row["group"] for row in rows} == {*GROUPS} - LONG
    assert all(row["rate"] > 0 and len(row["rates"]) == 2 for row in rows)
    ratios = {(row["group"], row["name"]): row["ratio"] for row in rows}
    compared = [
        ("batched", "Simulator"), ("wrapped", "EnergyTankWrapper"), ("sensing", "noise"),
        ("heading-ppo", "end to end"), ("heading-ppo", "free environment"),
        ("adapters", "stable-baselines3 over make_vec"),
        ("training", "training_env, clutter-8, heading"),
    ]  # fmt: skip
    assert all(ratios[name] > 0 for name in compared)
    assert ratios["obstacles", "Simulator"] is None
    assert written["bytes_per_team"]["3"]["observations"] == 3 * 2 * 2 * 4
    assert written["threads"] == 1 and "numba" in written["versions"]
    assert list(tmp_path.iterdir()) == [tmp_path / "bench.json"]


def test_installed_ignores_folder_with_library_name(tmp_path, monkeypatch):
    (tmp_path / "folder_of_no_library").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    assert not installed("folder_of_no_library") and installed("numpy")


@pytest.mark.slow
def test_tiny_batch_counts_as_one_environment():
    rows = measure(learners.heading_ppo(Size(1, 1)), Config(**QUICK | {"num_envs": 1}))
    assert [row["num_envs"] for row in rows] == [1, 1, 1]


def test_bench_rows_can_be_selected_without_learners(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(checks.importlib.util, "find_spec", lambda name: None)
    [row], _ = measured(tmp_path, only=("one-team", "heading-ppo"))
    assert (row["group"], row["name"], row["ratio"]) == ("one-team", "PettingZoo", None)
    assert "memory per environment, n = 3" in capsys.readouterr().out


def test_ratio_refers_to_named_case(monkeypatch):
    now = [0.0]

    def case(name, seconds, against=""):
        def step():
            now[0] += seconds

        return Case(name, "g", 2, 1, 1, "steps", lambda: Running(step), against)

    cases = [case("limit a", 0.001), case("other", 0.002), case("ours", 0.01, "limit a")]
    with monkeypatch.context() as patch:
        patch.setattr("time.perf_counter", lambda: now[0])
        first, _, ours = measure(cases, Config(repeats=3, seconds=0.02))
    assert ours["ratio"] == pytest.approx(0.1) and ours["rate"] == pytest.approx(100.0)
    assert first["ratio"] is None


def test_processor_time_is_measured_on_request(monkeypatch):
    now = [0.0]

    def step():
        now[0] += 0.5

    case = Case("busy", "g", 2, 1, 1, "steps", lambda: Running(step))
    with monkeypatch.context() as patch:
        patch.setattr("time.perf_counter", lambda: now[0] / 0.5)
        patch.setattr("time.process_time", lambda: now[0])
        [wall], [busy] = (
            measure([case], Config(repeats=1, seconds=3.0, cpu_time=cpu)) for cpu in (False, True)
        )
    assert (wall["rate"], busy["rate"]) == (pytest.approx(1.0), pytest.approx(2.0))


def test_merge_during_measurement_is_error():
    case = Case("merging", "g", 2, 1, 1, "steps", lambda: Running(lambda: None, lambda: False))
    with pytest.raises(RuntimeError, match="merging"):
        measure([case], Config(repeats=1, seconds=0.001))


def test_obstacle_case_has_all_discs_in_range():
    running = {case.name: case.build() for case in batched("obstacles", among_discs(), Size(4, 1))}
    outcome = running["Simulator"].step()
    layout = among_discs().observation_layout
    seen = outcome.observations[..., layout.obstacles, :]
    np.testing.assert_allclose(np.linalg.norm(seen, axis=-1), 1.0, atol=1e-5)
    assert seen.shape == (4, 4, 16, 2)


def test_case_actions_match_action_space():
    from rendezvous_env.vector import training_env

    env = training_env("clutter-8", 3, discrete=True)
    assert env.action_space.contains(next(tape_of(env.single_action_space, 3)))


def test_warmup_compiles_requested_scenarios(capsys):
    assert cli.main(["warmup", "--scenarios", "duo", "ring-12"]) == 0
    assert "2 scenarios are ready" in capsys.readouterr().out


@pytest.mark.skipif(not compilation.compiled(), reason="nothing is compiled")
@pytest.mark.parametrize(("seconds", "said"), [(2.5, 1), (1.2, 1), (0.9, 0)])
def test_compilation_is_announced_once_if_it_takes_long_in_all(
    seconds, said, monkeypatch, capsys, tmp_path
):
    monkeypatch.setattr(kernel_cache, "_folder", lambda: tmp_path)  # else it may be found there
    clock = iter(range(100))
    compilation._say_once.cache_clear()
    monkeypatch.setattr(compilation._Wait, "seconds", 0.0)
    monkeypatch.setattr(compilation.time, "monotonic", lambda: seconds * next(clock))

    @compilation.kernel
    def thrice(x):
        return 3 * x

    assert thrice(2) == 6 and thrice(2.0) == 6.0
    assert capsys.readouterr().err.count("rendezvous warmup") == said


@pytest.mark.nightly
def test_cold_first_step_announces_compilation(tmp_path):
    code = (
        "import rendezvous_env as rv; from rendezvous_env import compilation; "
        "compilation._PATIENCE = 0.0; env = rv.parallel_env('duo'); env.reset(seed=0);"
        "env.step({a: env.action_space(a).sample() for a in env.agents})"
    )
    cold = {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (run_python(tmp_path, "-c", code, **cold).stderr for _ in range(2))
    assert first.count("rendezvous warmup") == 1 and first.count("\n") == 1
    assert second == ""
