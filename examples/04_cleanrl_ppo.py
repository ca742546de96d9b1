"""PPO in one file: raw headings under the certified-heading filter (Theorem C).

Every robot of every environment is a sample of one shared network. A mask excludes merged robots.
Merges and time-outs are bootstrapped, with the value of the survivor's or the robot's own last
observation. Evaluation uses held-out initial conditions.
"""

import argparse

import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import rendezvous_env as rv
from rendezvous_env.adapters.slots import RobotSlots

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scenario", default="clutter-8")
parser.add_argument("--updates", type=int, default=150)
parser.add_argument("--num-envs", type=int, default=128)
parser.add_argument("--steps", type=int, default=32)
parser.add_argument("--held-out", type=int, default=500, help="initial conditions for evaluation")
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()
GAMMA, LAMBDA, CLIP, EPOCHS, MINIBATCHES, ENTROPY = 0.99, 0.95, 0.2, 4, 8, 1e-3
HELD_OUT = 1_000_000  # first evaluation seed

torch.manual_seed(given.seed)
torch.set_num_threads(1)  # the network is small


def make(num_envs: int) -> RobotSlots:
    """Robots that choose a raw heading every 12 steps; the first contact costs 1."""
    return RobotSlots(
        rv.vector.training_env(
            given.scenario,
            num_envs,
            guarantee="heading",
            learning_preset=False,
            decision_period=12,
            contact_penalty=1.0,
            reward=rv.RewardWeights(collision_penalty=0.0),  # covered by contact_penalty
        )
    )


robots = make(given.num_envs)
size, moves = robots.single_observation_space.shape[0], robots.single_action_space.shape[0]


def network(outputs: int, scale: float) -> nn.Sequential:
    """Network on the rows of one robot; ``scale`` initialises the last layer."""
    layers = [nn.Linear(size, 128), nn.Linear(128, 128), nn.Linear(128, outputs)]
    for layer, gain in zip(layers, (2**0.5, 2**0.5, scale), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


actor, critic = network(moves, 0.01), network(1, 1.0)
log_std = nn.Parameter(torch.full((moves,), -0.5))
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimiser = torch.optim.Adam(parameters, lr=1e-3)


@torch.no_grad()
def value_of(observations: np.ndarray) -> np.ndarray:
    """Estimated future rewards of robots, (k,)."""
    return critic(torch.as_tensor(observations)).squeeze(-1).numpy()


@torch.no_grad()
def judge() -> str:
    """Success of the greedy policy on held-out initial conditions."""
    env, first = make(given.held_out), {}
    seen = env.reset(HELD_OUT)
    while len(first) < given.held_out:
        step = env.step(actor(torch.as_tensor(seen)).numpy().clip(-1, 1))
        seen, first = step.observations, step.finished | first
    met = np.array([episode["success"] for episode in first.values()])
    clean = met & np.array([episode["contacts"] == 0 for episode in first.values()])
    return f"{met.mean():.1%} met, {clean.mean():.1%} without a touch"


print("before:", judge(), flush=True)
seen, shape = robots.reset(given.seed), (given.steps, given.num_envs * robots.n_robots)
samples = 0
for update in range(given.updates):
    optimiser.param_groups[0]["lr"] = 1e-3 * (1 - update / given.updates)
    observations = np.zeros((*shape, size), np.float32)
    chosen = np.zeros((*shape, moves), np.float32)
    log_probs, values, rewards = (np.zeros(shape, np.float32) for _ in range(3))
    acted, ended = np.zeros(shape, bool), np.zeros(shape, bool)
    met = []
    for t in range(given.steps):
        with torch.no_grad():
            choice = Normal(actor(torch.as_tensor(seen)), log_std.exp())
            raw = choice.sample()
            log_probs[t] = choice.log_prob(raw).sum(-1).numpy()
        observations[t], chosen[t], values[t] = seen, raw.numpy(), value_of(seen)
        step = robots.step(chosen[t].clip(-1, 1))
        seen, acted[t], ended[t], rewards[t] = step[0], step.acted, step.ended, step.rewards
        rewards[t, step.bootstrapped] += GAMMA * value_of(step.bootstrap_observations)
        met += [episode["success"] for episode in step.finished.values()]
    advantages, later = np.zeros(shape, np.float32), np.zeros(shape[1], np.float32)
    following = value_of(seen)
    for t in reversed(range(given.steps)):
        delta = rewards[t] + GAMMA * following * ~ended[t] - values[t]
        later = advantages[t] = delta + GAMMA * LAMBDA * ~ended[t] * later
        following = values[t]
    flat = [
        torch.as_tensor(array[acted])
        for array in (observations, chosen, log_probs, advantages, advantages + values)
    ]
    samples += len(flat[0])
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(flat[0])).chunk(MINIBATCHES):
            x, raw, old, gain, target = (array[batch] for array in flat)
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            choice = Normal(actor(x), log_std.exp())
            ratio = (choice.log_prob(raw).sum(-1) - old).exp()
            policy_loss = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            value_loss = (critic(x).squeeze(-1) - target).square().mean()
            loss = policy_loss + 0.5 * value_loss - ENTROPY * choice.entropy().sum(-1).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimiser.step()
    if update % 10 == 9 or update + 1 == given.updates:
        episodes = f"{np.mean(met):.0%} of {len(met)} met" if met else "no episode ended"
        reward = f"reward {rewards[acted].mean():+.4f}"
        print(f"update {update + 1}: loss {loss.item():.3f}, {reward}, {episodes}", flush=True)
print(f"after {samples:,} decisions of robots:", judge())
