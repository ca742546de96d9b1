"""What ``rendezvous bench`` times of the learner's side: policies, adapters, PPO."""

from __future__ import annotations

import importlib.util
import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.learned import checkpoints, shipped
from rendezvous_env.baselines.learned.learned_policy import LearnedPolicy

import rendezvous_env as rv
from rendezvous_env import baselines
from rendezvous_env.vector import training_env

from .cases import Case, Running, Size, spread_out, stepping, tape_of

TICKS = "robot ticks"
"""Robots times base steps; most steps decide nothing, but guide and certify."""
_BARE: dict[str, Any] = {"guarantee": None, "learning_preset": False}
"""Choices of ``training_env`` under which it does what ``make_vec`` does."""
_TRAINING = "clutter-8"
_STEPS, _BATCH, _EPOCHS = 64, 8192, 4


def installed(module: str) -> bool:
    """Whether a library of that name can be imported; a mere folder of that name is none."""
    found = importlib.util.find_spec(module)
    return found is not None and found.origin is not None


# ---- learned policies ---------------------------------------------------------------------------


class TorchChooser:
    """What ``NumpyActor`` does, by the network that was trained.

    Args:
        name: of a shipped policy without a recurrent memory.
        policy: which chooses by it.
    """

    def __init__(self, name: str, policy: LearnedPolicy) -> None:
        from ..learn.checkpoint import tensors
        from ..learn.networks import make_network

        settings, rows = policy.settings, policy.scenario.observation_layout
        layout = settings.layout(rows.neighbour_slots, rows.obstacle_slots)
        sizes: dict[str, Any] = {"set_width": settings.set_width, "hidden": settings.hidden}
        self.network = make_network(layout, len(settings.angles), **sizes)
        _, tables = checkpoints.read(shipped.folder(name), ["network"])
        self.network.load_state_dict(tensors(tables["network"]))

    def choose(self, shown: NDArray[np.float32], hidden: Any = None) -> NDArray[np.int64]:
        """The likeliest choices (N,) for rows (N, size)."""
        import torch

        with torch.no_grad():
            chosen = self.network._predict(torch.as_tensor(shown), deterministic=True)
        return np.asarray(chosen)


def learned(num_envs: int) -> list[Case]:
    """Ticks of the policy ``learned`` on what four robots see among discs at their starts."""
    scenario = rv.scenarios.get("clutter-8")
    seen = rv.Simulator(scenario, num_envs).reset(0)

    def build(torch: bool) -> Running:
        policy = baselines.make("learned", scenario)
        assert isinstance(policy, LearnedPolicy)
        if torch:
            policy._chooser = TorchChooser("learned", policy)
        return Running(lambda: policy(seen, 0.0))

    n = scenario.n_robots
    size = ("learned", n, num_envs, num_envs * n, TICKS)
    numpy = Case("learned, NumPy", *size, partial(build, False), "learned, torch")
    if not installed("stable_baselines3"):
        return [numpy]
    return [numpy, Case("learned, torch", *size, partial(build, True))]


# ---- adapters -----------------------------------------------------------------------------------


def adapters(robots: tuple[int, ...], size: Size) -> Iterator[list[Case]]:
    """Each learner's environment over ours: bare, where robots learn, and with all of training."""
    for n in robots:
        yield _over("make_vec", spread_out(n), size, _BARE)
    scenario = rv.scenarios.get(_TRAINING)
    yield _over(f"make_vec of {_TRAINING}", scenario, size, _BARE)
    yield _over("training_env", scenario, size, {})


def _over(ours: str, scenario: rv.Scenario, size: Size, choices: dict[str, Any]) -> list[Case]:
    own = ("adapters", scenario.n_robots, size.num_envs, size.num_envs, "team steps")

    def build() -> Running:
        make: Any = rv.make_vec if choices else training_env
        env = make(scenario, size.num_envs, num_threads=size.num_threads)
        return Running(stepping(env).step)  # teams of clutter-8 meet and begin anew

    return [Case(ours, *own, build)] + [
        Case(f"{name} over {ours}", *own, partial(make, scenario, size, choices), ours)
        for name, (module, make) in LEARNERS.items()
        if installed(module)
    ]


def _torchrl(scenario: rv.Scenario, size: Size, choices: dict[str, Any]) -> Running:
    """What ``rollout`` and collectors do with each step, without a policy and without storing."""
    import torch

    from rendezvous_env.adapters.torchrl import GROUP, RendezvousEnv

    env = RendezvousEnv(scenario, size.num_envs, num_threads=size.num_threads, seed=0, **choices)
    given = tape_of(env.teams.single_action_space, size.num_envs)
    tape = itertools.cycle([torch.from_numpy(next(given)) for _ in range(8)])
    now = [env.reset()]

    def step() -> None:
        now[0].set((GROUP, "action"), next(tape))
        now[0] = env.step_and_maybe_reset(now[0])[1]

    return Running(step)


def _pufferlib(scenario: rv.Scenario, size: Size, choices: dict[str, Any]) -> Running:
    from rendezvous_env.adapters.pufferlib import make

    env = make(scenario, size.num_envs, num_threads=size.num_threads, seed=0, **choices)
    env.reset()
    given = tape_of(env.slots.teams.single_action_space, size.num_envs)
    tape = itertools.cycle([next(given).reshape(env.actions.shape) for _ in range(8)])
    return Running(lambda: env.step(next(tape)))


LEARNERS: dict[str, tuple[str, Callable[..., Running]]] = {
    "TorchRL": ("torchrl", _torchrl),
    "PufferLib": ("pufferlib", _pufferlib),
}
"""Libraries whose adapters are timed where they are installed: module, and what steps."""


# ---- stable-baselines3 --------------------------------------------------------------------------


def ppo_groups(
    wanted: tuple[str, ...], robots: tuple[int, ...], size: Size
) -> Iterator[list[Case]]:
    """Steps of the VecEnv, and PPO beside the same PPO on robots that cost nothing."""
    for n in robots if "robots" in wanted else ():
        yield [_vec_env(n, size)]
    for n in robots if "ppo" in wanted else ():
        yield _ppo(n, size)
    if "heading-ppo" in wanted:
        yield _heading_ppo(size)


def _free(teams: Any) -> Any:
    """Robots whose steps cost nothing: always the same arrays."""
    from rendezvous_env.adapters.sb3 import RobotVecEnv

    class FreeRobots(RobotVecEnv):
        """As ``_free`` says."""

        def reset(self) -> NDArray[np.float32]:
            """What robots see, which is the answer to every step as well."""
            seen, slots = super().reset(), self.num_envs
            infos: list[dict[str, Any]] = [{} for _ in range(slots)]
            self._answer = (seen, np.zeros(slots, np.float32), np.zeros(slots, np.bool_), infos)
            return seen

        def step_async(self, actions: NDArray[np.float32]) -> None:
            """Nothing."""

        def step_wait(self) -> Any:
            """The same answer."""
            return self._answer

    return FreeRobots(teams)


def _robots(n: int, size: Size) -> Any:
    from rendezvous_env.adapters.sb3 import make_robots

    return make_robots(spread_out(n), size.num_envs // n, num_threads=size.num_threads)


def _vec_env(n: int, size: Size) -> Case:
    def build() -> Running:
        env = _robots(n, size)
        env.reset()
        tape = tape_of(env.action_space, env.num_envs)
        return Running(lambda: env.step(next(tape)), lambda: bool(env.simulator.active.all()))

    teams = size.num_envs // n
    return Case("SB3 VecEnv", "robots", n, teams, teams * n, "robot steps", build)


def _ppo(n: int, size: Size) -> list[Case]:
    teams = size.num_envs // n
    samples = _STEPS * teams * n

    def build(free: bool) -> Running:
        from ..learn.rollout_buffer import RobotPPO

        env = _robots(n, size)
        model = RobotPPO(
            "MlpPolicy",
            _free(env.teams) if free else env,
            n_steps=_STEPS,
            batch_size=min(_BATCH, samples),
            n_epochs=_EPOCHS,
            seed=0,
            device="cpu",
        )
        learn = partial(model.learn, samples, reset_num_timesteps=False)
        return Running(learn, lambda: bool(env.simulator.active.all()))

    return _beside_free("PPO", ("ppo", n, teams, samples, "samples"), build)


def _heading_ppo(size: Size) -> list[Case]:
    """What ``rendezvous train`` does; the environment is all that is no network."""
    from ..learn.settings import Config

    n = 4
    config = Config(num_teams=size.num_envs // n, num_threads=size.num_threads)
    samples = config.samples_per_update

    def build(free: bool) -> Running:
        from ..learn.trainer import Trainer

        trainer = Trainer(config)
        if free:
            trainer.model.set_env(_free(trainer.robots.teams))
        options = {"log_interval": None, "reset_num_timesteps": False}
        return Running(partial(trainer.model.learn, samples, **options))

    own = ("heading-ppo", n, config.num_teams, samples, "samples")
    return _beside_free("Heading PPO", own, build)


def _beside_free(
    name: str, size: tuple[str, int, int, int, str], build: Callable[[bool], Running]
) -> list[Case]:
    return [
        Case(f"{name}, free environment", *size, partial(build, True)),
        Case(f"{name}, end to end", *size, partial(build, False), f"{name}, free"),
    ]
