"""Bearings and edges in pictures: lamps by their colours, obstacles by being dark.

The detector gets nothing but pixels. It knows the cameras (four of 90°, their height above the
floor), the colours of the lamps, and that a lamp is round.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_SATURATED = 90
"""A lamp's channels differ by more; nothing else has a colour."""
_DARK = 110
"""An obstacle's brightest channel is below; floor and lamps are brighter."""
_CUT = 1.5
"""Pixels by which a whole lamp may be wider than it is high, or less."""
_OVAL = 0.1
"""The same as a share of its height."""
_STEP, _ROWS = 0.25, 2.5
"""The nearer of two obstacles that touch in a picture is nearer by this share, and so many pixels
lower."""
_WIDEST = 96
"""Columns of a silhouette; a wider one is given in parts."""


class Found(NamedTuple):
    """What one look around shows, in the robot's own frame."""

    colours: list[int]  # which lamps are seen whole, by number
    bearings: NDArray[np.float64]  # of their middles, (k,), rad
    edges: NDArray[np.float64]  # counter-clockwise and clockwise, of obstacles in range, (m, 2)


class Detector:
    """Finds lamps of these colours, (c, 3), 0 to 255, and obstacles in the pictures of a ring of
    cameras at this height above the floor, m. Obstacles beyond ``reach``, m, are left out.
    """

    def __init__(self, colours: NDArray[np.uint8], height: float, reach: float) -> None:
        hues = np.asarray(colours, np.float64)
        self._hues = hues - hues.mean(axis=1, keepdims=True)
        self._hues /= np.linalg.norm(self._hues, axis=1, keepdims=True)
        self._height, self._reach = height, reach

    def find(self, pictures: NDArray[np.uint8]) -> Found:
        """What is seen in pictures (cameras, rows, columns, 3); camera k looks along k 2π/cameras.

        The pictures are laid side by side, counter-clockwise, as one that closes.
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
        return Found(list(whole), np.array(list(whole.values())), edges)

    def _obstacles(
        self, ring: _Ring, dark: NDArray[np.bool_], behind_lamp: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Edges (m, 2), rad: a stretch of dark columns ends where the floor's edge jumps."""
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
    """Pixel columns of cameras side by side, in the order of their azimuths."""

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
        """Bearing of the middle of a blob, rad; None if it is cut, as what is not round must be."""
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
    """Indices of each run of what is true in a ring, in its order."""
    start = int(np.argmin(there))  # what is false, if anything
    order = (np.arange(len(there)) + start) % len(there)
    places = np.flatnonzero(there[order])
    runs = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    return [order[run] for run in runs if len(run)]


def _split(depth: NDArray[np.float64]) -> list[slice]:
    """Where one obstacle ends and another goes on, in rows below the horizon along a stretch; a
    silhouette is narrower than half a turn, and no single column is one.
    """
    jump, near = np.abs(np.diff(depth)), np.maximum(depth[1:], depth[:-1])
    ends = [0]
    for cut in (np.flatnonzero((jump > _ROWS) & (jump > _STEP * near)) + 1).tolist():
        if min(cut - ends[-1], len(depth) - cut) > 1:
            ends.append(cut)
    ends.append(len(depth))
    parts = [np.linspace(a, b, 2 + (b - a) // _WIDEST) for a, b in pairwise(ends)]
    return [slice(int(a), int(b)) for part in parts for a, b in pairwise(part)]
