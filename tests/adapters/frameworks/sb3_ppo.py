"""stable-baselines3: PPO over the robots of many environments (VecEnv of ``adapters.sb3``)."""

import numpy as np
from held_out import SCENARIO, measure, settings
from stable_baselines3 import PPO

from rendezvous_env import vector
from rendezvous_env.adapters.sb3 import RobotVecEnv

given = settings(__doc__, frames=200_000, num_envs=64)
robots = RobotVecEnv(vector.training_env(SCENARIO, given.num_envs))
rng = np.random.default_rng(0)
model = PPO("MlpPolicy", robots, n_steps=64, batch_size=1024, n_epochs=5, seed=0, device="cpu")


def random_steps():
    robots.step(rng.uniform(-1, 1, (robots.num_envs, 2)))
    return robots.num_envs


def policy(seen):
    return model.predict(seen, deterministic=True)[0]


robots.seed(0)
robots.reset()
measure(random_steps, lambda: model.learn(given.frames).num_timesteps, policy, given.episodes)
