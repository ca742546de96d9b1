"""BenchMARL: scenarios as tasks, and evaluation on held-out starts."""

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

from .torchrl import GROUP, RendezvousEnv

__all__ = ["Evaluation", "HeldOut", "RendezvousTask"]


class RendezvousTask(TaskClass):
    """A scenario as a task: all robots are one group, "robots", and share the team's reward.

        Experiment(RendezvousTask("clutter-8", {"guarantee": "tank"}), MappoConfig..., ...)

    Continuous actions (MAPPO, IPPO, MASAC) and discrete ones (QMIX, VDN): choices of a direction,
    see ``vector.training_env``. With "return_state" centralised critics get the global state
    instead of all observations.

    Args:
        name: name of the scenario, or of the task if the config names a "scenario".
        config: arguments of ``adapters.torchrl.RendezvousEnv``; a ValueError for those that
            BenchMARL decides: num_envs, discrete, seed and device.
    """

    def __init__(self, name: str, config: dict[str, Any] | None = None) -> None:
        if decided := {"num_envs", "discrete", "seed", "device"} & set(config or ()):
            raise ValueError(
                f"config has {sorted(decided)[0]!r}, which the ExperimentConfig and the algorithm "
                "decide; leave it out"
            )
        super().__init__(name, config)

    def make(self, num_envs: int, **decided: Any) -> RendezvousEnv:
        """The task's environment, with the arguments that BenchMARL or an evaluation decides."""
        return RendezvousEnv(**{"scenario": self.name, **self.config}, num_envs=num_envs, **decided)

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """A function that makes an environment of this task."""
        task = type(self)(self.name, dict(self.config))
        decided = {"discrete": not continuous_actions, "seed": seed, "device": device}
        return lambda: task.make(num_envs, **decided)

    def supports_continuous_actions(self) -> bool:
        """Always."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Whether these robots can choose among directions."""
        try:
            self.make(1, discrete=True).close()
        except ValueError:
            return False
        return True

    def max_steps(self, env: EnvBase) -> int:
        """Most steps of an episode."""
        return int(env.max_steps)

    def has_render(self, env: EnvBase) -> bool:
        """Not here; ``rendezvous render`` draws what policies do."""
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """The one group and its robots."""
        return dict(env.group_map)

    def observation_spec(self, env: EnvBase) -> Composite:
        """Inputs of the robots' networks."""
        sees = env.full_observation_spec_unbatched[GROUP, "observation"].clone()
        return _of_group(env, observation=sees)

    def info_spec(self, env: EnvBase) -> Composite | None:
        """Costs of the robots in a step, with ``Scenario.costs``; else there are no infos."""
        spec = env.full_observation_spec_unbatched[GROUP]
        return _of_group(env, info=spec["info"].clone()) if "info" in spec.keys() else None

    def state_spec(self, env: EnvBase) -> Composite | None:
        """The global state, if the config asks for it."""
        spec = env.full_observation_spec_unbatched
        return Composite({"state": spec["state"].clone()}) if "state" in spec.keys() else None

    def action_spec(self, env: EnvBase) -> Composite:
        """Actions of the robots."""
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: EnvBase) -> None:
        """None: robots that are gone take actions too, which do nothing."""

    @staticmethod
    def env_name() -> str:
        """The name of all tasks of this kind."""
        return "rendezvous"

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        """Share of the episodes of a batch that ended with all robots met."""
        done = batch["next", "done"]
        if not done.any():
            return {}
        return {"collection/met": batch["next", "terminated"][done].float().mean().item()}


def _of_group(env: EnvBase, **entries: Any) -> Composite:
    return Composite({GROUP: Composite(entries, shape=(len(env.group_map[GROUP]),))})


@dataclass(frozen=True)
class Evaluation:
    """How held-out episodes went: ``frames``, team steps collected before it; the shares of teams
    that ``met`` and that met without a contact (``clean``); and the ``median_time``, s, of all
    teams, where one that did not meet took longer than any.
    """

    frames: int
    met: float
    clean: float
    median_time: float


class HeldOut(Callback):
    """Evaluates on the same starts every time, from ``seed`` on, apart from those of training.

    BenchMARL seeds the environments of training and of evaluation alike, so that both begin with
    the same starts. Leave ``evaluation_static`` False, which would bring that back.
    """

    def __init__(self, seed: int = 1_000_000) -> None:
        super().__init__()
        self.seed = seed
        self.evaluations: list[Evaluation] = []

    def on_setup(self) -> None:
        """Seed the evaluation."""
        self.experiment.test_env.set_seed(self.seed)

    def on_evaluation_end(self, rollouts: Sequence[TensorDictBase]) -> None:
        """Keep and log how the first episode of each team went, and go back to their starts."""
        experiment = self.experiment
        period = experiment.test_env.seconds_per_step
        times, clean = zip(*(_meeting(each, period) for each in rollouts), strict=True)
        met, cleanly = (sum(which) / len(times) for which in (map(isfinite, times), clean))
        found = Evaluation(experiment.total_frames, met, cleanly, statistics.median(times))
        self.evaluations.append(found)
        told = {f"eval/{key}": getattr(found, key) for key in ("met", "clean", "median_time")}
        experiment.logger.log(told, step=experiment.n_iters_performed)
        experiment.test_env.set_seed(self.seed)


def _meeting(rollout: TensorDictBase, period: float) -> tuple[float, bool]:
    """When the robots of the first episode of a team met, s, and whether they touched nothing on
    the way; inf and False if they did not meet.
    """
    last = int(rollout["next", "done"].flatten().int().argmax())
    met = bool(rollout["next", "terminated"].flatten()[last])
    clean = met and int(rollout["next", "contacts"].flatten()[last]) == 0
    return (last + 1) * period if met else float("inf"), clean
