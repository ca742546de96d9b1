"""PPO with parameter sharing and one network for all safety filters."""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import numpy as np
from gymnasium.vector import VectorWrapper
from numpy.typing import NDArray

from rendezvous_env.scenario.scenario import Scenario

from ...learn.settings import TRAINING_SEEDS
from ..environments import can_learn, make_training_envs
from ..playing import EvaluationSetup
from ..registry import Algorithm, Budget

SETTINGS: dict[str, Any] = {
    "n_steps": 16, "batch_size": 1024, "n_epochs": 5, "learning_rate": 1e-3, "gamma": 0.99,
    "gae_lambda": 0.95, "ent_coef": 0.003, "policy_kwargs": {"net_arch": [64, 64]},
}  # fmt: skip
"""Settings of stable-baselines3's PPO, common to all filters."""
_RATE, _MOST = 2.0, 20.0
"""Step size of the Lagrange multiplier per contact above the limit, and its maximum."""


class Paid(VectorWrapper):
    """Environment whose reward is reduced by λ per contact, for a Lagrangian learner."""

    multiplier = 0.0

    def step(self, actions: Any) -> Any:
        """As the wrapped environment, minus the cost of contacts."""
        seen, _, ends, cuts, infos = self.env.step(actions)
        infos["robot_rewards"] = infos["robot_rewards"] - self.multiplier * infos["cost_contact"]
        return seen, infos["robot_rewards"].mean(axis=1), ends, cuts, infos


def learn(
    field: Scenario, seed: int, budget: Budget, *, limit: float | None = None, **safety: Any
) -> tuple[Callable[[int], EvaluationSetup], dict[str, Any]]:
    """Train in environments under the filter ``safety``, see ``Algorithm.learn``.

    ``limit`` is the maximum mean number of contacts per episode for a Lagrangian learner, whose
    multiplier changes after every rollout. None disables the Lagrangian.
    """
    import torch
    from stable_baselines3.common.logger import Logger

    from rendezvous_env.adapters.sb3 import RobotVecEnv

    from ...learn.rollout_buffer import RobotPPO

    torch.set_num_threads(1)  # a run is bitwise reproducible, and independent of other cores
    paid = Paid(make_training_envs(field, budget.num_envs, anew=True, **safety))
    robots = RobotVecEnv(paid)
    robots.seed(TRAINING_SEEDS + 2**32 * seed)
    rule = multiplier_of(paid, robots, limit) if limit is not None else None
    model = RobotPPO("MlpPolicy", robots, seed=seed, device="cpu", **SETTINGS)
    model.set_logger(Logger(None, []))  # otherwise it creates a temporary folder
    model.learn(budget.decisions, callback=rule)
    told = {key: value for key, value in safety.items() if not callable(value)}
    settings = {**SETTINGS, **told, "limit": limit, "num_envs": budget.num_envs}
    if limit is not None:
        settings["multiplier_at_the_end"] = paid.multiplier
    settings["wrap"] = getattr(safety.get("wrap"), "__name__", None)

    def choose(seen: NDArray[np.float32], time: NDArray[np.float64]) -> NDArray[np.int64]:
        actions, _ = model.predict(seen.reshape(-1, seen.shape[-1]), deterministic=True)
        chosen: NDArray[np.int64] = actions.reshape(seen.shape[:2])
        return chosen

    return (
        lambda n: EvaluationSetup(make_training_envs(field, n, anew=False, **safety), choose)
    ), settings


def multiplier_of(paid: Paid, robots: Any, limit: float) -> Any:
    """Callback that updates λ ← max(0, λ + η (J − limit)) after each rollout.

    J is the number of contacts per environment and episode of mean length.
    """
    from stable_baselines3.common.callbacks import BaseCallback

    class Multiplier(BaseCallback):
        touches, ended = 0.0, 0

        def _on_step(self) -> bool:
            self.touches += float(robots.costs["cost_contact"].sum())
            self.ended += sum("episode" in info for info in self.locals["infos"])
            return True

        def _on_rollout_end(self) -> None:
            if self.ended:
                excess = self.touches / self.ended - limit
                moved = paid.multiplier + _RATE * excess / SETTINGS["n_steps"]
                paid.multiplier = float(np.clip(moved, 0.0, _MOST))
                self.touches, self.ended = 0.0, 0

    return Multiplier()


def algorithm(
    about: str,
    word: str,
    safety: Literal["none", "rule", "heading", "tank"],
    given: str = "bearings",
    fits: Callable[[Scenario], bool] = can_learn,
    **how: Any,
) -> Algorithm:
    """This PPO as an ``Algorithm``; ``safety`` and ``how`` are passed to ``make_training_envs``."""
    proven: Literal["none", "heading", "tank"] = "none" if safety == "rule" else safety
    learned = partial(learn, safety=safety, **how)
    packages = ("torch", "stable-baselines3")
    return Algorithm(about, word, proven, given, learned, fits, packages=packages)


ALGORITHMS = {
    "ppo-none": algorithm("PPO with the team reward only", "none", "none", contact_penalty=0.0),
    "ppo-penalty": algorithm("PPO; a robot's first contact costs 1", "penalty", "none"),
    "ppo-lagrangian": algorithm(  # Ray, Achiam & Amodei 2019, with one critic
        "PPO-Lagrangian: contacts cost λ, which grows while an episode has more than 0.1 of them",
        "Lagrangian",
        "none",
        contact_penalty=0.0,
        limit=0.1,
    ),
    "ppo-rule": algorithm(
        "PPO over the merged-intervals rule, which avoids obstacles; a first contact costs 1",
        "rule",
        "rule",
    ),
    "ppo-heading": algorithm(
        "PPO under certified headings; a first contact costs 1", "heading", "heading"
    ),
    "ppo-tank": algorithm(
        "PPO under energy tanks of the shipped budget; a first contact costs 1", "tank", "tank"
    ),
}
