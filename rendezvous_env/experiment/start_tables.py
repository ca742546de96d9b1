"""Tables of numbers, one row for each robot, that a start is given by."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import checks
from .checks import shown
from .limits import LARGEST


def check_table(field: str, value: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """A float64 array of a shape, of numbers within the limits.

    Raises:
        ValueError: naming the field, and its shape or the robot whose entry is not finite.
    """
    table = np.array(checks.floats(field, value))
    if table.shape != shape:
        raise ValueError(f"{field} has shape {table.shape}; it must be {shape}")
    if not (wanted := np.abs(table) <= LARGEST).all():
        at = tuple(int(k) for k in np.argwhere(~wanted)[0])
        raise ValueError(
            f"{field} of robot_{at[0]} is {shown(table[at[0]].tolist())}; it must be finite, and "
            f"from {-LARGEST:g} to {LARGEST:g}"
        )
    return table


def check_distinct(
    field: str, positions: NDArray[np.float64], weights: NDArray[np.float64]
) -> None:
    """Refuse neighbours that stand in the same place: no bearing exists between them.

    Args:
        field: what the message calls the positions.
        positions: (n, d), m.
        weights: (n, n); only pairs with a positive weight, in either way, are looked at.

    Raises:
        ValueError: naming the pair.
    """
    offsets = positions[None] - positions[:, None]
    coincident = (np.abs(offsets).max(axis=-1) == 0) & np.triu((weights > 0) | (weights.T > 0))
    for i, j in np.argwhere(coincident):
        raise ValueError(
            f"{field}: neighbours robot_{i} and robot_{j} both stand at {positions[i].tolist()}; "
            "they must not coincide"
        )
