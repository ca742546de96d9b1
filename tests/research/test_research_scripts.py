"""Research scripts: learning figures, tables of the literature, invalid arguments, Ctrl-C."""

import json
import math
import runpy
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import ROOT, run_python
from inference_network import make_network
from learning_figures import learning_figure, tank_figure, watch_tanks

import baselines
import rendezvous_env as rv
from baselines.learned.learned_policy import LearnedPolicy
from baselines.learned.policy_settings import PolicySettings
from rendezvous_env.trajectory import run
from research import field_tables
from research.field_tables import diameter, markdown, mean_reward, reward
from train import results
from train.learn.log import EVALUATION, METRICS

SETTINGS = PolicySettings(
    4, (8,), clearance=0.2, persistence=0.5, min_alignment=0.05, max_turn_rate=100.0,
    decision_time=0.2, guarantee="tank", budget=2.0,
)  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    metrics = [
        dict.fromkeys(METRICS, 0) | {"step": 10**6 * k, "collision_free_success": 0.05 * k}
        for k in range(1, 12)
    ]
    evaluations = [
        dict.fromkeys(EVALUATION, 0)
        | {"step": 10**6 * k, "scenario": name, "collision_free_success": share,
           "collision_free_low": share - 0.1, "collision_free_high": share + 0.05}
        for k in (1, 2) for name, share in (("clutter-24", 0.3 * k), ("clutter-16", 0.9))
    ]  # fmt: skip
    results.write_csv(tmp_path / "metrics.csv", metrics, METRICS)
    results.write_csv(tmp_path / "evaluation.csv", evaluations, EVALUATION)
    return tmp_path


def test_learning_figure_is_drawn(folder):
    figure = learning_figure({"tank": folder}, "clutter-24")
    lines = {line.get_label(): line for line in figure.axes[0].get_lines()}
    training, held_out = list(lines.values())[:2]
    np.testing.assert_allclose(training.get_xydata(), [[9, 45], [10, 50], [11, 55]])
    np.testing.assert_allclose(held_out.get_xydata(), [[1, 30], [2, 60]])
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named == ["training episodes", "tank"]


def test_update_without_episode_leaves_gap(folder):
    rows = results.read_csv(folder / "metrics.csv")
    rows[9]["collision_free_success"] = ""
    results.write_csv(folder / "metrics.csv", rows, METRICS)
    training = learning_figure({"tank": folder}, "clutter-24").axes[0].get_lines()[0]
    np.testing.assert_allclose(training.get_ydata(), [45, np.nan, 55])


@pytest.mark.slow
def test_tank_figure_is_drawn():
    scenario = rv.scenarios.get("clutter-8").replace(time_limit=4.0)
    network = make_network(SETTINGS.layout(3, 8), len(SETTINGS.angles), set_width=4, hidden=(8,))
    weights = {name: value.detach().numpy() for name, value in network.state_dict().items()}
    watched = watch_tanks(scenario, LearnedPolicy(scenario, weights, SETTINGS), seed=3)
    contacts = watched.pop("contacts")
    steps = len(contacts)
    assert watched["levels"].shape == watched["active"].shape == (steps, 4) and steps > 20
    total = watched["lyapunov"] + watched["levels"].sum(axis=1)
    apart = watched["active"].all(axis=1) & (contacts == 0)
    assert (np.diff(total[apart]) <= 1e-6).all() and watched["levels"].min() >= 0.0
    above, below = tank_figure(**watched).axes
    np.testing.assert_array_equal(above.get_lines()[1].get_ydata(), watched["lyapunov"])
    np.testing.assert_allclose(above.get_lines()[0].get_ydata()[apart], total[apart])
    assert len(below.get_lines()) == 4


def test_reward_and_diameter_match_hand_computation():
    """Three robots, r_c = 4: distances 3, 4 and 5, the last clipped."""
    positions = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    actions = np.array([[1.0, 0.0], [0.5, -0.5], [0.0, 0.0]])
    wanted = -(3 / 4 + 1 + 1) / 3 - 0.001 * (1 + 0.25 + 0.25) / 6
    assert reward(positions, actions, 4.0) == pytest.approx(wanted, rel=1e-12)
    assert reward(np.zeros((2, 3, 2)), np.zeros((2, 3, 2)), 4.0).tolist() == [0, 0]
    assert diameter(np.stack([positions, 2 * positions])).tolist() == [5, 10]


def played(team, law, num_envs, seed=0):
    return rv.rollout(team, baselines.make(law, team), seed, num_envs=num_envs, record="actions")


def test_resting_team_earns_initial_value():
    team = rv.Scenario(n_robots=4, time_step=0.1, time_limit=1.0, allow_long_step=True)
    found = played(team, "zero", 3, 7)
    start = reward(found.positions[0], np.zeros((3, 4, 2)), 100.0 * math.sqrt(2.0))
    np.testing.assert_allclose(mean_reward(found), start, rtol=1e-12)


def test_finished_environment_earns_nothing():
    """Two robots at rest after rendezvous, step by step in the simulator."""
    team = rv.scenarios.get("duo")
    simulator = rv.Simulator(team, 2)
    observations, total = simulator.reset(0), np.zeros(2)
    for step in run(simulator, baselines.make("bearing-only", team), observations):
        shares = step.actions / team.action_bounds
        gained = reward(simulator.positions, shares, 100.0 * math.sqrt(2.0))
        total += np.where(step.running, gained, 0.0)
    found = mean_reward(played(team, "bearing-only", 2))
    np.testing.assert_allclose(found, total / team.max_steps, rtol=1e-12)


def test_rows_are_formatted_as_markdown():
    lines = list(markdown(iter([("a", "b"), ("1", "2")])))
    assert lines == ["| a | b |", "|---|---|", "| 1 | 2 |"]


def test_reward_visibility_equals_scenario(monkeypatch):
    asked = []

    def watched(positions, actions, sight):
        asked.append(sight)
        return reward(positions, actions, sight)

    monkeypatch.setattr(field_tables, "reward", watched)
    sensing = rv.Sensing(range=40.0)
    team = rv.Scenario(sensing=sensing, time_step=0.1, time_limit=0.2, allow_long_step=True)
    mean_reward(played(team, "zero", 1))
    assert asked == [40.0, 40.0]


def test_contact_is_not_collision_free():
    found = played(rv.scenarios.get("clutter-8"), "bearing-only", 20)
    share, _ = field_tables._shares(found)
    touched = [bool(team.any()) for team in found.contacts.swapaxes(0, 1)]
    met = [ok and not hit for ok, hit in zip(found.success, touched, strict=True)]
    assert 0 < sum(met) < found.success.sum() and share == f"{5 * sum(met)} %"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("claims.py gains gians", "claim gians is unknown; known are gains, "),
        ("claims.py --trials 0", "--trials must be 1 or more"),
        ("claims.py --seed -1", "--seed 0 or more"),
        ("training_search.py --every 0", "--every is 0; it must be 1 or more"),
        ("growth.py", "name a PNG"),
        ("packing.py many", "SEEDS is 'many'; it must be an integer, 1 or more"),
        ("packing.py 0", "SEEDS is '0'"),
    ],
)
def test_invalid_argument_is_one_line(words, said, monkeypatch, capsys):
    script, *arguments = words.split()
    monkeypatch.setattr(sys, "argv", [script, *arguments])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(ROOT / "research" / script), run_name="__main__")
    out, err = capsys.readouterr()
    assert not out
    assert said in err if end.value.code == 2 else said in end.value.code


@pytest.mark.nightly
def test_interrupted_search_resumes(tmp_path):
    """The interrupted run has no row either."""
    words = "research/training_search.py --tried small-batch --seeds 0 1".split()
    command = [sys.executable, ROOT / words[0], *words[1:], "--out", tmp_path / "runs"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as search:
        metrics = tmp_path / "runs" / "small-batch-0" / "metrics.csv"
        while not (metrics.exists() and metrics.read_text().count("\n") > 1):
            assert search.poll() is None
            time.sleep(0.1)
        search.send_signal(signal.SIGINT)
        said, _ = search.communicate(timeout=60)
    assert search.returncode == 130 and "small-batch, seed" not in said
    assert not (tmp_path / "runs" / "small-batch-1").exists()


@pytest.mark.nightly
def test_device_bench_writes_rates(tmp_path):
    pytest.importorskip("jax")
    out = tmp_path / "device.json"
    words = "--small", "--skip-ppo", "--out", out
    run_python(ROOT, ROOT / "research" / "device_bench.py", *words)
    told = json.loads(out.read_text(encoding="utf-8"))
    assert told["device"]["platform"] == "cpu" and told["rates"].keys() == {"64"}
    measured = [told["rates"]["64"]["jax"], *(told["alternating"][k] for k in ("jax", "make_vec"))]
    for rates in measured:
        low, high = rates["quartiles"]
        assert 0.0 < low <= rates["steps_per_s"] <= high and rates["calls"] >= 3
        assert rates["steps_per_call"] == 6400


@pytest.mark.slow
def test_device_bench_reads_rates_of_the_example(monkeypatch):
    pytest.importorskip("jax")
    import device_bench

    said = "".join(f"update {k}, {k},500 robot steps/s: 1 % met\n" for k in (2, 4, 6))
    asked = []

    def answer(words, **_):
        asked.extend(words)
        return subprocess.CompletedProcess(words, 0, said)

    monkeypatch.setattr(subprocess, "run", answer)
    told = device_bench.ppo(envs=8, updates=2, steps=4)
    assert told["all"] == [2500.0, 4500.0, 6500.0] and told["robot_steps_per_s"] == 6500.0
    assert " ".join(asked[2:]) == "--held-out 16 --envs 8 --steps 4 --updates 6 --report 2"
