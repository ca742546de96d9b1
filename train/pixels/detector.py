"""Detection of bearings and obstacle edges in images: coloured lamps and dark obstacles.

The input is pixels only. Known parameters are the cameras (four of 90°, their height above the
floor), the colours of the lamps, and their round shape.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_SATURATED = 90
"""Minimum channel difference of a lamp pixel; everything else is grey."""
_DARK = 110
"""Maximum brightness of an obstacle pixel; floor and lamps are brighter."""
_CUT = 1.5
"""Tolerance between width and height of a complete lamp, pixels."""
_OVAL = 0.1
"""The same tolerance as a fraction of the height."""
_STEP, _ROWS = 0.25, 2.5
"""Minimum jump between the lower edges of two overlapping obstacles: fraction, pixels."""
_WIDEST = 96
"""Maximum width of a detected obstacle, columns; wider ones are split."""


class Detections(NamedTuple):
    """Detections of one camera sweep, in the robot's frame."""

    colours: list[int]  # indices of complete lamps
    bearings: NDArray[np.float64]  # of their middles, (k,), rad
    edges: NDArray[np.float64]  # counter-clockwise and clockwise, of obstacles in range, (m, 2)


class Detector:
    """Detector of lamps and obstacles in the images of a ring of cameras.

    Args:
        colours: of the lamps, (c, 3), 0 to 255.
        height: of the cameras above the floor, m.
        reach: maximum distance of reported obstacles, m.
    """

    def __init__(self, colours: NDArray[np.uint8], height: float, reach: float) -> None:
        hues = np.asarray(colours, np.float64)
        self._hues = hues - hues.mean(axis=1, keepdims=True)
        self._hues /= np.linalg.norm(self._hues, axis=1, keepdims=True)
        self._height, self._reach = height, reach

    def find(self, pictures: NDArray[np.uint8]) -> Detections:
        """Detections in images (cameras, rows, columns, 3); camera k faces k 2π/cameras.

        The images are concatenated counter-clockwise to a closed panorama.
        """
        ring = _Ring(len(pictures), pictures.shape[2])
        around = pictures[:, :, ::-1].swapaxes(0, 1).reshape(pictures.shape[1], -1, 3)
        brightest, faintest = around.max(axis=-1), around.min(axis=-1)
        coloured = (brightest.astype(np.int64) - faintest) > _SATURATED
        rgb, lamps = around[coloured].astype(np.float64), np.full(coloured.shape, -1)
        # the lamp whose hue is the nearest
        lamps[coloured] = ((rgb - rgb.mean(axis=1, keepdims=True)) @ self._hues.T).argmax(axis=1)
        found = {c: ring.round_blob(lamps == c) for c in np.unique(lamps[coloured]).tolist()}
        whole = {c: bearing for c, bearing in found.items() if bearing is not None}
        dark = (brightest < _DARK) & ~coloured
        edges = self._obstacles(ring, dark, coloured.any(axis=0))
        return Detections(list(whole), np.array(list(whole.values())), edges)

    def _obstacles(
        self, ring: _Ring, dark: NDArray[np.bool_], behind_lamp: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Obstacle edges (m, 2), rad: runs of dark columns, split where the floor edge jumps."""
        rows = len(dark)
        lowest = np.where(dark.any(axis=0), rows - np.argmax(dark[::-1], axis=0), 0) - rows // 2
        stands = lowest > 0  # in floor pixels below the horizon
        lowest = np.where(behind_lamp, 0, lowest)  # a lamp hides the floor in front
        edges = []
        for columns in stretches(stands):
            depth = lowest[columns].astype(np.float64)
            known = np.flatnonzero(depth > 0)
            if not len(known):
                continue
            depth = np.interp(np.arange(len(depth)), known, depth[known])  # as neighbours stand
            for part in _split(depth):
                seen = columns[part]
                distance = self._height * ring.focal / depth[part] / ring.foreshortening[seen]
                if distance.min() <= self._reach:
                    edges.append((ring.left[seen[-1]], ring.right[seen[0]]))
        return np.array(edges).reshape(-1, 2)


class _Ring:
    """Pixel columns of all cameras, ordered by azimuth."""

    def __init__(self, cameras: int, columns: int) -> None:
        half = np.tan(np.pi / cameras)
        self.focal = columns / (2.0 * half)
        sides = np.arctan((np.arange(columns + 1) / columns * 2.0 - 1.0) * half)
        middles = np.arctan(((np.arange(columns) + 0.5) / columns * 2.0 - 1.0) * half)
        ahead = 2.0 * np.pi / cameras * np.arange(cameras)[:, np.newaxis]
        self.right, self.left = (ahead + sides[:-1]).ravel(), (ahead + sides[1:]).ravel()
        self.middle = (ahead + middles).ravel()
        self.foreshortening = np.tile(np.cos(middles), cameras)

    def round_blob(self, blob: NDArray[Any]) -> float | None:
        """Bearing of the centre of a blob, rad; None if the blob is truncated (not round)."""
        parts = stretches(np.asarray(blob.any(axis=0)))
        if len(parts) != 1:
            return None
        (columns,) = parts
        width = np.unwrap(self.left[columns])[-1] - np.unwrap(self.right[columns])[0]
        along = self.foreshortening[columns[len(columns) // 2]]
        height = 2.0 * np.arctan(0.5 * blob.any(axis=1).sum() * along / self.focal)
        if abs(width - height) > _CUT * along**2 / self.focal + _OVAL * height:
            return None
        area = blob[:, columns].sum(axis=0) * self.foreshortening[columns] ** 3  # seen from here
        return float(np.average(np.unwrap(self.middle[columns]), weights=area))


def stretches(there: NDArray[Any]) -> list[NDArray[np.int64]]:
    """Indices of each run of true values in a ring, in order."""
    start = int(np.argmin(there))  # false values, if any
    order = (np.arange(len(there)) + start) % len(there)
    places = np.flatnonzero(there[order])
    runs = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    return [order[run] for run in runs if len(run)]


def _split(depth: NDArray[np.float64]) -> list[slice]:
    """Split points between adjacent obstacles, from the floor edge along a run of columns.

    A part is narrower than half a turn and wider than one column.
    """
    jump, near = np.abs(np.diff(depth)), np.maximum(depth[1:], depth[:-1])
    ends = [0]
    for cut in (np.flatnonzero((jump > _ROWS) & (jump > _STEP * near)) + 1).tolist():
        if min(cut - ends[-1], len(depth) - cut) > 1:
            ends.append(cut)
    ends.append(len(depth))
    parts = [np.linspace(a, b, 2 + (b - a) // _WIDEST) for a, b in pairwise(ends)]
    return [slice(int(a), int(b)) for part in parts for a, b in pairwise(part)]
