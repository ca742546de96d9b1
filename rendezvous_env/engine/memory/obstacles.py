"""Obstacles of all teams, with a leading axis, and of one."""

from typing import Any

from ...compilation import by_type


def _of_kind(kind: type) -> Any:
    def of_team(obstacles, team):
        return kind(obstacles.kinds[team], obstacles.corners[team], obstacles.shapes[team])

    return None if kind is type(None) else of_team


@by_type("obstacles", _of_kind)
def obstacles_of(obstacles, team):
    """The obstacles of one team; None without any."""
