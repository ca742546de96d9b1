"""What ``rendezvous bench`` times of the learner's side; needs the ``train`` extra."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.adapters.sb3 import RobotVecEnv, make_robots

from ..learning.rollout_buffer import RobotPPO
from ..learning.settings import Config
from ..learning.training import Training
from .bench_cases import Case, Running, spread_out

_STEPS, _BATCH, _EPOCHS = 64, 8192, 4


class FreeRobots(RobotVecEnv):
    """Robots whose steps cost nothing: always the same arrays."""

    def reset(self) -> NDArray[np.float32]:
        """Begin in truth, so that shapes and numbers are real ones."""
        observations = super().reset()
        slots = self.num_envs
        infos: list[dict[str, Any]] = [{} for _ in range(slots)]
        zeros = np.zeros(slots, np.float32), np.zeros(slots, np.bool_)
        self._answer = (observations, *zeros, infos)
        return observations

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Ignore the actions."""

    def step_wait(self) -> Any:
        """The same answer again."""
        return self._answer


def robots(n: int, slots: int, num_threads: int | None) -> list[Case]:
    """Steps of the stable-baselines3 VecEnv without a policy."""
    teams = slots // n

    def build() -> Running:
        env = make_robots(spread_out(n), teams, num_threads=num_threads)
        env.reset()
        random = np.random.default_rng(0)
        shape = (8, env.num_envs, *env.action_space.shape)
        tape = itertools.cycle(random.uniform(-1, 1, shape).astype(np.float32))
        return Running(lambda: env.step(next(tape)), lambda: bool(env.simulator.active.all()))

    return [Case("SB3 VecEnv", "robots", n, teams, teams * n, "robot steps", build)]


def ppo(n: int, slots: int, num_threads: int | None) -> list[Case]:
    """PPO with collection and update, beside the same PPO on robots that cost nothing."""
    teams = slots // n
    samples = _STEPS * teams * n

    def build(free: bool) -> Running:
        env = make_robots(spread_out(n), teams, num_threads=num_threads)
        env = FreeRobots(env.teams) if free else env
        model = RobotPPO(
            "MlpPolicy",
            env,
            n_steps=_STEPS,
            batch_size=min(_BATCH, samples),
            n_epochs=_EPOCHS,
            seed=0,
            device="cpu",
        )
        return Running(
            lambda: model.learn(samples, reset_num_timesteps=False),
            lambda: bool(env.simulator.active.all()),
        )

    size = ("ppo", n, teams, samples, "samples")
    return [
        Case("PPO, free environment", *size, lambda: build(free=True)),
        Case("PPO, end to end", *size, lambda: build(free=False), "PPO, free"),
    ]


def heading_ppo(slots: int, num_threads: int | None) -> list[Case]:
    """What ``rendezvous train`` does, beside the same on robots that cost nothing.

    The environment is all that is no network: clutter, certified headings, perception.
    """
    n = 4
    config = Config(num_teams=slots // n, num_threads=num_threads)
    samples = config.samples_per_update

    def build(free: bool) -> Running:
        training = Training(config)
        model = training.model
        if free:
            model.set_env(FreeRobots(training.robots.teams))
        learn = lambda: model.learn(samples, log_interval=None, reset_num_timesteps=False)  # noqa: E731
        return Running(learn, lambda: True)

    size = ("heading-ppo", n, config.num_teams, samples, "samples")
    return [
        Case("Heading PPO, free environment", *size, lambda: build(free=True)),
        Case("Heading PPO, end to end", *size, lambda: build(free=False), "Heading PPO, free"),
    ]
