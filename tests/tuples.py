"""How tests call the equations: vectors as triples, obstacles as worlds, results as arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rendezvous_env.obstacles.obstacle_set import Obstacle, ObstacleSet, pack, world_of
from rendezvous_env.obstacles.parsing import only_balls
from rendezvous_env.robots.nonholonomic_3d import arc_3d, body_frame_3d
from rendezvous_env.robots.unicycle import arc_2d, body_frame_2d


def triple(vector: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    """A vector of two or three numbers as (x, y, z); z = 0 in the plane."""
    x, y, z = [*map(float, vector), 0.0][:3]
    return x, y, z


def world(obstacles: Sequence[Obstacle], slots: int | None = None) -> ObstacleSet:
    """Obstacles as a world, of balls if they are; slots left over are absent."""
    table = pack(obstacles, len(obstacles) if slots is None else slots)
    return world_of(table, only_balls(tuple(obstacles)))


def arc(
    d: int,
    speed: float,
    yaw: float,
    pitch: float,
    yaw_rate: float,
    pitch_rate: float,
    duration: float,
) -> np.ndarray:
    """Displacement (d,) of a robot that moves along its own axis, m; no pitch in the plane."""
    if d == 2:
        return np.array(arc_2d(speed, yaw, yaw_rate, duration))
    return np.array(arc_3d(speed, yaw, pitch, yaw_rate, pitch_rate, duration))


def body_frame(d: int, yaw: float, pitch: float) -> np.ndarray:
    """Rotation (d, d) from the body frame to the global one."""
    return np.reshape(body_frame_2d(yaw) if d == 2 else body_frame_3d(yaw, pitch), (d, d))
