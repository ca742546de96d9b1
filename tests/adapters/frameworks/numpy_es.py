"""NumPy with Gymnasium's vector API: evolution strategies on a linear policy."""

import numpy as np
from held_out import SCENARIO, measure, settings

from rendezvous_env import vector

# a generation has mirrored pairs of candidates, and each plays in num_envs environments
given = settings(__doc__, generations=20, pairs=16, num_envs=8)
candidates = 2 * given.pairs
envs = vector.training_env(SCENARIO, candidates * given.num_envs)
_, n, size = envs.observation_space.shape
robots = candidates * given.num_envs * n
rng = np.random.default_rng(0)
mean = rng.normal(0, 0.1, (size, 2))


def random_steps():
    envs.step(envs.action_space.sample())
    return robots


def returns(weights, seed):
    """Mean return of each candidate in one episode; weights (candidates, size, 2)."""
    observations, _ = envs.reset(seed=seed)
    total, running = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=bool)
    steps = 0
    while running.any():
        seen = observations.reshape(candidates, -1, size)
        actions = np.tanh(seen @ weights).reshape(envs.action_space.shape)
        observations, rewards, ends, cuts, _ = envs.step(actions.astype(np.float32))
        total += running * rewards
        running &= ~(ends | cuts)
        steps += robots
    return total.reshape(candidates, -1).mean(axis=1), steps


def policy(seen):
    return np.tanh(seen @ mean).astype(np.float32)


def train():
    frames = 0
    for generation in range(given.generations):
        noise = rng.normal(0, 0.1, (given.pairs, size, 2))
        found, steps = returns(mean + np.concatenate([noise, -noise]), 1000 * generation)
        better = found[: given.pairs] - found[given.pairs :]
        mean[:] += 0.1 * np.tensordot(better / (better.std() + 1e-8), noise, axes=1)
        frames += steps
    return frames


envs.reset(seed=0)
measure(random_steps, train, policy, given.episodes)
