"""Helpers for equations: vectors as triples, obstacles as worlds, results as arrays."""

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


def separate(obstacles: Sequence[Obstacle]) -> ObstacleSet:
    """Obstacles as a world in which each is alone, without skins where two only just meet."""
    alone = world_of(pack(obstacles, len(obstacles))[:, None], only_balls(tuple(obstacles)))
    return type(alone)(*(array[:, 0] for array in alone))


def along(*degrees: float) -> np.ndarray:
    """Unit vectors (k, 2) at these angles."""
    angles = np.radians(degrees)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def world(obstacles: Sequence[Obstacle], slots: int | None = None) -> ObstacleSet:
    """Obstacles as a world, of balls if all are balls; unused slots are absent."""
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


def mean_body_axis(
    yaw_rate: object, pitch_rate: object, pitch: object, duration: float
) -> np.ndarray:
    """Mean of the body axis over an arc, (..., 3), in the initial body frame.

    Products of cosines become sums, each with the mean sinc(x/2) cos(angle at half time).
    """
    a, b, beta = (np.asarray(x, float) for x in np.broadcast_arrays(yaw_rate, pitch_rate, pitch))

    def mean(rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        half = 0.5 * rate * duration
        size = np.sinc(half / np.pi)
        return size * np.cos(beta + half), size * np.sin(beta + half)

    (cos_sum, sin_sum), (cos_less, sin_less), (_, up) = mean(b + a), mean(b - a), mean(b)
    ahead, left = 0.5 * (cos_sum + cos_less), 0.5 * (sin_sum - sin_less)
    c, s = np.cos(beta), np.sin(beta)
    return np.stack([c * ahead + s * up, left, c * up - s * ahead], axis=-1)
