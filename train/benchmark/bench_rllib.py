"""What ``rendezvous bench`` times of RLlib: sampling by its adapter, over its PettingZoo door.

Both carry the same set network in the same training environment; a step collects a rollout.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import rendezvous_env as rv

from .bench_adapters import TRAINING, is_installed
from .bench_cases import Case, Running

ROLLOUT = 4
"""Decisions of every robot that one sample collects."""

MOST_TEAMS = 64
"""The door steps them one by one."""


def rllib_in_training(num_envs: int, num_threads: int | None) -> Iterator[list[Case]]:
    """Samples of RLlib's runners, where it is installed: its PettingZoo door, and the adapter."""
    if is_installed("dm-tree"):  # which ray[rllib] brings, and ray alone does not
        scenario, num_envs = rv.scenarios.get(TRAINING), min(num_envs, MOST_TEAMS)
        n = scenario.n_robots
        size = ("adapters", n, num_envs, num_envs * n * ROLLOUT, "robot steps")
        door = "RLlib's PettingZoo door"
        yield [
            Case(door, *size, lambda: _door(scenario, num_envs)),
            Case("RLlib", *size, lambda: _adapter(scenario, num_envs, num_threads), door),
        ]


def _adapter(scenario: rv.Scenario, num_envs: int, num_threads: int | None) -> Running:
    from ray.rllib.algorithms.ppo import PPOConfig

    from rendezvous_env.adapters import rllib

    config = rllib.configure(PPOConfig(), scenario, num_teams=num_envs, num_threads=num_threads)
    runner = rllib.RobotEnvRunner(config=_alone(config), worker_index=0)
    return _sampling(runner, num_envs * scenario.n_robots * ROLLOUT)


def _door(scenario: rv.Scenario, num_envs: int) -> Running:
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec
    from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env

    from rendezvous_env.adapters.rllib_module import SetModule, sets_of

    sets = sets_of(rv.training_env(scenario).teams.layout)
    spec = RLModuleSpec(module_class=SetModule, model_config={"sets": sets, "units": 64})
    register_env("rendezvous door", lambda _: ParallelPettingZooEnv(rv.training_env(scenario)))
    config = (
        PPOConfig()
        .environment("rendezvous door")
        .env_runners(num_envs_per_env_runner=num_envs)
        .multi_agent(policies={"robot"}, policy_mapping_fn=lambda *_, **__: "robot")
        .rl_module(rl_module_spec=MultiRLModuleSpec(rl_module_specs={"robot": spec}))
    )
    return _sampling(MultiAgentEnvRunner(_alone(config), worker_index=0), num_envs * ROLLOUT)


def _alone(config: Any) -> Any:
    """Runs in this process."""
    return config.env_runners(num_env_runners=0).debugging(seed=0)


def _sampling(runner: Any, num_timesteps: int) -> Running:
    """Takes samples; a runner of single robots counts their steps, one of teams those of teams."""
    return Running(lambda: runner.sample(num_timesteps=num_timesteps), lambda: True)
