"""What every shape of an obstacle has: the protocol, the checks of its numbers, its row.

An obstacle is a row of numbers, which files and pictures read:

    [kind, number of corners, radius of the bounding ball, centre x, y, z, …]

followed by what its shape needs; in the plane z = 0. Kernels take kind and number of corners by
themselves, and the rest as the row. A new shape is a file like ``capsule`` that ends with a
``ShapeKind``, and the name of that in ``obstacle_set.KINDS``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..checks import real, shown
from ..compilation import kernel
from ..limits import LARGEST
from ..physics.vectors import X_AXIS, combine, cross, dot, norm, subtract

ABSENT = 0
"""Kind of an empty slot."""
KIND, CORNERS, RADIUS, CENTRE, DETAILS = 0, 1, 2, 3, 6
"""Columns of a table."""
AHEAD = 2
"""Columns of a table before those of the rows that kernels take: kind and corners."""
BOUND, MIDDLE, OWN = RADIUS - AHEAD, CENTRE - AHEAD, DETAILS - AHEAD
"""Columns of such a row: radius and centre of the bounding ball, and what its shape needs."""
LEAST_THICKNESS = 1e-5
"""m; ten times as deep as a contact."""
NEARLY_ZERO = 1e-9
"""m, or m/s: a shorter vector has no direction worth the name."""
_AZIMUTHS = 0.25 * math.pi * np.arange(8)
COS_AZIMUTH = tuple(np.cos(_AZIMUTHS).tolist())
SIN_AZIMUTH = tuple(np.sin(_AZIMUTHS).tolist())
"""Of the eight azimuths at which the cone of an obstacle in 3-D is seen, k · 45°."""


class Packed(NamedTuple):
    """An obstacle as the numbers of its row."""

    kind: int
    corners: int
    centre: tuple[float, ...]
    """Of its bounding ball, m."""
    radius: float
    """Of its bounding ball, m."""
    details: list[float]
    """What follows in the row."""


class Shape(Protocol):
    """An obstacle; a frozen dataclass whose fields are what files say of it."""

    @property
    def dim(self) -> int:
        """Dimension of the space it is in."""

    def packed(self) -> Packed:
        """Its row."""


class Outline(NamedTuple):
    """An obstacle of the plane, as pictures draw it."""

    centre: NDArray[np.float64]
    """(2,), m, of the bounding disc."""
    radius: float
    """m, of the bounding disc."""
    vertices: NDArray[np.float64]
    """(k, 2), m; none for a disc, which its bounding disc is."""


class Ball(NamedTuple):
    """A ball in 3-D, as pictures draw it."""

    centre: NDArray[np.float64]
    """(3,), m."""
    radius: float
    """m."""


class ShapeKind(NamedTuple):
    """All that is asked of one kind of shape. Kernels take the row and the number of corners of an
    obstacle first; points and vectors are triples, m, with z = 0 in the plane.
    """

    kind: int
    """Number of the kind in tables."""
    classes: dict[str, type[Any]]
    """What users make, by the names that files have for them."""
    surface: Callable[..., Any]
    """(row, corners, point) → signed distance ± min_q ‖p − q‖ over the surface, m, negative inside,
    and the outward unit normal at the nearest q."""
    entry: Callable[..., Any]
    """(row, corners, point p, way w, depth) → least s in [0, 1] at which p + s w meets the surface,
    if the way goes deeper in than ``depth``, m; else inf. A negative depth makes the obstacle
    fatter by so much."""
    normals: Callable[..., Any]
    """(row, corners, point) → two normals where the point touches it, which differ where it may
    slide either way; ``one_normal`` makes it of ``surface``."""
    edges: Callable[..., Any] | None = None
    """(row, corners, point) → unit bearings of the counter-clockwise and the clockwise edge, seen
    from a point outside; None for shapes of space alone."""
    cone: Callable[..., Any] | None = None
    """(row, corners, point, axes, out): boundary rays of the cone under which it is seen, at
    azimuths k · 45°, into (8, 3) ``out``; ``axes`` are u towards the centre, e at azimuth 0, u × e.
    None for shapes of the plane alone."""
    numbers: int = 0
    """Numbers that its row needs beyond the bounding ball, corners aside."""
    least_corners: int = 0
    """3 of polygons; 0 of what has none."""
    outline: Callable[[NDArray[np.float64], int], Outline] | None = None
    """(row, corners) → picture in the plane."""
    balls: Callable[[NDArray[np.float64]], list[Ball]] | None = None
    """row → picture in 3-D."""


def one_normal(surface: Callable[..., Any]) -> Any:
    """``normals`` of a shape without vertices: twice that of its surface."""

    @kernel
    def normals(row, corners, point):
        _, normal = surface(row, corners, point)
        return normal, normal

    return normals


@kernel(inline="code")
def centre_of_row(row):
    """Centre of the bounding ball, a triple, m."""
    return row[MIDDLE], row[MIDDLE + 1], row[MIDDLE + 2]


# ---- checks; every refusal says what would be right ---------------------------------------------


def check_point(kind: str, field: str, value: Any, dim: int) -> tuple[float, ...]:
    """A point of d finite numbers, as a tuple."""
    point = tuple(value) if is_sequence(value) else ()
    if len(point) != dim or not all(abs(real(x)) <= LARGEST for x in point):
        raise ValueError(
            f"obstacles: {field} {shown(value)} of a {kind} must be {dim} finite numbers, from "
            f"{-LARGEST:g} to {LARGEST:g} m"
        )
    return tuple(real(x) for x in point)


def check_radius(kind: str, value: Any, field: str = "radius") -> float:
    """A radius, or another thickness, that a contact 1 µm deep cannot pass through."""
    if not LEAST_THICKNESS <= real(value) <= LARGEST:
        raise ValueError(
            f"obstacles: {field} {shown(value)} of a {kind} must be finite and at least "
            f"{LEAST_THICKNESS:g} m, at most {LARGEST:g} m"
        )
    return float(value)


def check_range(kind: str, field: str, value: Any) -> tuple[float, float]:
    """Least and largest radius, or other length above zero, of a field."""
    pair = tuple(value) if is_sequence(value) else (value, value)
    if len(pair) != 2 or not real(pair[0]) <= real(pair[1]) <= LARGEST:
        raise ValueError(
            f"obstacles: {field} {shown(value)} of {_article(kind)} must be a pair (low, high), m, "
            f"with low <= high <= {LARGEST:g}"
        )
    return check_radius(kind, pair[0], field), float(pair[1])


def check_length(kind: str, field: str, value: Any) -> float:
    """A length that may be zero."""
    if not 0 <= real(value) <= LARGEST:
        raise ValueError(
            f"obstacles: {field} {shown(value)} of {_article(kind)} must be finite and at least "
            f"0 m, at most {LARGEST:g} m"
        )
    return float(value)


def _article(kind: str) -> str:
    return f"an {kind}" if kind[0] in "AEIO" else f"a {kind}"


def is_sequence(value: Any) -> bool:
    """Whether it is a sequence of anything but letters."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


# ---- directions and cones -----------------------------------------------------------------------


@kernel
def centre_direction(point, centre):
    """Unit vector u = (c − p)/‖c − p‖ from a point p towards a centre c, the x axis at the centre
    itself; and ‖c − p‖, m.
    """
    offset = subtract(centre, point)
    distance = norm(offset)
    if distance == 0.0:
        return X_AXIS, 0.0
    return (offset[0] / distance, offset[1] / distance, offset[2] / distance), distance


@kernel
def azimuth_axes(towards, net_bearing, axis_x, axis_y):
    """The unit vectors e (azimuth 0) and u × e across the direction u.

        e = (f − (fᵀu) u)/‖f − (fᵀu) u‖,   f the net bearing, m/s

    If that vanishes, the robot's local x axis takes the place of f, and then its y axis.
    """
    across = _across(net_bearing, towards)
    if norm(across) <= NEARLY_ZERO:
        across = _across(axis_x, towards)
    if norm(across) <= NEARLY_ZERO:
        across = _across(axis_y, towards)
    length = norm(across)
    e = (across[0] / length, across[1] / length, across[2] / length)
    return e, cross(towards, e)


@kernel
def _across(vector, direction):
    return combine(1.0, vector, -dot(vector, direction), direction)
