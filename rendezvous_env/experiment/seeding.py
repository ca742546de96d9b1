"""Which seed every team gets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .checks import is_whole, shown
from .limits import LARGEST_SEED


def seeds_of_teams(seed: Any, num_envs: int) -> list[int | None] | None:
    """A seed for each team, None where it keeps its own; None if all do.

    Args:
        seed: s gives team i the seed s + i; a sequence or array gives each team its own.
        num_envs: B.

    Raises:
        ValueError: naming what is no seed.
    """
    if seed is None:
        return None
    if isinstance(seed, np.ndarray):
        seed = seed.tolist()
    if not isinstance(seed, Sequence) or isinstance(seed, str | bytes):
        first = _checked(seed)
        if first + num_envs - 1 > LARGEST_SEED:
            raise ValueError(
                f"seed {first} must leave room for {num_envs} teams, whose seeds follow on it: "
                f"at most {LARGEST_SEED - num_envs + 1}"
            )
        return [first + team for team in range(num_envs)]
    if len(seed) != num_envs:
        raise ValueError(f"seed has {len(seed)} entries; it must be one number, or {num_envs}")
    return [None if entry is None else _checked(entry) for entry in seed]


def _checked(value: Any) -> int:
    if not is_whole(value) or not 0 <= value <= LARGEST_SEED:
        raise ValueError(f"seed {shown(value)} must be a whole number, 0 or more, at most 2^63 - 1")
    return int(value)
