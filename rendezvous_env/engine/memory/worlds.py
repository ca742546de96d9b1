"""Obstacles of all teams, and of one."""

from typing import Any

import numpy as np

from ...compilation import chosen_by_type, kernel
from ...obstacles.obstacle_set import AnyObstacles, RoundObstacles


def world_of(obstacles: Any, team: int) -> Any:
    """The obstacles of one team.

    Args:
        obstacles: ObstacleSet with a leading axis B, or None without obstacles.
        team: index.
    """
    if obstacles is None:
        return None
    return type(obstacles)(*(array[team] for array in obstacles))


@chosen_by_type(world_of)
def _compiled_world_of(obstacles, team):
    if not hasattr(obstacles, "instance_class"):
        return lambda obstacles, team: None
    if obstacles.instance_class is RoundObstacles:
        return lambda obstacles, team: RoundObstacles(
            obstacles.kinds[team], obstacles.corners[team], obstacles.shapes[team]
        )
    return lambda obstacles, team: AnyObstacles(
        obstacles.kinds[team], obstacles.corners[team], obstacles.shapes[team]
    )


def empty_worlds(obstacles: Any, count: int) -> Any:
    """Room for the obstacles of ``count`` teams, like those of all; None without obstacles."""
    if obstacles is None:
        return None
    return type(obstacles)(*(np.empty((count, *a.shape[1:]), a.dtype) for a in obstacles))


@kernel
def copy_world(source, k, target, place):
    """Copy the obstacles of team k to another place; nothing without obstacles."""
    if source is not None:
        for m in range(source.kinds.shape[1]):
            target.kinds[place, m] = source.kinds[k, m]
            target.corners[place, m] = source.corners[k, m]
            for column in range(source.shapes.shape[2]):
                target.shapes[place, m, column] = source.shapes[k, m, column]
