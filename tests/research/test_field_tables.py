"""Tables of the field's own measures: the reward by hand, and rows of few episodes."""

import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from rendezvous_env.trajectory import run
from research import field_tables
from research.field_tables import diameter, markdown, mean_reward, reward


def test_the_reward_by_hand():
    """Three robots, r_c = 4: distances 3, 4 and 5, the last capped."""
    positions = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    actions = np.array([[1.0, 0.0], [0.5, -0.5], [0.0, 0.0]])
    wanted = -(3 / 4 + 1 + 1) / 3 - 0.001 * (1 + 0.25 + 0.25) / 6
    assert reward(positions, actions, 4.0) == pytest.approx(wanted, rel=1e-12)
    assert reward(np.zeros((2, 3, 2)), np.zeros((2, 3, 2)), 4.0).tolist() == [0, 0]


def test_the_diameter_by_hand():
    positions = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    assert diameter(np.stack([positions, 2 * positions])).tolist() == [5, 10]


def played(team, law, num_envs, seed=0):
    return rv.rollout(team, baselines.make(law, team), seed, num_envs=num_envs, record="actions")


def test_rest_earns_what_the_start_is_worth_all_the_time():
    team = rv.Scenario(n_robots=4, time_step=0.1, time_limit=1.0, allow_long_step=True)
    found = played(team, "zero", 3, 7)
    start = reward(found.positions[0], np.zeros((3, 4, 2)), 100.0 * math.sqrt(2.0))
    np.testing.assert_allclose(mean_reward(found), start, rtol=1e-12)


def test_who_has_met_earns_nothing_more():
    """Two that stand still once they have met, step by step in the simulator."""
    team = rv.scenarios.get("duo")
    simulator = rv.Simulator(team, 2)
    observations, total = simulator.reset(0), np.zeros(2)
    for step in run(simulator, baselines.make("bearing-only", team), observations):
        shares = step.actions / team.action_bounds
        gained = reward(simulator.positions, shares, 100.0 * math.sqrt(2.0))
        total += np.where(step.running, gained, 0.0)
    found = mean_reward(played(team, "bearing-only", 2))
    np.testing.assert_allclose(found, total / team.max_steps, rtol=1e-12)


def test_rows_as_markdown():
    lines = list(markdown(iter([("a", "b"), ("1", "2")])))
    assert lines == ["| a | b |", "|---|---|", "| 1 | 2 |"]


def test_the_sight_of_the_reward_is_that_of_the_scenario(monkeypatch):
    asked = []

    def watched(positions, actions, sight):
        asked.append(sight)
        return reward(positions, actions, sight)

    monkeypatch.setattr(field_tables, "reward", watched)
    sensing = rv.Sensing(range=40.0)
    team = rv.Scenario(sensing=sensing, time_step=0.1, time_limit=0.2, allow_long_step=True)
    mean_reward(played(team, "zero", 1))
    assert asked == [40.0, 40.0]


def test_an_obstacle_touched_is_not_clean():
    found = played(rv.scenarios.get("clutter-8"), "bearing-only", 20)
    share, _ = field_tables._shares(found)
    touched = [bool(team.any()) for team in found.contacts.swapaxes(0, 1)]
    met = [ok and not hit for ok, hit in zip(found.success, touched, strict=True)]
    assert 0 < sum(met) < found.success.sum() and share == f"{5 * sum(met)} %"
