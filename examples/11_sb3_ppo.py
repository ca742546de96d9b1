"""stable-baselines3 PPO: train, compare with a rule, write a report."""

import argparse
from pathlib import Path

from rendezvous_env.train.compare import compare
from rendezvous_env.train.report import build
from stable_baselines3 import PPO

from rendezvous_env import baselines
from rendezvous_env.adapters.sb3 import RobotVecEnv
from rendezvous_env.vector import training_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=200_000, help="decisions of robots")
parser.add_argument("--num-envs", type=int, default=64)
parser.add_argument("--episodes", type=int, default=50)
parser.add_argument("--out", type=Path, default=Path("out/sb3"))
given = parser.parse_args()

robots = RobotVecEnv(training_env("clutter-8", given.num_envs))
model = PPO("MlpPolicy", robots, n_steps=32, batch_size=1024, seed=0, device="cpu")
model.learn(given.steps)


@baselines.policy.register("ppo", fits=lambda scenario: scenario.name == "clutter-8")
def ppo(scenario):
    """PPO of stable-baselines3, under certified headings."""
    return baselines.TrainedPolicy(scenario, model.predict)


names = ("tangent-merged-tuned", "ppo")
compare.run(
    compare.Config(("clutter-8",), names, episodes=given.episodes, out=given.out, figures=False)
)
build.run(build.Config(given.out))
