"""BenchMARL: scenarios as tasks, and evaluation on held-out initial conditions."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from benchmarl.environments import TaskClass
from benchmarl.experiment import Callback
from tensordict import TensorDictBase
from torchrl.data import Composite
from torchrl.envs import EnvBase

from ..deprecation import renamed_attribute
from .torchrl import GROUP, RendezvousTorchRLEnv

__all__ = ["Evaluation", "HeldOut", "RendezvousTask"]


class RendezvousTask(TaskClass):
    """Scenario as a BenchMARL task with one group, "robots", and a shared team reward.

        Experiment(RendezvousTask("clutter-8", {"guarantee": "tank"}), MappoConfig..., ...)

    Supports continuous actions (MAPPO, IPPO, MASAC) and discrete actions (QMIX, VDN), which select
    a direction; see ``vector.training_env``. With "return_state", centralised critics receive the
    global state instead of all observations.

    Args:
        name: name of the scenario, or of the task if the config has the key "scenario".
        config: arguments of ``RendezvousTorchRLEnv``. ValueError for arguments set by
            BenchMARL: num_envs, discrete, seed and device.
    """

    def __init__(self, name: str, config: dict[str, Any] | None = None) -> None:
        if decided := {"num_envs", "discrete", "seed", "device"} & set(config or ()):
            raise ValueError(
                f"config has {sorted(decided)[0]!r}, which the ExperimentConfig and the algorithm "
                "set; omit it"
            )
        super().__init__(name, config)

    def make(self, num_envs: int, **decided: Any) -> RendezvousTorchRLEnv:
        """Create the environment with the arguments set by BenchMARL or an evaluation."""
        return RendezvousTorchRLEnv(
            **{"scenario": self.name, **self.config}, num_envs=num_envs, **decided
        )

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Return a function that creates an environment of this task."""
        task = type(self)(self.name, dict(self.config))
        decided = {"discrete": not continuous_actions, "seed": seed, "device": device}
        return lambda: task.make(num_envs, **decided)

    def supports_continuous_actions(self) -> bool:
        """True."""
        return True

    def supports_discrete_actions(self) -> bool:
        """True if the robots support discrete directions."""
        try:
            self.make(1, discrete=True).close()
        except ValueError:
            return False
        return True

    def max_steps(self, env: EnvBase) -> int:
        """Maximum number of steps of an episode."""
        return int(env.max_steps)

    def has_render(self, env: EnvBase) -> bool:
        """False; use ``rendezvous render`` instead."""
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """The single group and its robots."""
        return dict(env.group_map)

    def observation_spec(self, env: EnvBase) -> Composite:
        """Spec of the robots' observations."""
        sees = env.full_observation_spec_unbatched[GROUP, "observation"].clone()
        return _of_group(env, observation=sees)

    def info_spec(self, env: EnvBase) -> Composite | None:
        """Spec of the costs and conditions of robots, if the scenario has any, else None."""
        spec = env.full_observation_spec_unbatched[GROUP]
        return _of_group(env, info=spec["info"].clone()) if "info" in spec.keys() else None

    def state_spec(self, env: EnvBase) -> Composite | None:
        """Spec of the global state, if the config requests it."""
        spec = env.full_observation_spec_unbatched
        return Composite({"state": spec["state"].clone()}) if "state" in spec.keys() else None

    def action_spec(self, env: EnvBase) -> Composite:
        """Spec of the robots' actions."""
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: EnvBase) -> None:
        """None: inactive robots also have actions, which have no effect."""

    @staticmethod
    def env_name() -> str:
        """Name shared by all tasks of this class."""
        return "rendezvous"

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        """Fraction of the ended episodes of a batch with rendezvous."""
        done = batch["next", "done"]
        if not done.any():
            return {}
        return {"collection/met": batch["next", "terminated"][done].float().mean().item()}


def _of_group(env: EnvBase, **entries: Any) -> Composite:
    return Composite({GROUP: Composite(entries, shape=(len(env.group_map[GROUP]),))})


@dataclass(frozen=True)
class Evaluation:
    """Results of a held-out evaluation.

    ``frames`` is the number of environment steps collected before it. ``met`` is the fraction of
    environments with rendezvous, and ``collision_free`` with collision-free rendezvous.
    ``median_time``, s, is over all environments, with inf for those without rendezvous.
    """

    frames: int
    met: float
    collision_free: float
    median_time: float

    clean = renamed_attribute("clean", "collision_free")


class HeldOut(Callback):
    """Evaluation on fixed initial conditions from ``seed``, held out from training.

    BenchMARL seeds training and evaluation environments alike, so that both have the same initial
    conditions. Keep ``evaluation_static`` False; True would restore that behaviour.
    """

    def __init__(self, seed: int = 1_000_000) -> None:
        super().__init__()
        self.seed = seed
        self.evaluations: list[Evaluation] = []

    def on_setup(self) -> None:
        """Seed the evaluation."""
        self.experiment.test_env.set_seed(self.seed)

    def on_evaluation_end(self, rollouts: Sequence[TensorDictBase]) -> None:
        """Log the first episode of each environment; restore the initial conditions."""
        experiment = self.experiment
        period = experiment.test_env.seconds_per_step
        times, free = zip(*(_meeting(each, period) for each in rollouts), strict=True)
        met, share = (sum(which) / len(times) for which in (map(isfinite, times), free))
        found = Evaluation(experiment.total_frames, met, share, statistics.median(times))
        self.evaluations.append(found)
        names = ("met", "collision_free", "median_time")
        told = {f"eval/{name}": getattr(found, name) for name in names}
        experiment.logger.log(told, step=experiment.n_iters_performed)
        experiment.test_env.set_seed(self.seed)


def _meeting(rollout: TensorDictBase, period: float) -> tuple[float, bool]:
    """Rendezvous time of an environment's first episode, s, and whether it was collision-free.

    inf and False without rendezvous.
    """
    last = int(rollout["next", "done"].flatten().int().argmax())
    met = bool(rollout["next", "terminated"].flatten()[last])
    free = met and int(rollout["next", "contacts"].flatten()[last]) == 0
    return (last + 1) * period if met else float("inf"), free
