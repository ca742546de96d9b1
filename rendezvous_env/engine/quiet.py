"""Kernels that draw random numbers, run as plain Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..compilation import compiled


def quietly(run: Callable[..., Any]) -> Callable[..., Any]:
    """The same function; without compilation NumPy would warn of every product of 64-bit numbers
    that wraps around.
    """
    return run if compiled() else np.errstate(over="ignore")(run)
