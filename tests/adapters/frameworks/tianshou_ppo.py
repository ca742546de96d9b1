"""Tianshou: PPO over the robots of many environments, each as a separate environment."""

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from held_out import SCENARIO, measure, settings
from tianshou.algorithm.modelfree.ppo import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Batch, Collector, VectorReplayBuffer
from tianshou.env import BaseVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic

from rendezvous_env import vector

given = settings(__doc__, epochs=12, num_envs=64)


class Robots(BaseVectorEnv):
    """Slot = environment · n + robot. The robots of an environment end and reset together."""

    is_async = False
    is_closed = False

    def __init__(self, teams):
        self.teams, self.n = teams, teams.scenario.n_robots
        self.env_num = teams.num_envs * self.n
        spaces = teams.single_observation_space, teams.single_action_space
        self.observation_space, self.action_space = (
            [type(space)(space.low[0], space.high[0], dtype=space.dtype)] * self.env_num
            for space in spaces
        )

    def __getattribute__(self, name):
        return object.__getattribute__(self, name)

    def __len__(self):
        return self.env_num

    def reset(self, env_id=None, **options):
        ids = np.arange(self.env_num) if env_id is None else np.asarray(env_id)
        mask = np.zeros(self.teams.num_envs, dtype=bool)
        mask[ids // self.n] = True
        seen, _ = self.teams.reset(options={"reset_mask": mask}, **options)
        return seen.reshape(self.env_num, -1)[ids], np.array([{}] * len(ids))

    def step(self, action, id=None):
        shape = self.teams.action_space.shape
        seen, _, ends, cuts, infos = self.teams.step(np.reshape(action, shape))
        told = np.array([{"env_id": slot} for slot in range(self.env_num)])
        ends, cuts = np.repeat(ends, self.n), np.repeat(cuts, self.n)
        rewards = infos["robot_rewards"].reshape(-1)
        return seen.reshape(self.env_num, -1), rewards, ends, cuts, told

    def close(self):
        self.teams.close()


robots = Robots(
    vector.training_env(SCENARIO, given.num_envs, autoreset_mode=AutoresetMode.DISABLED)
)
actions = robots.action_space[0]
size = robots.observation_space[0].shape[0]
torch.manual_seed(0)
torch.set_num_threads(1)
actor = ContinuousActorProbabilistic(
    preprocess_net=Net(state_shape=(size,), hidden_sizes=(64, 64)),
    action_shape=actions.shape,
    unbounded=True,
)
critic = ContinuousCritic(preprocess_net=Net(state_shape=(size,), hidden_sizes=(64, 64)))
brain = ProbabilisticActorPolicy(
    actor=actor,
    dist_fn=lambda found: torch.distributions.Independent(torch.distributions.Normal(*found), 1),
    action_space=actions,
    deterministic_eval=True,
)
learner = PPO(policy=brain, critic=critic, optim=AdamOptimizerFactory(lr=1e-3), gamma=0.97)
collector = Collector(learner, robots, VectorReplayBuffer(64 * len(robots), len(robots)))


def random_steps():
    collector.collect(n_step=10 * len(robots), random=True)
    return 10 * len(robots)


def policy(seen):
    brain.eval()
    with torch.no_grad():
        found = brain(Batch(obs=seen, info={}))
    return np.clip(brain.map_action(found.act.numpy()), -1, 1)


def train():
    collector.reset()
    steps = 32 * len(robots)
    learner.run_training(
        OnPolicyTrainerParams(
            training_collector=collector,
            max_epochs=given.epochs,
            epoch_num_steps=2 * steps,
            collection_step_num_env_steps=steps,
            batch_size=1024,
            update_step_num_repetitions=4,
            show_progress=False,
            verbose=False,
        )
    )
    return given.epochs * 2 * steps


collector.reset(gym_reset_kwargs={"seed": 0})
measure(random_steps, train, policy, given.episodes)
