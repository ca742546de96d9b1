"""The warning of a time step with which V may rise."""

from __future__ import annotations

import warnings
from collections.abc import Callable


class TimeStepWarning(UserWarning):
    """The time step is longer than the certified one, so V may rise between merges."""


def warn_of_long_step(time_step: float, certified_step: float) -> None:
    """Warn whoever makes a scenario of a step, s, longer than the certified one, s."""
    if time_step > certified_step * (1 + 1e-12):
        warnings.warn(
            f"time_step is {time_step:.6g} s, longer than the certified step "
            f"{certified_step:.6g} s: V may rise between merges unless velocities are "
            "scaled (theory 4); pass allow_long_step=True if this is meant",
            TimeStepWarning,
            stacklevel=_frames_to_caller(),
        )


def _frames_to_caller() -> int:
    """How far up the stack the code stands that made the scenario, for the warning's line
    number.
    """
    import sys

    level, frame = 1, sys._getframe(1)
    inside: Callable[[str], bool] = lambda name: name.startswith(("rendezvous_env.", "dataclasses"))  # noqa: E731
    while frame.f_back and (
        inside(frame.f_globals.get("__name__", "")) or frame.f_code.co_name == "__init__"
    ):
        frame, level = frame.f_back, level + 1
    return level
