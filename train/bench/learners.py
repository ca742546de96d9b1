"""Benchmark cases of learning libraries: adapters and PPO."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

import rendezvous_env as rv
from rendezvous_env.vector import training_env

from ..checks import installed
from .cases import Case, Running, Size, in_turns, spread_out, stepping, tape_of

_BARE: dict[str, Any] = {"guarantee": None, "learning_preset": False}
"""Arguments with which ``training_env`` is equivalent to ``make_vec``."""
_TRAINING = "clutter-8"


def adapters(robots: tuple[int, ...], size: Size) -> Iterator[list[Case]]:
    """Cases of each learner: bare environment, training environment, full training."""
    for n in robots:
        yield _over("make_vec", spread_out(n), size, _BARE)
    scenario = rv.scenarios.get(_TRAINING)
    yield _over(f"make_vec of {_TRAINING}", scenario, size, _BARE)
    yield _over("training_env", scenario, size, {})


def _over(ours: str, scenario: rv.Scenario, size: Size, choices: dict[str, Any]) -> list[Case]:
    def build() -> Running:
        make: Any = rv.make_vec if choices else training_env
        env = make(scenario, size.num_envs, num_threads=size.num_threads)
        return Running(stepping(env).step)  # environments of clutter-8 meet and are reset

    builds = {ours: build} | {
        f"{name} over {ours}": partial(make, scenario, size, choices)
        for name, (module, make) in _LEARNERS.items()
        if installed(module)
    }
    return in_turns("adapters", scenario.n_robots, size.num_envs, builds)


def _torchrl(scenario: rv.Scenario, size: Size, choices: dict[str, Any]) -> Running:
    """A TorchRL step as in ``rollout`` and collectors, without policy and storage."""
    import torch

    from rendezvous_env.adapters.torchrl import GROUP, RendezvousTorchRLEnv

    env = RendezvousTorchRLEnv(
        scenario, size.num_envs, num_threads=size.num_threads, seed=0, **choices
    )
    tape, now = tape_of(env.vector_env.single_action_space, size.num_envs), [env.reset()]

    def step() -> None:
        now[0].set((GROUP, "action"), torch.from_numpy(next(tape)))
        now[0] = env.step_and_maybe_reset(now[0])[1]

    return Running(step)


def _sb3(scenario: rv.Scenario, size: Size, choices: dict[str, Any]) -> Running:
    from rendezvous_env.adapters.sb3 import RobotVecEnv

    env = RobotVecEnv(
        training_env(scenario, size.num_envs, num_threads=size.num_threads, **choices)
    )
    env.reset()
    tape = tape_of(env.action_space, env.num_envs)
    return Running(lambda: env.step(next(tape)))


def _pufferlib(scenario: rv.Scenario, size: Size, choices: dict[str, Any]) -> Running:
    from rendezvous_env.adapters.pufferlib import make

    env = make(scenario, size.num_envs, num_threads=size.num_threads, seed=0, **choices)
    env.reset()
    tape = tape_of(env.slots.vector_env.single_action_space, size.num_envs)
    return Running(lambda: env.step(next(tape).reshape(env.actions.shape)))


_LEARNERS: dict[str, tuple[str, Callable[..., Running]]] = {
    "stable-baselines3": ("stable_baselines3", _sb3),
    "TorchRL": ("torchrl", _torchrl),
    "PufferLib": ("pufferlib", _pufferlib),
}
"""Libraries whose adapters are timed if installed: module name and case."""


def heading_ppo(size: Size) -> list[Case]:
    """``rendezvous train``, relative to a zero-cost environment and to stable-baselines3's PPO."""
    from stable_baselines3.common.logger import Logger

    from ..learn.settings import Config

    n = 4
    config = Config(num_envs=max(1, size.num_envs // n), num_threads=size.num_threads)
    samples = config.samples_per_update

    def build(free: bool) -> Running:
        from ..learn.trainer import Trainer

        trainer = Trainer(config)
        if free:
            trainer.model.set_env(_free(trainer.robots.vector_env))
        return learning(trainer.model)

    def build_theirs() -> Running:
        from stable_baselines3 import PPO

        from ..learn.environments import make_environments
        from ..learn.trainer import SAME_NAME

        alike = {name: getattr(config, name) for name in SAME_NAME}
        alike |= {"batch_size": min(config.batch_size, samples), "n_epochs": config.epochs}
        return learning(PPO("MlpPolicy", _free(make_environments(config, 0)), **alike))

    def learning(model: Any) -> Running:
        model.set_logger(Logger(None, []))
        options = {"log_interval": None, "reset_num_timesteps": False}
        return Running(partial(model.learn, samples, **options))

    own, free = ("heading-ppo", n, config.num_envs, samples, "samples"), "free environment"
    return [
        Case("MlpPolicy", *own, build_theirs),
        Case(free, *own, partial(build, True), "MlpPolicy"),
        Case("end to end", *own, partial(build, False), free),
    ]


def _free(teams: Any) -> Any:
    """Zero-cost environment with constant observations."""
    from rendezvous_env.adapters.sb3 import RobotVecEnv

    robots: Any = RobotVecEnv(teams)
    seen = robots.reset()
    nothing = np.zeros(len(seen), np.float32), np.zeros(len(seen), np.bool_)
    answer: Any = seen, *nothing, [{} for _ in seen]
    robots.step_async, robots.step_wait = lambda actions: None, lambda: answer
    return robots
