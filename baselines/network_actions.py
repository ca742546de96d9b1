"""Validation of a network's outputs for a batch of robots: choices, or vectors."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import check_shape, floats, raise_invalid

from .records import Array


def check_choices(choices: ArrayLike, shape: tuple[int, ...], count: int) -> NDArray[np.int64]:
    """Choices of shape (B, n) as integers below ``count``.

    A ValueError names the robot of an invalid one.
    """
    numbers, given = floats("actions", choices), np.asarray(choices)
    check_shape("actions", given, shape, axes="(B, n)")
    is_choice = (numbers >= 0) & (numbers < count) & (numbers == np.floor(numbers))
    for team, robot in np.argwhere(~is_choice):
        raise ValueError(
            f"action of robot_{robot} in environment {team} is {given[team, robot]}; it must be "
            f"an integer below {count}"
        )
    return numbers.astype(np.int64)


def raise_not_finite(vectors: Array) -> None:
    """Raise a ValueError that names the first robot whose vector, of (B, n, 2), is not finite."""
    for team, robot, _ in np.argwhere(~np.isfinite(vectors)):
        raise_invalid(
            f"action of robot_{robot} in environment {team}",
            vectors[team, robot].tolist(),
            "finite",
        )
