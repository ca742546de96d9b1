"""Robots as single slots: what a library that knows no teams is given of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..faces.spaces import of_one_robot

__all__ = ["last_moments", "of_one_robot", "team_options"]


def last_moments(
    observations: NDArray[np.float32], infos: Mapping[str, Any], over: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.int64]]:
    """Observations, active and merged_into at the end of the step, before anything began anew."""
    active, into = infos["active"], infos["merged_into"]
    if not over.any():
        return observations, active, into
    observations, final = observations.copy(), infos["final_info"]
    observations[over] = np.stack(infos["final_obs"][over].tolist())
    rows = over[:, None]
    return (
        observations,
        np.where(rows, final["active"], active),
        np.where(rows, final["merged_into"], into),
    )


def team_options(options: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Options of all teams, stacked, from those of each.

    Raises:
        ValueError: if teams are given different kinds of options, or different obstacles.
    """
    first = options[0]
    for other in options[1:]:
        same_obstacles = other.get("obstacles") == first.get("obstacles")
        if other.keys() != first.keys() or not same_obstacles:
            raise ValueError(
                f"set_options: all teams need the same keys and obstacles; one has {first}, "
                f"another {other}"
            )
    return {
        key: first[key] if key == "obstacles" else np.stack([each[key] for each in options])
        for key in first
    }
