"""Obstacles of all teams, with a leading axis, and of one."""

from typing import Any

import numpy as np

from ...compilation import chosen_by_type, kernel


def obstacles_of(obstacles: Any, team: int) -> Any:
    """The obstacles of one team; None without any."""
    if obstacles is None:
        return None
    return type(obstacles)(*(array[team] for array in obstacles))


@chosen_by_type(obstacles_of)
def _compiled_obstacles_of(obstacles, team):
    if (kind := getattr(obstacles, "instance_class", None)) is None:
        return lambda obstacles, team: None
    return lambda obstacles, team: kind(
        obstacles.kinds[team], obstacles.corners[team], obstacles.shapes[team]
    )


def room_for_obstacles(obstacles: Any, count: int) -> Any:
    """Room for the obstacles of ``count`` teams, like those of all; None without obstacles."""
    if obstacles is None:
        return None
    return type(obstacles)(*(np.empty((count, *a.shape[1:]), a.dtype) for a in obstacles))


@kernel
def copy_obstacles(source, k, target, place):
    """Copy the obstacles of team k to another place; nothing without obstacles."""
    if source is not None:
        for m in range(source.kinds.shape[1]):
            target.kinds[place, m] = source.kinds[k, m]
            target.corners[place, m] = source.corners[k, m]
            for column in range(source.shapes.shape[2]):
                target.shapes[place, m, column] = source.shapes[k, m, column]
