"""The reward term for keeping clear of obstacles."""

from __future__ import annotations

import numpy as np
import pytest

from rendezvous_env import Capsule, Disc, RewardWeights, Scenario, Simulator
from rendezvous_env.rewards.terms import team_reward

ONLY = RewardWeights(0.0, 0.0, 0.0, 0.0, clearance_penalty=0.5)
WORLD = (Disc((0.0, 0.0), 1.0), Capsule(((-1.0, 6.0), (1.0, 6.0)), 0.5))
PLACES = [[1.5, 0.0], [0.0, 4.5], [8.0, 0.0]]
"""0.5 m from the disc, 1 m from the capsule, out of sight."""


def team(**changes: object) -> Scenario:
    given = {"n_robots": 3, "obstacles": WORLD, "obstacle_range": 2.0, "reward": ONLY}
    return Scenario(**given | {"local_frames": "global", "time_limit": 5.0} | changes)


def test_one_term_by_hand():
    weights = (0.0, 0.0, 0.0, 0.0, 0.5)
    assert team_reward(0.3, 0.01, 2, 1.25, False, weights) == pytest.approx(-0.625)
    assert team_reward(0.3, 0.01, 2, 1.25, True, (2.0, 1.0, 0.1, 3.0, 0.5)) == pytest.approx(
        0.6 - 0.01 - 0.2 - 0.625 + 3.0
    )


@pytest.mark.parametrize("num_envs", [1, 6])
def test_each_robot_pays_by_how_near_it_is(num_envs):
    sim = Simulator(team(), num_envs)
    sim.reset(0, {"positions": PLACES})
    out = sim.step(np.zeros((num_envs, 3, 2)))
    np.testing.assert_allclose(out.clearance[0, :2], [0.5, 1.0])
    np.testing.assert_allclose(out.rewards, -0.5 * ((1 - 0.25) + (1 - 0.5)))
    np.testing.assert_array_equal(out.robot_rewards, np.repeat(out.rewards[:, None], 3, axis=1))


def test_it_follows_the_clearances_of_every_step():
    sim, random = Simulator(team(), 4), np.random.default_rng(0)
    sim.reset(1)
    paid = np.zeros(4)
    for _ in range(80):
        running = ~sim.ended
        out = sim.step(random.uniform(-2, 2, (4, 3, 2)))
        closeness = np.maximum(0.0, 1.0 - out.clearance / 2.0).sum(axis=1)
        np.testing.assert_allclose(out.rewards, -0.5 * closeness * running, atol=1e-12)
        paid += out.rewards
    assert (paid < 0).sum() >= 2


def test_who_has_merged_pays_nothing_and_the_survivor_once():
    sim = Simulator(team())
    sim.reset(0, {"positions": [[1.5, 0.0], [1.5, 0.1], [8.0, 0.0]]})
    sim.step(np.zeros((1, 3, 2)))
    assert sim.active[0].tolist() == [True, False, True]
    out = sim.step(np.zeros((1, 3, 2)))
    assert np.isinf(out.clearance[0, 1])
    assert out.rewards[0] == pytest.approx(-0.5 * (1 - out.clearance[0, 0] / 2.0))


def test_without_weight_or_obstacles_it_is_nothing():
    free = Simulator(team(obstacles=()))
    free.reset(0, {"positions": PLACES})
    assert free.step(np.zeros((1, 3, 2))).rewards[0] == 0
    assert RewardWeights().clearance_penalty == 0
    plain = Simulator(team(reward=RewardWeights(0.0, 0.0, 0.0, 0.0)))
    plain.reset(0, {"positions": PLACES})
    assert plain.step(np.zeros((1, 3, 2))).rewards[0] == 0


def test_it_is_kept_in_files_and_checked(tmp_path):
    team().to_toml(tmp_path / "near.toml")
    assert "clearance_penalty = 0.5" in (tmp_path / "near.toml").read_text()
    assert Scenario.from_toml(tmp_path / "near.toml") == team()
    with pytest.raises(ValueError, match=r"reward.clearance_penalty is nan"):
        RewardWeights(clearance_penalty=float("nan"))
