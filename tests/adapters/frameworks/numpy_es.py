"""Gymnasium's vector API and NumPy alone: evolution strategies on a linear policy."""

import argparse
import time

import numpy as np
from held_out import SCENARIO, STARTS, clean_success, frames_per_second, report

from rendezvous_env import vector

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--generations", type=int, default=20)
parser.add_argument("--pairs", type=int, default=16, help="mirrored candidates in a generation")
parser.add_argument("--teams", type=int, default=8, help="that play each candidate")
parser.add_argument("--starts", type=int, default=len(STARTS))
given = parser.parse_args()

candidates = 2 * given.pairs
envs = vector.training_env(SCENARIO, candidates * given.teams)
_, n, size = envs.observation_space.shape
robots = candidates * given.teams * n
rng = np.random.default_rng(0)


def random_steps():
    envs.step(envs.action_space.sample())
    return robots


def returns(weights, seed):
    """Mean return of each candidate's teams over one episode; weights (candidates, size, 2)."""
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


def policy_of(weights):
    return lambda seen: np.tanh(seen @ weights).astype(np.float32)


envs.reset(seed=0)
speed = frames_per_second(random_steps)
mean = rng.normal(0, 0.1, (size, 2))
before = clean_success(policy_of(mean), STARTS[: given.starts])
began, frames = time.perf_counter(), 0
for generation in range(given.generations):
    noise = rng.normal(0, 0.1, (given.pairs, size, 2))
    found, steps = returns(mean + np.concatenate([noise, -noise]), 1000 * generation)
    better = found[: given.pairs] - found[given.pairs :]
    mean += 0.1 * np.tensordot(better / (better.std() + 1e-8), noise, axes=1)
    frames += steps
report(
    frames_per_second=speed,
    training_frames=frames,
    training_seconds=time.perf_counter() - began,
    before=before,
    after=clean_success(policy_of(mean), STARTS[: given.starts]),
)
