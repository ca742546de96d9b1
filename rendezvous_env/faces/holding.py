"""What wrappers with a guarantee share in both worlds: their decision period, and their memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine.state_checks import check_entries, check_finite, check_keys
from ..experiment.checks import whole
from ..experiment.limits import MOST_HELD_STEPS
from ..guarantee.action_filter import ActionFilter


def check_period(decision_period: int) -> int:
    """A decision period that is a positive whole number.

    Raises:
        ValueError: if it is not.
    """
    return whole("decision_period", decision_period, 1, MOST_HELD_STEPS)


def restore(
    env: Any,
    memory: str,
    action_filter: ActionFilter,
    observed: NDArray[np.float32],
    state: Mapping[str, Any],
) -> NDArray[np.float32]:
    """Put a wrapper's state back: the environment's episodes, the filter's memory.

    Args:
        env: what is wrapped.
        memory: what the filter's part of the state is called.
        action_filter: the wrapper's.
        observed: observations like those it remembers.
        state: "env", the filter's part, and "observed".

    Returns:
        The remembered observations.

    Raises:
        ValueError: naming what does not fit; nothing has changed then.
    """
    check_keys(state, ("env", memory, "observed"))
    checked = check_entries({"observed": observed}, state)
    check_finite(checked, ("observed",))
    remembered = action_filter.check_state(state[memory])
    env.set_state(state["env"])
    action_filter.set_state(remembered)
    return checked["observed"].copy()
