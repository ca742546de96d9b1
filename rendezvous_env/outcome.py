"""What one step of the simulator gives out."""

import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

SCORES = 8
_REWARD, _BEFORE_MERGE, _AFTER_MERGE, _RISE, _EXCESS, ELAPSED, _, LYAPUNOV = range(SCORES)
"""Rows of ``StepOutput.scores``. The last three are told in every step, and to read them out of the
teams' statistics would take longer than the step of small teams."""


class StepOutput(NamedTuple):
    """What one step gives out; every array is freshly allocated and belongs to the caller."""

    observations: NDArray[np.float32]
    """(B, n, rows, d)."""
    scores: NDArray[np.float64]
    """(8, B): the team reward; V just before the first and after the last merge of the step (V at
    its end if there was none); the largest rise of V at a merge, and above the bound of theory 5;
    time and length of all paths since the start of the episode, s and m; V at the end of the step,
    m²/s."""
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
    crowded: NDArray[np.int64]
    """(B,), a robot with more neighbours than the observation has rows; −1 if there is none. The
    same memory in every step: it is looked at once."""

    @property
    def rewards(self) -> NDArray[np.float64]:
        """(B,), of the team."""
        return self.scores[_REWARD]

    @property
    def lyapunov_before_merge(self) -> NDArray[np.float64]:
        """(B,), V just before the first merge of the step, m²/s; V at its end if there was none."""
        return self.scores[_BEFORE_MERGE]

    @property
    def lyapunov_after_merge(self) -> NDArray[np.float64]:
        """(B,), V just after the last merge of the step, m²/s; V at its end if there was none."""
        return self.scores[_AFTER_MERGE]

    @property
    def merge_rise(self) -> NDArray[np.float64]:
        """(B,), largest rise of V at a merge of the step, m²/s; 0 if there was none."""
        return self.scores[_RISE]

    @property
    def merge_excess(self) -> NDArray[np.float64]:
        """(B,), largest rise of V at a merge above its bound (theory 5), m²/s; or 0."""
        return self.scores[_EXCESS]


def __getattr__(name: str) -> Any:
    """The old name of StepOutput, for one version."""
    if name == "Outcome":
        warnings.warn("Outcome is StepOutput now", DeprecationWarning, stacklevel=2)
        return StepOutput
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
