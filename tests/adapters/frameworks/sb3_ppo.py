"""stable-baselines3: PPO over the robots of many teams, through the VecEnv of ``adapters.sb3``."""

import argparse
import time

import numpy as np
from held_out import SCENARIO, STARTS, clean_success, frames_per_second, report
from stable_baselines3 import PPO

from rendezvous_env import vector
from rendezvous_env.adapters.sb3 import RobotVecEnv

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--frames", type=int, default=200_000)
parser.add_argument("--teams", type=int, default=64)
parser.add_argument("--starts", type=int, default=len(STARTS))
given = parser.parse_args()

robots = RobotVecEnv(vector.training_env(SCENARIO, given.teams))
rng = np.random.default_rng(0)


def random_steps():
    robots.step(rng.uniform(-1, 1, (robots.num_envs, 2)))
    return robots.num_envs


robots.seed(0)
robots.reset()
speed = frames_per_second(random_steps)
model = PPO("MlpPolicy", robots, n_steps=64, batch_size=1024, n_epochs=5, seed=0, device="cpu")


def policy(seen):
    return model.predict(seen, deterministic=True)[0]


before = clean_success(policy, STARTS[: given.starts])
began = time.perf_counter()
model.learn(given.frames)
report(
    frames_per_second=speed,
    training_frames=model.num_timesteps,
    training_seconds=time.perf_counter() - began,
    before=before,
    after=clean_success(policy, STARTS[: given.starts]),
)
