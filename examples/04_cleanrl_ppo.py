"""PPO in one file, without stable-baselines3: heading vectors that keep Theorem 2 while they learn.

Every robot of every team is a sample of one shared network. A robot that has merged is left out by
a mask. A time-out is no true end: the value of what was seen last is added to its reward.
"""

import argparse

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn
from torch.distributions import Normal

import rendezvous_env as rv
from rendezvous_env.vector import HeadingVectorWrapper

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--scenario", default="swarm-20")
parser.add_argument("--updates", type=int, default=20)
parser.add_argument("--teams", type=int, default=64)
parser.add_argument("--steps", type=int, default=32)
parser.add_argument("--seed", type=int, default=0)
given = parser.parse_args()
GAMMA, LAMBDA, CLIP, EPOCHS, MINIBATCHES = 0.99, 0.95, 0.2, 4, 8

torch.manual_seed(given.seed)
env = HeadingVectorWrapper(
    rv.make_vec(given.scenario, given.teams, autoreset_mode=AutoresetMode.SAME_STEP)
)
n, *seen = env.single_observation_space.shape
size, moves = int(np.prod(seen)), env.single_action_space.shape[-1]


def network(outputs: int) -> nn.Sequential:
    """What reads the rows of one robot."""
    return nn.Sequential(
        nn.Flatten(), nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(),
        nn.Linear(64, outputs),
    )  # fmt: skip


actor, critic = network(moves), network(1)
log_std = nn.Parameter(torch.full((moves,), -0.5))
optimiser = torch.optim.Adam([*actor.parameters(), *critic.parameters(), log_std], lr=1e-3)


def value_of(observations: np.ndarray) -> np.ndarray:
    """Estimated future rewards of robots (B, n)."""
    with torch.no_grad():
        return critic(torch.as_tensor(observations).reshape(-1, size)).reshape(-1, n).numpy()


observations, infos = env.reset(seed=given.seed)
active, shape = infos["active"].copy(), (given.steps, given.teams, n)
for update in range(given.updates):
    kept = {
        "seen": np.zeros((*shape, *seen), np.float32),
        "raw": np.zeros((*shape, moves), np.float32),
    }
    log_probs, values, rewards = (np.zeros(shape, np.float32) for _ in range(3))
    alive, ends = np.zeros(shape, bool), np.zeros(shape, bool)
    met = []
    for t in range(given.steps):
        with torch.no_grad():
            choice = Normal(actor(torch.as_tensor(observations).reshape(-1, size)), log_std.exp())
            raw = choice.sample()
            log_probs[t] = choice.log_prob(raw).sum(-1).reshape(-1, n).numpy()
        kept["seen"][t], kept["raw"][t] = observations, raw.reshape(-1, n, moves).numpy()
        values[t], alive[t] = value_of(observations), active
        observations, _, terminated, truncated, infos = env.step(kept["raw"][t].clip(-1, 1))
        rewards[t] = infos["robot_rewards"]
        over = terminated | truncated
        ends[t] = over[:, None] | ~infos["active"]
        merged = active & ~infos["active"] & ~over[:, None]  # valued by what the survivor sees
        into = infos["merged_into"]
        rewards[t] += GAMMA * merged * np.take_along_axis(value_of(observations), into, axis=1)
        for team in np.flatnonzero(truncated):
            rewards[t, team] += GAMMA * value_of(infos["final_obs"][team][None])[0]
        active = infos["active"].copy()
        met += terminated[over].tolist()
    advantages, later = np.zeros(shape, np.float32), np.zeros(shape[1:], np.float32)
    following = value_of(observations)
    for t in reversed(range(given.steps)):
        goes_on = ~ends[t]
        delta = rewards[t] + GAMMA * following * goes_on - values[t]
        later = advantages[t] = delta + GAMMA * LAMBDA * goes_on * later
        following = values[t]
    flat = [
        torch.as_tensor(array[alive])
        for array in (kept["seen"], kept["raw"], log_probs, advantages, advantages + values)
    ]
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(flat[0])).chunk(MINIBATCHES):
            x, raw, old, gain, target = (array[batch] for array in flat)
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            choice = Normal(actor(x), log_std.exp())
            ratio = (choice.log_prob(raw).sum(-1) - old).exp()
            policy_loss = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            value_loss = (critic(x).squeeze(-1) - target).square().mean()
            loss = policy_loss + 0.5 * value_loss
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    episodes = f"{np.mean(met):.0%} of {len(met)} met" if met else "no episode ended"
    reward = f"reward {rewards[alive].mean():+.4f}"
    print(f"update {update + 1}: loss {loss.item():.3f}, {reward}, {episodes}")
