"""Team reward, by hand and over whole episodes."""

import numpy as np
import pytest
from conftest import five, law_of, started

from rendezvous_env import Capsule, Disc, RewardWeights, Scenario
from rendezvous_env.engine.memory import RENDEZVOUS
from rendezvous_env.graphs import directed
from rendezvous_env.trajectory import run


@pytest.mark.parametrize("name", ["progress", "time", "bonus"])
def test_progress_telescopes_and_terms_are_separate(kind, name):
    """Progress sums to 1 over any episode that ends in rendezvous."""
    alone = {"progress": (1, 0, 0, 0), "time": (0, 1, 0, 0), "bonus": (0, 0, 0, 1)}
    reward = RewardWeights(*alone[name])
    scenario = five(kind, reward=reward, time_limit=100.0, spawn_size=5.0)
    sim, total = started(scenario, 8), np.zeros(8)
    for step in run(sim, law_of(scenario), sim.observe()):
        expected = {
            "progress": (step.lyapunov - sim.lyapunov()) / sim.initial_lyapunov * step.running,
            "time": -1.0 * step.running / scenario.max_steps,
            "bonus": step.running & (sim.status == RENDEZVOUS),
        }
        np.testing.assert_allclose(step.outcome.rewards, expected[name], atol=1e-13)
        total += step.outcome.rewards
    assert (sim.status == RENDEZVOUS).all()
    expected = -sim.steps / scenario.max_steps if name == "time" else 1.0
    np.testing.assert_allclose(total, expected)


ONLY = RewardWeights(0.0, 0.0, 0.0, 0.0, clearance_penalty=0.5)
WORLD = (Disc((0.0, 0.0), 1.0), Capsule(((-1.0, 6.0), (1.0, 6.0)), 0.5))


def team(**changes: object) -> Scenario:
    given = {"n_robots": 3, "obstacles": WORLD, "obstacle_range": 2.0, "reward": ONLY}
    return Scenario(**given | {"local_frames": "global", "time_limit": 5.0} | changes)


def test_contact_costs_per_robot_and_step():
    walls, paid = (Disc((-3.0, 0.0), 1.0), Disc((3.0, 0.0), 1.0)), RewardWeights(0.0, 0.0, 0.5, 0.0)
    pressed = team(obstacles=walls, obstacle_contact="stop", reward=paid)
    sim = started(pressed, positions=[[-1.9, 0.0], [1.9, 0.0], [0.0, 5.0]])
    into = np.array([[[-9.0, 0], [9.0, 0], [0, 0]]])
    for _ in range(4):
        outcome = sim.step(into)
    assert outcome.contact.tolist() == [[True, True, False]]
    assert outcome.rewards[0] == pytest.approx(-1.0)
    assert sim.contacts[0] >= 6


def test_clearance_penalty_follows_clearances():
    sim, random, paid = started(team(), 6, seed=1), np.random.default_rng(0), np.zeros(6)
    for _ in range(80):
        running, took_part = ~sim.ended, sim.active
        out = sim.step(random.uniform(-2, 2, (6, 3, 2)))
        closeness = np.maximum(0.0, 1.0 - out.clearance / 2.0).sum(axis=1)
        np.testing.assert_allclose(out.rewards, -0.5 * closeness * running, atol=1e-12)
        each = np.where(took_part, out.rewards[:, None], 0.0)
        np.testing.assert_array_equal(out.robot_rewards, each)
        paid += out.rewards
    assert (paid < 0).sum() >= 2


def test_merged_robots_pay_nothing():
    sim = started(team(), 6, positions=[[1.5, 0.0], [1.5, 0.1], [8.0, 0.0]])
    sim.step(np.zeros((6, 3, 2)))
    assert sim.active[0].tolist() == [True, False, True]
    out = sim.step(np.zeros((6, 3, 2)))
    assert np.isinf(out.clearance[0, 1])
    assert out.rewards[0] == pytest.approx(-0.5 * (1 - out.clearance[0, 0] / 2.0))


@pytest.mark.parametrize("changes", [{"obstacles": ()}, {"reward": RewardWeights(0, 0, 0, 0)}])
def test_clearance_penalty_is_zero_without_weight_or_obstacles(changes):
    sim = started(team(**changes), 6, positions=[[1.5, 0.0], [0.0, 4.5], [8.0, 0.0]])
    assert sim.step(np.zeros((6, 3, 2))).rewards[0] == 0


def test_reward_is_bounded_on_directed_graph():
    """All 18 neighbours of the merging robot, unknown to it, are farther away after the merge."""
    n, r = 20, 0.2
    sees = np.zeros((n, n))
    sees[1:, 0] = sees[0, 1] = 1.0
    places = np.stack([np.full(n, -0.6), 0.01 * np.arange(n)], axis=-1)
    places[:2] = (0.0, 0.0), (1.0001 * r, 0.0)
    scenario = Scenario(
        n_robots=n, graph=directed(sees), start_positions=places, local_frames="global",
        max_speed=1e-3, reward=RewardWeights(1.0, 0.0, 0.0, 0.0),
    )  # fmt: skip
    sim = started(scenario)
    actions = np.zeros((1, n, 2))
    actions[0, :2, 0] = 1e-3, -1e-3
    (earned,) = sim.step(actions).rewards * sim.initial_lyapunov
    walked = 2.0 * scenario.speed_limit * scenario.tau * sees.sum()
    assert sim.active.sum() == n - 1
    assert -walked - r * sees.sum() < earned < -walked - 2.0 * r * scenario.max_degree
