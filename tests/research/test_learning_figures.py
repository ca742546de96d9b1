"""Figures of learning show the numbers that they are given."""

import numpy as np
import pytest
from bare_network import make_network
from learning_figures import learning_figure, tank_figure, watch_tanks

from baselines.learned.learned_policy import LearnedPolicy
from baselines.learned.policy_settings import PolicySettings
from rendezvous_env.scenario import scenarios
from train import results
from train.learn.log import EVALUATION, METRICS

SETTINGS = PolicySettings(
    4, (8,), clearance=0.2, persistence=0.5, min_alignment=0.05, max_turn_rate=100.0,
    decision_time=0.2, guarantee="tank", budget=2.0,
)  # fmt: skip


@pytest.fixture
def run(tmp_path):
    metrics = [
        dict.fromkeys(METRICS, 0) | {"step": 10**6 * k, "clean_success": 0.05 * k}
        for k in range(1, 12)
    ]
    evaluations = [
        dict.fromkeys(EVALUATION, 0)
        | {"step": 10**6 * k, "scenario": name, "clean_success": share, "clean_low": share - 0.1,
           "clean_high": share + 0.05}
        for k in (1, 2) for name, share in (("clutter-24", 0.3 * k), ("clutter-16", 0.9))
    ]  # fmt: skip
    results.write_csv(tmp_path / "metrics.csv", METRICS, metrics)
    results.write_csv(tmp_path / "evaluation.csv", EVALUATION, evaluations)
    return tmp_path


def test_learning(run):
    figure = learning_figure({"tank": run}, "clutter-24")
    lines = {line.get_label(): line for line in figure.axes[0].get_lines()}
    training, held_out = list(lines.values())[:2]
    np.testing.assert_allclose(training.get_xydata(), [[9, 45], [10, 50], [11, 55]])
    np.testing.assert_allclose(held_out.get_xydata(), [[1, 30], [2, 60]])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["tank"]


def test_an_update_in_which_no_episode_ended_leaves_a_gap(run):
    rows = results.read_csv(run / "metrics.csv")
    rows[9]["clean_success"] = ""
    results.write_csv(run / "metrics.csv", METRICS, rows)
    training = learning_figure({"tank": run}, "clutter-24").axes[0].get_lines()[0]
    np.testing.assert_allclose(training.get_ydata(), [45, np.nan, 55])


def test_spending_and_earning():
    scenario = scenarios.get("clutter-8").replace(time_limit=4.0)
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
