"""Where a point of the plane or of space stands in a picture: a fixed view, equal in every axis."""

import math
from itertools import product
from typing import NamedTuple

import numpy as np

from ..obstacles.obstacle_set import outlines
from .scene import Bools, Floats, outermost

_AZIMUTH, _ELEVATION = math.radians(-62.0), math.radians(24.0)  # of the eye, in 3-D
_DISTANCE = 2.6  # of the eye from the middle of a scene, in diagonals of its bounding box
# of its largest extent that a scene has in every axis, so that a row of robots has a view too
_LEAST_SHARE = 0.02


class Area(NamedTuple):
    """A rectangle of pixels."""

    left: int
    top: int
    width: int
    height: int


def columns_of(count: int) -> int:
    """Teams in a row of a picture of so many."""
    return math.ceil(math.sqrt(count))


def cell(team: int, count: int, width: int, height: int) -> Area:
    """A team's part of a picture of so many teams, whose size is given in pixels."""
    columns = columns_of(count)
    rows = math.ceil(count / columns)
    row, column = divmod(team, columns)
    left, right = (place * width // columns for place in (column, column + 1))
    top, bottom = (place * height // rows for place in (row, row + 1))
    return Area(left, top, right - left, bottom - top)


class Camera(NamedTuple):
    """A fixed view; the plane from straight above, space in perspective."""

    low: Floats  # (d,), least corner of the scene's bounding box, m
    high: Floats  # (d,), its largest corner, m
    right: Floats  # (d,), unit vector to the right of the picture
    up: Floats  # (d,), unit vector to its top
    back: Floats  # (d,), unit vector towards the eye; zero in the plane
    distance: float  # of the eye from the middle of the scene, m; inf in the plane
    scale: float = 1.0  # pixels for a metre at the middle of the scene
    shift: tuple[float, float] = (0.0, 0.0)  # pixel of the middle of the scene

    @property
    def centre(self) -> Floats:
        """(d,), middle of the scene, m."""
        return (self.low + self.high) / 2

    def project(self, points: Floats) -> Floats:
        """Pixels (..., 2), x to the right and y downwards, of points (..., d) in m."""
        offsets = np.asarray(points, dtype=np.float64) - self.centre
        flat = np.stack([offsets @ self.right, -(offsets @ self.up)], axis=-1)
        return self.shift + self.scale * self.nearness(points)[..., None] * flat

    def nearness(self, points: Floats) -> Floats:
        """(...,), how much larger things appear at points (..., d) than at the middle."""
        offsets = np.asarray(points, dtype=np.float64) - self.centre
        return 1.0 / (1.0 - (offsets @ self.back) / self.distance)

    def directions(self, points: Floats, vectors: Floats) -> Floats:
        """Unit vectors (..., d) at points (..., d) as they appear: (..., 2), shorter than 1 where
        they point towards the eye or away from it.
        """
        short = 1e-3 / self.scale
        moved = self.project(points + short * vectors) - self.project(points)
        return moved / (1e-3 * self.nearness(points)[..., None])

    def hidden(self, points: Floats, obstacles: Floats) -> Bools:
        """(m,), whether a sphere of a table stands between the eye and each point (m, d), m; in the
        plane nothing is hidden.
        """
        spheres = [] if math.isinf(self.distance) else outlines(obstacles, 3)
        if not spheres:
            return np.zeros(len(points), dtype=np.bool_)
        centres = np.array([ball.centre for ball in spheres])
        radii = np.array([ball.radius for ball in spheres])
        sight = self.centre + self.distance * self.back - points
        to_centres = centres[None] - points[:, None]
        along = np.einsum("pmk,pk->pm", to_centres, sight) / np.sum(sight**2, axis=-1)[:, None]
        nearest = to_centres - np.clip(along, 0.0, 1.0)[..., None] * sight[:, None]
        inside = np.sum(nearest**2, axis=-1) < radii**2
        return np.asarray(inside.any(axis=-1))


def fit(positions: Floats, obstacles: Floats, area: Area, margin: float) -> Camera:
    """The view of a team's start (n, d), m, and its table of obstacles (M, width) that fills an
    area but for a margin on each side; pixels count from its left top corner.
    """
    points = outermost(positions, obstacles)
    low, high = points.min(axis=0), points.max(axis=0)
    extent = (high - low).max() or 1.0  # of robots that are all in one place
    lacking = np.maximum(0.0, _LEAST_SHARE * extent - (high - low)) / 2
    low, high = low - lacking, high + lacking
    camera = _view(low, high)
    floor = np.tile(low, (4, 1))
    floor[:, :2] = list(product(*zip(low[:2], high[:2], strict=True)))
    seen = camera.project(np.concatenate([points, floor]))
    least, most = seen.min(axis=0), seen.max(axis=0)
    size = np.array([area.width, area.height])
    scale = float(np.min((size - 2 * margin) / (most - least)))
    x, y = (size / 2 - scale * (least + most) / 2).tolist()
    return camera._replace(scale=scale, shift=(x, y))


def _view(low: Floats, high: Floats) -> Camera:
    """Of a bounding box: from above, or in perspective."""
    if len(low) == 2:
        right, up = np.eye(2)
        return Camera(low, high, right, up, np.zeros(2), math.inf)
    sine, cosine = math.sin(_AZIMUTH), math.cos(_AZIMUTH)
    rise, level = math.sin(_ELEVATION), math.cos(_ELEVATION)
    return Camera(
        low,
        high,
        right=np.array([-sine, cosine, 0.0]),
        up=np.array([-rise * cosine, -rise * sine, level]),
        back=np.array([level * cosine, level * sine, rise]),
        distance=_DISTANCE * float(np.linalg.norm(high - low)),
    )


def nice_step(span: float, most: int) -> float:
    """The least of 1, 2 and 5 times a power of ten of which at most ``most`` fit into a span."""
    power = 10.0 ** math.floor(math.log10(span / most))
    return next(step * power for step in (1, 2, 5, 10, 20) if step * power * most >= span)
