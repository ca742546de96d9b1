"""What training tells of its environment: time, alignment, and how episodes ended."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.adapters.sb3 import RobotVecEnv

from .sensing_groups import SensingGroups


class WatchedRobots(RobotVecEnv):
    """Robots whose environment's time and alignment are summed up."""

    seconds = 0.0
    """Spent in steps."""
    alignment = 0.0
    """Sum over robots and steps."""
    aligned = 0
    """How many terms that sum has."""

    def step_wait(self) -> Any:
        """As RobotVecEnv, and take the time."""
        began = time.perf_counter()
        result = super().step_wait()
        alignment = self.teams.alignment
        known = ~np.isnan(alignment)
        self.alignment += float(alignment[known].sum())
        self.aligned += int(known.sum())
        self.seconds += time.perf_counter() - began
        return result

    def renew_sensors(self, update: int) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Give groups of teams whose time has come before this update their next sensor.

        Returns:
            Slots that have begun a new episode, (slots,), and what they are shown, (k, size).
        """
        if not isinstance(self.teams, SensingGroups):
            return np.zeros(self.num_envs, dtype=np.bool_), self.bootstrap_observations[:0]
        which, observations = self.teams.renew(update)
        self.slots.begin(which)
        return np.repeat(which, self.n_robots), self.slots.by_slot(observations)


def episode_numbers(episodes: list[dict[str, Any]]) -> dict[str, Any]:
    """Columns about the episodes that ended in an update; NaN without any."""
    if not episodes:
        nothing = dict.fromkeys(("success", "clean_success", "median_time", "return"), np.nan)
        return {"episodes": 0, **nothing}
    success = np.array([episode["success"] for episode in episodes])
    contacts = np.array([episode["contacts"] for episode in episodes])
    times = np.where(success, [episode["time"] for episode in episodes], np.inf)
    median = np.median(times)
    return {
        "episodes": len(episodes),
        "success": success.mean(),
        "clean_success": (success & (contacts == 0)).mean(),
        "median_time": median if np.isfinite(median) else np.nan,
        "return": np.mean([episode["r"] for episode in episodes]),
    }
