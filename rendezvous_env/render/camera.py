"""Projection of points to pixels: a fixed view with equal scale in all axes."""

import math
from itertools import product
from typing import NamedTuple

import numpy as np

from ..obstacles.obstacle_set import outlines
from .scene import Bools, Floats, outermost

_AZIMUTH, _ELEVATION = math.radians(-62.0), math.radians(24.0)  # of the eye, in 3-D
_DISTANCE = 2.6  # of the eye from the middle of a scene, in diagonals of its bounding box
# minimum extent in every axis, relative to the largest, so that a row of robots has a view too
_LEAST_SHARE = 0.02


class PixelArea(NamedTuple):
    """A rectangle of pixels."""

    left: int
    top: int
    width: int
    height: int


def columns_of(count: int) -> int:
    """Number of columns in a grid of the given number of environments."""
    return math.ceil(math.sqrt(count))


def cell(team: int, count: int, width: int, height: int) -> PixelArea:
    """Area of one environment in a grid picture of the given size, pixels."""
    columns = columns_of(count)
    rows = math.ceil(count / columns)
    row, column = divmod(team, columns)
    left, right = (place * width // columns for place in (column, column + 1))
    top, bottom = (place * height // rows for place in (row, row + 1))
    return PixelArea(left, top, right - left, bottom - top)


class Camera(NamedTuple):
    """Fixed view: top view in the plane, perspective in 3-D."""

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
        """Centre of the scene, (d,), m."""
        return (self.low + self.high) / 2

    def project(self, points: Floats) -> Floats:
        """Pixels (..., 2), x to the right and y downwards, of points (..., d) in m."""
        offsets = np.asarray(points, dtype=np.float64) - self.centre
        flat = np.stack([offsets @ self.right, -(offsets @ self.up)], axis=-1)
        return self.shift + self.scale * self.nearness(points)[..., None] * flat

    def unproject(self, pixels: Floats) -> Floats:
        """Points (..., 2), m, of pixels (..., 2) in a top view of the plane."""
        flat = (np.asarray(pixels, dtype=np.float64) - self.shift) / self.scale
        return np.asarray(self.centre + flat[..., :1] * self.right - flat[..., 1:] * self.up)

    def nearness(self, points: Floats) -> Floats:
        """Magnification at points (..., d) relative to the centre, (...,)."""
        offsets = np.asarray(points, dtype=np.float64) - self.centre
        return 1.0 / (1.0 - (offsets @ self.back) / self.distance)

    def directions(self, points: Floats, vectors: Floats) -> Floats:
        """Projection of unit vectors (..., d) at points (..., d): (..., 2), foreshortened."""
        short = 1e-3 / self.scale
        moved = self.project(points + short * vectors) - self.project(points)
        return moved / (1e-3 * self.nearness(points)[..., None])

    def hidden(self, points: Floats, obstacles: Floats) -> Bools:
        """True for points (m, d), m, that a sphere occludes, (m,); False in the plane."""
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


def fit(positions: Floats, obstacles: Floats, area: PixelArea, margin: float) -> Camera:
    """View that fits initial positions (n, d), m, and obstacles (M, width) into an area.

    Pixels count from the top left corner of the area, with a margin on each side.
    """
    points = outermost(positions, obstacles)
    low, high = points.min(axis=0), points.max(axis=0)
    extent = (high - low).max() or 1.0  # if all robots are at one position
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
    """View of a bounding box, from above or in perspective."""
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
    """Smallest 1, 2 or 5 times a power of ten that fits at most ``most`` times into a span."""
    power = 10.0 ** math.floor(math.log10(span / most))
    return next(step * power for step in (1, 2, 5, 10, 20) if step * power * most >= span)
