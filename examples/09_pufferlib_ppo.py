"""PPO of PufferLib: robots as agents in shared buffers, evaluated on held-out initial conditions.

The trainer needs PufferLib's compiled part; see docs/learners.md for the installation.
"""

import argparse
import contextlib
import io
import tempfile

import numpy as np
import torch
from pufferlib import models, pufferl

from rendezvous_env.adapters import pufferlib as robots

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scenario", default="clutter-8")
parser.add_argument("--num-envs", type=int, default=128)
parser.add_argument("--updates", type=int, default=60)
parser.add_argument("--held-out", type=int, default=200, help="initial conditions for evaluation")
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()
HORIZON = 32
HELD_OUT = 1_000_000  # first evaluation seed
torch.manual_seed(given.seed)
torch.set_num_threads(1)  # the network is small


def make(num_envs, seed):
    """Robots that choose a raw heading every 12 steps; the first contact costs 1."""
    choices = {"guarantee": "heading", "learning_preset": False, "decision_period": 12}
    return robots.make(given.scenario, num_envs, seed=seed, contact_penalty=1.0, **choices)


def judge(policy):
    """Success of the greedy policy on held-out initial conditions."""
    env, first = make(given.held_out, HELD_OUT), {}
    seen, _ = env.reset()
    while len(first) < given.held_out:
        with torch.no_grad():
            choice, _ = policy.forward_eval(torch.as_tensor(seen))
        seen, _, ends, cuts, infos = env.step(choice.mean.numpy().clip(-1, 1))
        over = np.flatnonzero((ends | cuts)[:: env.slots.n_robots])
        first = dict(zip(over.tolist(), infos, strict=True)) | first
    met = np.array([episode["success"] for episode in first.values()])
    clean = met & np.array([episode["contacts"] == 0 for episode in first.values()])
    return f"{met.mean():.1%} met, {clean.mean():.1%} without a touch"


env = make(given.num_envs, given.seed)
policy = models.Default(env, hidden_size=128)
print("before:", judge(policy), flush=True)
batch = env.num_agents * HORIZON
settings = {
    "seed": given.seed, "device": "cpu", "env": given.scenario, "torch_deterministic": True,
    "total_timesteps": given.updates * batch, "batch_size": batch, "bptt_horizon": HORIZON,
    "minibatch_size": batch // 8, "max_minibatch_size": batch // 8, "update_epochs": 3,
    "optimizer": "adam", "learning_rate": 1e-3, "anneal_lr": True,
    "adam_beta1": 0.9, "adam_beta2": 0.999, "adam_eps": 1e-5, "max_grad_norm": 0.5,
    "gamma": 0.99, "gae_lambda": 0.95, "vtrace_rho_clip": 1.0, "vtrace_c_clip": 1.0,
    "clip_coef": 0.2, "vf_coef": 0.5, "vf_clip_coef": 10.0, "ent_coef": 0.003,
    "prio_alpha": 0.0, "prio_beta0": 1.0, "use_rnn": False, "cpu_offload": False,
    "compile": False, "precision": "float32", "checkpoint_interval": given.updates + 1,
}  # fmt: skip
with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
    trainer = pufferl.PuffeRL(settings | {"data_dir": folder}, env, policy)
    while trainer.global_step < settings["total_timesteps"]:
        trainer.evaluate()
        trainer.train()
    trainer.close()
print(f"after {trainer.global_step:,} steps of robots:", judge(policy))
