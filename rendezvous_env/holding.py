"""What the heading wrappers of both worlds share: their decision period, and their memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .engine.state_checks import check_entries, check_finite, check_keys
from .experiment.checks import whole
from .experiment.limits import MOST_HELD_STEPS
from .guarantee.steering import Steering


def check_period(decision_period: int) -> int:
    """A decision period that is a positive whole number.

    Raises:
        ValueError: if it is not.
    """
    return whole("decision_period", decision_period, 1, MOST_HELD_STEPS)


def restore(
    env: Any, steering: Steering, shape: tuple[int, ...], state: Mapping[str, Any]
) -> NDArray[np.float32]:
    """Put a wrapper's state back: the environment's episodes, the steering's memory.

    Args:
        env: what is wrapped.
        steering: the wrapper's.
        shape: of the observations it remembers.
        state: "env", "steering" and "observed".

    Returns:
        The remembered observations.

    Raises:
        ValueError: naming what does not fit; nothing has changed then.
    """
    check_keys(state, ("env", "steering", "observed"))
    checked = check_entries({"observed": np.zeros(shape, dtype=np.float32)}, state)
    check_finite(checked, ("observed",))
    memory = steering.check_state(state["steering"])
    env.set_state(state["env"])
    steering.set_state(memory)
    return checked["observed"].copy()
