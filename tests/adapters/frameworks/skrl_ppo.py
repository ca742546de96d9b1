"""skrl: PPO over the robots of many environments, each robot as a separate environment."""

import gymnasium
import numpy as np
import torch
from held_out import SCENARIO, measure, settings
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import Wrapper
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed

from rendezvous_env import vector

given = settings(__doc__, steps=768, num_envs=64)
HORIZON = 32


class Robots(Wrapper):
    """Slot = environment · n + robot; environments reset in the step in which they end."""

    def __init__(self, teams):
        super().__init__(teams)
        self.n = teams.scenario.n_robots
        self.seen, self.acts = (
            gymnasium.spaces.Box(space.low[0], space.high[0], dtype=space.dtype)
            for space in (teams.single_observation_space, teams.single_action_space)
        )

    num_envs = property(lambda self: self._env.num_envs * self.n)
    observation_space = property(lambda self: self.seen)
    action_space = property(lambda self: self.acts)

    def reset(self):
        observations, _ = self._env.reset(seed=0)
        return torch.from_numpy(observations.reshape(self.num_envs, -1)), {}

    def step(self, actions):
        table = actions.numpy().reshape(self._env.action_space.shape)
        observations, _, ends, cuts, infos = self._env.step(np.clip(table, -1, 1))
        rewards = torch.from_numpy(infos["robot_rewards"].astype(np.float32)).reshape(-1, 1)
        over = (torch.from_numpy(np.repeat(found, self.n))[:, None] for found in (ends, cuts))
        return torch.from_numpy(observations.reshape(self.num_envs, -1)), rewards, *over, {}

    def state(self):
        return None

    def render(self):
        return None

    def close(self):
        self._env.close()


def layers(size, outputs):
    return torch.nn.Sequential(
        *(torch.nn.Linear(size, 64), torch.nn.Tanh(), torch.nn.Linear(64, 64), torch.nn.Tanh()),
        torch.nn.Linear(64, outputs),
    )


class Actor(GaussianMixin, Model):
    def __init__(self, env):
        Model.__init__(self, observation_space=env.seen, action_space=env.acts, device="cpu")
        GaussianMixin.__init__(self)
        self.net = layers(self.num_observations, self.num_actions)
        self.log_std = torch.nn.Parameter(torch.zeros(self.num_actions))

    def compute(self, inputs, role):
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    def __init__(self, env):
        Model.__init__(self, observation_space=env.seen, action_space=env.acts, device="cpu")
        DeterministicMixin.__init__(self)
        self.net = layers(self.num_observations, 1)

    def compute(self, inputs, role):
        return self.net(inputs["observations"]), {}


set_seed(0)
torch.set_num_threads(1)
robots = Robots(vector.training_env(SCENARIO, given.num_envs))
actor = Actor(robots)
settings = {"rollouts": HORIZON, "learning_epochs": 4, "mini_batches": 8, "discount_factor": 0.97}
learner = PPO(
    models={"policy": actor, "value": Critic(robots)},
    memory=RandomMemory(memory_size=HORIZON, num_envs=robots.num_envs, device="cpu"),
    observation_space=robots.seen,
    action_space=robots.acts,
    device="cpu",
    cfg=settings | {"experiment": {"write_interval": 0, "checkpoint_interval": 0}},
)


def random_steps():
    robots.step(torch.rand(robots.num_envs, 2) * 2 - 1)
    return robots.num_envs


@torch.no_grad()
def policy(seen):
    return actor.net(torch.from_numpy(seen)).clamp(-1, 1).numpy()


def train():
    quiet = {"timesteps": given.steps, "headless": True, "disable_progressbar": True}
    SequentialTrainer(env=robots, agents=learner, cfg=quiet).train()
    return given.steps * robots.num_envs


robots.reset()
measure(random_steps, train, policy, given.episodes)
