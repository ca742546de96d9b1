"""Obstacles as what pictures draw: discs and outlines in the plane, balls in space."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..equations.shapes.obstacles import ABSENT, CAPSULE, POLYGON
from .packing import AXIS, CENTRE, CORNERS, DETAILS, KIND, RADIUS, THICKNESS

_ROUND_END = np.linspace(-math.pi / 2, math.pi / 2, 17)
"""Angles of the corners that stand for the half circle at an end of a capsule."""
_MOST_BEADS = 99
"""Balls drawn for a capsule; a very thin one is dotted."""


class Outline(NamedTuple):
    """An obstacle of the plane."""

    centre: NDArray[np.float64]
    """(2,), m, of the bounding disc."""
    radius: float
    """m, of the bounding disc."""
    vertices: NDArray[np.float64]
    """(k, 2), m; none for a disc, which its bounding disc is."""


def outlines(table: NDArray[np.float64]) -> Iterator[Outline]:
    """Every obstacle of a table (M, width) of the plane that is there."""
    for row in table[table[:, KIND] != ABSENT]:
        vertices = np.empty((0, 2))
        if row[KIND] == POLYGON:
            vertices = row[DETAILS : DETAILS + 2 * int(row[CORNERS])].reshape(-1, 2)
        elif row[KIND] == CAPSULE:
            vertices = _stadium(row)
        yield Outline(row[CENTRE : CENTRE + 2], float(row[RADIUS]), vertices)


def _stadium(row: NDArray[np.float64]) -> NDArray[np.float64]:
    half, centre = row[AXIS : AXIS + 2], row[CENTRE : CENTRE + 2]
    bearing = math.atan2(half[1], half[0])
    ends = [
        centre + end * half + row[THICKNESS] * np.stack([np.cos(around), np.sin(around)], axis=-1)
        for end, around in ((1.0, bearing + _ROUND_END), (-1.0, bearing + math.pi + _ROUND_END))
    ]
    return np.concatenate(ends)


class Ball(NamedTuple):
    """A ball in space."""

    centre: NDArray[np.float64]
    """(3,), m."""
    radius: float
    """m."""


def balls(table: NDArray[np.float64]) -> Iterator[Ball]:
    """Every obstacle of a table (M, width) of space that is there; a capsule is a row of balls."""
    for row in table[table[:, KIND] != ABSENT]:
        centre = row[CENTRE : CENTRE + 3]
        if row[KIND] != CAPSULE:
            yield Ball(centre, float(row[RADIUS]))
            continue
        half, thickness = row[AXIS : AXIS + 3], float(row[THICKNESS])
        beads = 1 + 2 * math.ceil(2 * float(np.linalg.norm(half)) / thickness)
        beads = min(beads, _MOST_BEADS)
        for share in np.linspace(-1.0, 1.0, beads) if beads > 1 else (0.0,):
            yield Ball(centre + share * half, thickness)
