"""PPO of RLlib with a set network, evaluated on held-out initial conditions."""

import argparse
import logging

import numpy as np
import ray
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.columns import Columns

import rendezvous_env as rv
from rendezvous_env.adapters import rllib
from rendezvous_env.adapters.slots import RobotSlots
from rendezvous_env.vector import training_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scenario", default="clutter-8")
parser.add_argument("--num-envs", type=int, default=64)
parser.add_argument("--updates", type=int, default=40)
parser.add_argument("--batch", type=int, default=4096, help="decisions of robots per update")
parser.add_argument("--held-out", type=int, default=200, help="initial conditions for evaluation")
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()
HELD_OUT = 1_000_000  # first evaluation seed
CHOICES = {  # a raw heading every 12 steps; the first contact of a robot costs 1
    "guarantee": "heading",
    "learning_preset": False,
    "decision_period": 12,
    "contact_penalty": 1.0,
    "reward": rv.RewardWeights(collision_penalty=0.0),
}
torch.set_num_threads(1)  # the network is small


def judge(module):
    """Success of the sampled policy on held-out initial conditions.

    The mean action alone may leave a robot at an obstacle, from which samples free it.
    """
    env, first = RobotSlots(training_env(given.scenario, given.held_out, **CHOICES)), {}
    seen = env.reset(HELD_OUT)
    distribution = module.get_exploration_action_dist_cls()
    torch.manual_seed(given.seed)
    while len(first) < given.held_out:
        out = module.forward_inference({Columns.OBS: torch.as_tensor(seen)})
        chosen = distribution.from_logits(out[Columns.ACTION_DIST_INPUTS]).sample()
        step = env.step(chosen.numpy().clip(-1, 1))
        seen, first = step.observations, step.finished | first
    met = np.array([episode["success"] for episode in first.values()])
    clean = met & np.array([episode["contacts"] == 0 for episode in first.values()])
    return f"{met.mean():.1%} met, {clean.mean():.1%} without a touch"


logging.getLogger("ray").setLevel(logging.ERROR)
ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False)
config = rllib.configure(PPOConfig(), given.scenario, num_envs=given.num_envs, units=64, **CHOICES)
config.env_runners(num_env_runners=0).debugging(seed=given.seed, log_level="ERROR")
config.training(
    train_batch_size=given.batch,
    minibatch_size=given.batch // 8,
    num_epochs=4,
    lr=1e-3,
    gamma=0.99,
    lambda_=0.95,
    clip_param=0.2,
    vf_clip_param=100.0,
    entropy_coeff=1e-3,
    grad_clip=0.5,
    use_kl_loss=False,
)
algorithm = config.build_algo()
print("before:", judge(algorithm.get_module()), flush=True)
for update in range(given.updates):
    told = algorithm.train()["env_runners"]
    if update % 10 == 9 or update + 1 == given.updates:
        reward, met = told.get("episode_return_mean", np.nan), told.get("success", np.nan)
        print(f"update {update + 1}: return {reward:+.3f}, {met:.0%} met", flush=True)
print(f"after {told['num_env_steps_sampled_lifetime']:,.0f} decisions of robots:", end=" ")
print(judge(algorithm.get_module()))
algorithm.stop()
ray.shutdown()
