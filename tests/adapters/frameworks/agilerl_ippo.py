"""AgileRL: IPPO with one network per group of robots, over many environments."""

import numpy as np
import torch
from agilerl.algorithms import IPPO
from held_out import SCENARIO, measure, settings

import rendezvous_env as rv

given = settings(__doc__, updates=24, num_envs=64)
HORIZON = 32
envs = rv.vector.training_env(SCENARIO, given.num_envs)
one = rv.training_env(SCENARIO)
names = one.possible_agents
frames = HORIZON * given.num_envs * len(names)


def by_name(table):
    """Columns of (B, n, …) per robot."""
    return {name: table[:, i] for i, name in enumerate(names)}


def table_of(found):
    return np.clip(np.stack([found[name] for name in names], axis=1), -1, 1).astype(np.float32)


def random_steps():
    envs.step(envs.action_space.sample())
    return given.num_envs * len(names)


torch.manual_seed(0)
np.random.seed(0)  # AgileRL draws minibatches from it
torch.set_num_threads(1)
learner = IPPO(
    observation_spaces=[one.observation_space(name) for name in names],
    action_spaces=[one.action_space(name) for name in names],
    agent_ids=names,
    batch_size=1024,
    lr=1e-3,
    gamma=0.97,
    learn_step=frames // len(names),
)


def policy(seen):
    """Actions of the robots of one environment, each as a batch of one."""
    learner.set_training_mode(False)
    return table_of(learner.get_action(by_name(seen[None]))[0])[0]


def train():
    learner.set_training_mode(True)
    seen, _ = envs.reset(seed=0)
    over = np.zeros((given.num_envs, len(names)))
    for _ in range(given.updates):
        rows = [[] for _ in range(6)]
        for _ in range(HORIZON):
            actions, chances, _, values = learner.get_action(by_name(seen))
            after, _, ends, cuts, infos = envs.step(table_of(actions))
            rewards = by_name(infos["robot_rewards"].astype(np.float32))
            step = by_name(seen), actions, chances, rewards, by_name(over), values
            for row, found in zip(rows, step, strict=True):
                row.append(found)
            seen, over = after, np.repeat((ends | cuts)[:, None], len(names), axis=1).astype(float)
        columns = [{name: [found[name] for found in row] for name in names} for row in rows]
        learner.learn((*columns, by_name(seen), by_name(over)))
    return given.updates * frames


envs.reset(seed=0)
measure(random_steps, train, policy, given.episodes)
