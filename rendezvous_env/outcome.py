"""What one step of the simulator gives out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .engine.memory import (
    ELAPSED,
    LYAPUNOV_AFTER_MERGE,
    LYAPUNOV_BEFORE_MERGE,
    MERGE_EXCESS,
    MERGE_RISE,
    REWARD,
    Results,
)


class Outcome:
    """What one step gives out; every array is freshly allocated and belongs to the caller."""

    __slots__ = (
        "_scores",
        "active",
        "clearance",
        "contact",
        "contacts",
        "observations",
        "results",
        "robot_rewards",
        "status",
    )

    observations: NDArray[np.float32]
    """(B, n, rows, d)."""
    contact: NDArray[np.bool_]
    """(B, n), whether the robot touched an obstacle in this step."""
    clearance: NDArray[np.float64]
    """(B, n), distance to the nearest obstacle, m; inf without obstacles."""
    active: NDArray[np.bool_]
    """(B, n), whether the robot still exists on its own."""
    status: NDArray[np.int64]
    """(B,), RUNNING, RENDEZVOUS or TIME_OUT of engine.memory."""
    robot_rewards: NDArray[np.float64]
    """(B, n), the team reward of robots that took part in the step, else 0; with ``on_merge``
    "follow" all do."""
    contacts: NDArray[np.int64]
    """(B,), contacts in the episode so far, one for each robot and step."""
    results: Results
    """The same arrays as the kernels want them."""

    def __init__(self, results: Results, observed: tuple[int, ...]) -> None:
        self.results = results
        flat, _, self._scores, self.contact, self.clearance, self.active = results[:6]
        self.status, self.robot_rewards, self.contacts = results[6:9]
        self.observations = flat.reshape(observed)

    @property
    def rewards(self) -> NDArray[np.float64]:
        """(B,), of the team."""
        return self._scores[REWARD]

    @property
    def so_far(self) -> NDArray[np.float64]:
        """(3, B), of the episode: its time, s, the path length of all robots, m, and V, m²/s."""
        return self._scores[ELAPSED:]

    @property
    def lyapunov_before_merge(self) -> NDArray[np.float64]:
        """(B,), V just before the first merge of the step, m²/s; V at its end if there was none."""
        return self._scores[LYAPUNOV_BEFORE_MERGE]

    @property
    def lyapunov_after_merge(self) -> NDArray[np.float64]:
        """(B,), V just after the last merge of the step, m²/s; V at its end if there was none."""
        return self._scores[LYAPUNOV_AFTER_MERGE]

    @property
    def merge_rise(self) -> NDArray[np.float64]:
        """(B,), largest rise of V at a merge of the step, m²/s; 0 if there was none."""
        return self._scores[MERGE_RISE]

    @property
    def merge_excess(self) -> NDArray[np.float64]:
        """(B,), largest rise of V at a merge above its bound (theory 5), m²/s; 0 if there was
        none.
        """
        return self._scores[MERGE_EXCESS]
