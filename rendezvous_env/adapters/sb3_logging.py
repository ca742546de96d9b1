"""stable-baselines3 logging of episodes, under the names of ``rendezvous train``."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter

from ..deprecation import RenamedKeys

_MEANS = ("contacts", "path_length")
_PARTS = ("cost", "reward_")
"""Prefixes of episode keys that are logged as means."""


_FORMER = {"clean_success": "collision_free_success"}
"""Names of the statistics by their former names."""


def episode_numbers(episodes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the logged statistics of ended episodes; NaN without episodes.

    Args:
        episodes: ``info["episode"]`` of each, see ``RobotVecEnv``.

    Returns:
        ``episodes``, their number. ``success`` and ``collision_free_success``, fractions.
        ``median_time``, s, NaN if fewer than half met. ``return``. Means of ``contacts``,
        ``path_length`` in m, each ``cost_NAME`` and each ``reward_NAME``.
    """
    if not episodes:
        names = ("success", "collision_free_success", "median_time", "return")
        return RenamedKeys({"episodes": 0, **dict.fromkeys(names, np.nan)}, _FORMER)
    success, contacts, times, earned = (
        np.array([episode[key] for episode in episodes])
        for key in ("success", "contacts", "time", "r")
    )
    median = np.median(np.where(success, times, np.inf))
    keys = dict.fromkeys(key for episode in episodes for key in episode)
    means = [key for key in keys if key in _MEANS or key.startswith(_PARTS)]
    numbers = {
        "episodes": len(episodes),
        "success": success.mean(),
        "collision_free_success": (success & (contacts == 0)).mean(),
        "median_time": median if np.isfinite(median) else np.nan,
        "return": earned.mean(),
        **{key: float(np.mean([one.get(key, 0.0) for one in episodes])) for key in means},
    }
    return RenamedKeys(numbers, _FORMER)


class EpisodeLog(BaseCallback):
    """Callback that logs collision-free success, time, contacts, costs and reward terms.

        model = PPO("MlpPolicy", robots, tensorboard_log="out/tensorboard")
        model.learn(200_000, callback=EpisodeLog())

    Each rollout logs the means of the episodes that ended in it, for example
    ``train/collision_free_success``; see ``episode_numbers``. Any output of the model's logger
    works: TensorBoard, CSV, the terminal, and Weights & Biases with ``WandbLog``. The environment
    must be a ``RobotVecEnv`` without ``VecMonitor``, which would keep only returns and lengths.

    Args:
        prefix: prefix of the names; ``rendezvous train`` uses "train".
    """

    def __init__(self, prefix: str = "train") -> None:
        super().__init__()
        self.prefix = prefix
        self._ended: list[dict[str, Any]] = []

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self._ended += [one["episode"] for one in infos if "success" in one.get("episode", ())]
        return True

    def _on_rollout_end(self) -> None:
        if self._ended:
            for name, value in episode_numbers(self._ended).items():
                self.logger.record(f"{self.prefix}/{name}", value)
            self._ended.clear()


class WandbLog(BaseCallback):
    """Callback that sends a model's logs to Weights & Biases, with the number of steps.

        model.learn(200_000, callback=[EpisodeLog(), WandbLog(project="rendezvous")])

    Args:
        arguments: arguments of ``wandb.init``.

    Raises:
        ImportError: at the start of learning, if wandb is not installed.
    """

    def __init__(self, **arguments: Any) -> None:
        super().__init__()
        self.arguments = arguments
        self.run: Any = None
        """wandb run, during learning."""

    def _on_training_start(self) -> None:
        try:
            wandb = import_module("wandb")
        except ImportError as error:
            raise ImportError("WandbLog needs wandb: pip install wandb", name="wandb") from error
        self.run = wandb.init(**self.arguments)
        self._writer = _WandbWriter(self.run)
        self.logger.output_formats.append(self._writer)

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self.logger.output_formats.remove(self._writer)
        self.run.finish()


class _WandbWriter(KVWriter):
    """Writer for stable-baselines3's logger that sends numbers to a wandb run."""

    def __init__(self, run: Any) -> None:
        self._run = run

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        """Send the numbers of a dump."""
        numbers = (int, float, np.integer, np.floating)
        kept = {
            key: float(value)
            for key, value in key_values.items()
            if isinstance(value, numbers) and "wandb" not in (key_excluded.get(key) or ())
        }
        self._run.log(kept, step=step)

    def close(self) -> None:
        """Do nothing; the callback ends the run."""
