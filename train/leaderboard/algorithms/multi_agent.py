"""BenchMARL algorithms in the environments of ``ppo``, with the same network size and budget.

IPPO: independent PPO with a local critic (de Witt et al. 2020). MAPPO: PPO with a centralised
critic (Yu et al. 2022). MASAC: soft actor-critic over discrete angles. QMIX: the team value is a
monotonic function of the robots' values (Rashid et al. 2018).
"""

import io
import logging
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.scenario.scenario import Scenario

from ..environments import can_learn, filter_arguments, make_training_envs, without_base_controller
from ..playing import EvaluationSetup
from ..registry import Algorithm, Budget

_PPO = {"lmbda": 0.95, "entropy_coef": 0.003}
LEARNERS: dict[str, dict[str, Any]] = {"Ippo": _PPO, "Mappo": _PPO, "Masac": {}, "Qmix": {}}
"""BenchMARL algorithms and the settings that differ from their defaults."""
STEPS = {"on": 16, "off": 4}
"""Decisions of an environment between updates, on and off policy."""
_EXPERIMENT: dict[str, Any] = {
    "prefer_continuous_actions": False, "gamma": 0.99, "lr": 1e-3, "evaluation": False,
    "evaluation_episodes": 1, "render": False, "loggers": [], "create_json": False,
    "on_policy_n_minibatch_iters": 5, "off_policy_n_optimizer_steps": 40,
    "off_policy_train_batch_size": 128, "off_policy_memory_size": 100_000,
}  # fmt: skip
"""Entries of BenchMARL's ExperimentConfig: as ``ppo.SETTINGS``; off policy its default ratio of
1,000 batches of 128 to 6,000 decisions of an environment."""


def learn(
    field: Scenario, seed: int, budget: Budget, *, name: str, safety: str
) -> tuple[Callable[[int], EvaluationSetup], dict[str, Any]]:
    """Train one of ``LEARNERS``, see ``Algorithm.learn``.

    ``safety`` is that of ``make_training_envs``; under "none" a first contact has no cost.
    """
    import torch
    from benchmarl import algorithms
    from benchmarl.experiment import Experiment
    from benchmarl.models import MlpConfig
    from tensordict import TensorDict
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    logging.getLogger("torchrl").setLevel(logging.WARNING)
    torch.set_num_threads(1)  # a run is bitwise reproducible, and independent of other cores
    algorithm = getattr(algorithms, f"{name}Config").get_from_yaml()
    vars(algorithm).update(LEARNERS[name])
    network = MlpConfig.get_from_yaml()
    network.num_cells = [64, 64]
    with tempfile.TemporaryDirectory() as folder, redirect_stderr(io.StringIO()):
        config = _experiment(field.n_robots, budget, algorithm.on_policy(), Path(folder))
        apart = seed * 2**10  # seeds of environments follow that of their experiment
        run = Experiment(task_of(field, safety), algorithm, network, apart, config)
        run.run()

    def choose(seen: NDArray[np.float32], time: NDArray[np.float64]) -> NDArray[np.int64]:
        robots = TensorDict({"observation": torch.from_numpy(seen)}, seen.shape[:2])
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            told = run.policy(TensorDict({"robots": robots}, seen.shape[:1]))
        chosen: NDArray[np.int64] = told["robots", "action"].numpy()
        return chosen

    told = asdict(config) | {"save_folder": None, "net_arch": network.num_cells}
    told |= {"algorithm": name, **asdict(algorithm), "num_envs": budget.num_envs}
    how = {"safety": safety, "anew": False, **_price(safety)}
    return (lambda n: EvaluationSetup(make_training_envs(field, n, **how), choose)), told


def task_of(field: Scenario, safety: str) -> Any:
    """Environments of ``make_training_envs`` as a BenchMARL task."""
    from rendezvous_env.adapters.benchmarl import RendezvousTask

    config = {
        "scenario": field,
        "num_threads": 1,
        **filter_arguments(field, safety),
        **_price(safety),
    }
    return RendezvousTask(
        field.name, config | ({"wrap": without_base_controller} if safety == "none" else {})
    )


def _price(safety: str) -> dict[str, Any]:
    return {"contact_penalty": 0.0} if safety == "none" else {}


def _experiment(n_robots: int, budget: Budget, on_policy: bool, folder: Path) -> Any:
    """BenchMARL settings. It counts decisions of environments, the leaderboard those of robots."""
    from benchmarl.experiment import ExperimentConfig

    config = ExperimentConfig.get_from_yaml()
    kind = "on" if on_policy else "off"
    frames = budget.num_envs * STEPS[kind]
    vars(config).update(
        _EXPERIMENT,
        save_folder=folder,
        max_n_frames=None,
        max_n_iters=-(-budget.decisions // (n_robots * frames)),
        exploration_anneal_frames=max(1, budget.decisions // (2 * n_robots)),
        on_policy_minibatch_size=max(1, 1024 // n_robots),
        **{f"{kind}_policy_collected_frames_per_batch": frames},
        **{f"{kind}_policy_n_envs_per_worker": budget.num_envs},
    )
    return config


def _algorithm(name: str, safety: Literal["none", "heading"]) -> Algorithm:
    manner = {
        "none": "with the team reward only",
        "heading": "under certified headings; a first contact costs 1",
    }
    return Algorithm(
        f"{name.upper()} of BenchMARL {manner[safety]}",
        safety,
        safety,
        "bearings",
        partial(learn, name=name, safety=safety),
        can_learn,
        packages=("torch", "torchrl", "tensordict", "benchmarl"),
    )


ALGORITHMS = {
    f"{name.lower()}-{safety}": _algorithm(name, safety)
    for name in LEARNERS
    for safety in ("none", "heading")
}
