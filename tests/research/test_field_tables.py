"""Tables of the field's own measures: the reward by hand, and rows of few episodes."""

import math

import numpy as np
import pytest

import baselines
import rendezvous_env as rv
from research import field_tables
from research.field_tables import diameter, markdown, mean_reward, play, reward


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


def test_rest_earns_what_the_start_is_worth_all_the_time():
    team = rv.Scenario(n_robots=4, time_step=0.1, time_limit=1.0, allow_long_step=True)
    ends, earned = mean_reward(team, "zero", 3, 7)
    simulator = rv.Simulator(team, 3)
    simulator.reset(7)
    nothing = np.zeros((3, 4, 2))
    start = reward(simulator.positions, nothing, 100.0 * math.sqrt(2.0))
    np.testing.assert_allclose(earned, start, rtol=1e-12)
    np.testing.assert_allclose(ends.diameter, diameter(simulator.positions))
    assert not ends.success.any() and np.isinf(ends.time).all()


def test_who_has_met_earns_nothing_more():
    """A sum over steps that ends at rendezvous, over all steps of an episode."""
    team = rv.scenarios.get("duo")
    ends, earned = mean_reward(team, "bearing-only", 2, 0)
    law = baselines.make("bearing-only", team)
    found = rv.rollout(team, law, 0, num_envs=2, record="actions")
    total = np.zeros(2)
    for t in range(len(found.actions)):
        alive = (found.active[t] & found.running[t][:, None])[..., None]
        shares = np.where(alive, found.actions[t] / team.action_bounds, 0.0)
        gained = reward(found.positions[t + 1], shares, 100.0 * math.sqrt(2.0))
        total += np.where(found.running[t], gained, 0.0)
    np.testing.assert_allclose(earned, total / team.max_steps, rtol=1e-12)
    assert ends.success.all() and ends.clean.all() and (ends.diameter == 0).all()
    np.testing.assert_array_equal(ends.time, found.rendezvous_time)


def test_an_obstacle_touched_is_not_clean():
    ends = play(rv.scenarios.get("clutter-8"), "bearing-only", 20, 0)
    assert 0 < ends.clean.sum() < 20 and not (ends.clean & ~ends.success).any()


def test_rows_as_markdown():
    lines = list(markdown(iter([("a", "b"), ("1", "2")])))
    assert lines == ["| a | b |", "|---|---|", "| 1 | 2 |"]


def test_the_sight_of_the_reward_is_that_of_the_scenario(monkeypatch):
    asked = []

    def watched(positions, actions, sight):
        asked.append(sight)
        return reward(positions, actions, sight)

    monkeypatch.setattr(field_tables, "reward", watched)
    team = rv.scenarios.get("huettenrauch-20-sight-40").replace(time_limit=0.2)
    mean_reward(team, "zero", 1, 0)
    assert asked == [40.0, 40.0]
