"""Output of one simulator step."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .deprecation import warn_renamed

SCORES = 8
_REWARD, _BEFORE_MERGE, _AFTER_MERGE, _RISE, _EXCESS, ELAPSED, _, LYAPUNOV = range(SCORES)
"""Rows of ``StepOutput.scores``. The last three are reported in every step; reading them from
the statistics would take longer than the step of a small environment."""


class StepOutput(NamedTuple):
    """Output of one step; every array is newly allocated and belongs to the caller."""

    observations: NDArray[np.float32]
    """Observations, (B, n, rows, d)."""
    scores: NDArray[np.float64]
    """Scores, (8, B): the team reward; V just before the first and after the last merge of the
    step (V at its end without a merge); the largest increase of V at a merge, and its excess
    over the bound of theory 5; time and length of all paths since the start of the episode, s
    and m; V at the end of the step, m²/s."""
    contact: NDArray[np.bool_]
    """Robots in contact with an obstacle in this step, (B, n)."""
    clearance: NDArray[np.float64]
    """Distance of each robot to the nearest obstacle, (B, n), m; inf without obstacles."""
    active: NDArray[np.bool_]
    """Active (not merged) robots, (B, n)."""
    status: NDArray[np.int64]
    """Status, (B,): RUNNING, RENDEZVOUS or TIME_OUT of engine.memory."""
    robot_rewards: NDArray[np.float64]
    """Team reward for robots that took part in the step, else 0, (B, n). With ``on_merge``
    "follow" all take part."""
    contacts: NDArray[np.int64]
    """Contacts in the episode so far, one per robot and step, (B,)."""
    neighbour_overflow: NDArray[np.int64]
    """A robot with more neighbours than observation rows, (B,), or −1. The memory is the same in
    every step and is read once."""

    @property
    def rewards(self) -> NDArray[np.float64]:
        """Team rewards, (B,)."""
        return self.scores[_REWARD]

    @property
    def lyapunov_before_merge(self) -> NDArray[np.float64]:
        """V just before the first merge of the step, or at its end without a merge, (B,), m²/s."""
        return self.scores[_BEFORE_MERGE]

    @property
    def lyapunov_after_merge(self) -> NDArray[np.float64]:
        """V just after the last merge of the step, or at its end without a merge, (B,), m²/s."""
        return self.scores[_AFTER_MERGE]

    @property
    def merge_rise(self) -> NDArray[np.float64]:
        """Largest increase of V at a merge of the step, (B,), m²/s; 0 without a merge."""
        return self.scores[_RISE]

    @property
    def merge_excess(self) -> NDArray[np.float64]:
        """Largest excess of V at a merge over its bound (theory 5), (B,), m²/s; or 0."""
        return self.scores[_EXCESS]


def __getattr__(name: str) -> Any:
    """Provide the former name of StepOutput, for one version."""
    if name == "Outcome":
        warn_renamed("Outcome", "StepOutput")
        return StepOutput
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
