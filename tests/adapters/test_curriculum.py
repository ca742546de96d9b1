"""Training of one network on teams and maps of different sizes in sequence."""

import numpy as np
import pytest
from stable_baselines3 import PPO

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.vector import training_env

SIZE = {"neighbour_slots": 7, "obstacle_slots": 6, "obstacle_overflow": "nearest"}
"""Scenario with observations of up to eight robots, and of the six nearest obstacles."""
STAGES = [
    ("clutter-4", {}),
    ("clutter-16", {}),
    ("clutter-16-team-8", {}),
    ("rooms", {"n_robots": 8}),
]


@pytest.fixture(autouse=True)
def one_torch_thread(set_threads):
    set_threads(1)


def stage(scenario, slots=16, **fields):
    """Environments for a given total number of robots."""
    fields = {"time_limit": 3.0} | SIZE | fields
    teams = slots // rv.scenarios.resolve(scenario, **fields).n_robots
    return RobotVecEnv(training_env(scenario, teams, **fields))


def test_one_network_learns_in_every_stage_of_a_curriculum():
    (first, fields), *later = STAGES
    model = PPO("MlpPolicy", stage(first, **fields), n_steps=8, batch_size=64, device="cpu", seed=0)
    model.learn(128)
    weights = [parameter.shape for parameter in model.policy.parameters()]
    for scenario, fields in later:
        model.set_env(stage(scenario, **fields))
        model.learn(128, reset_num_timesteps=False)
    assert [parameter.shape for parameter in model.policy.parameters()] == weights
    assert model.num_timesteps == 128 * len(STAGES)
    large = rv.scenarios.resolve("clutter-24", n_robots=6, time_limit=1.0, **SIZE)
    found = rv.rollout(large, baselines.TrainedPolicy(large, model.predict), num_envs=2)
    assert np.isfinite(found.positions).all()
    with pytest.raises(
        ValueError, match=r"predict was trained for observations of shape \("
    ) as said:
        baselines.TrainedPolicy("clutter-4", model.predict)
    assert "in 'clutter-4' it gets (55,), with neighbour_slots = 3 and" in str(said.value)
    assert "Give the arguments of training_env in training" in str(said.value)
