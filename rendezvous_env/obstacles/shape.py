"""Common interface of obstacle shapes: the protocol, input validation, and table rows.

    [kind, number of corners, radius of the bounding ball, centre x, y, z, …]

followed by the numbers of the shape; in 2-D z = 0. Kernels take kind and number of corners
separately, and the rest as the row. A new shape is a file like ``capsule`` that ends with a
``ShapeKind``. Add it to ``KINDS`` of ``obstacle_set`` and its class to ``Obstacle``.
"""

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import is_sequence, number, number_range, raise_invalid, to_float
from ..compilation import kernel
from ..field_checks import check_fields
from ..limits import LARGEST
from ..physics.vectors import X_AXIS, combine, cross, dot, norm, subtract

ABSENT = 0  # kind of an empty slot
KIND, CORNERS, RADIUS, CENTRE, DETAILS = 0, 1, 2, 3, 6
"""Columns of a table."""
AHEAD = 2  # columns of a table before those of the rows that kernels take: kind and corners
BOUND, MIDDLE, OWN = RADIUS - AHEAD, CENTRE - AHEAD, DETAILS - AHEAD
"""Columns of a kernel row: radius and centre of the bounding ball, and the numbers of the shape."""
CONTACT_DEPTH = 1e-6  # m; depth from which a path is a contact
SKIN = 2 * CONTACT_DEPTH  # m; distance of robots to shapes that only just meet
LEAST_THICKNESS = 1e-5  # m; ten times the contact depth, so no path passes through
NEARLY_ZERO = 1e-9  # m, or m/s; a shorter vector has no meaningful direction
_AZIMUTHS = 0.25 * math.pi * np.arange(8)
COS_AZIMUTH = tuple(np.cos(_AZIMUTHS).tolist())
SIN_AZIMUTH = tuple(np.sin(_AZIMUTHS).tolist())
"""Sines of the eight azimuths k · 45° of boundary rays in 3-D."""

Thickness = Annotated[float, partial(number, least=LEAST_THICKNESS, unit="m")]
Length = Annotated[float, partial(number, least=0.0, unit="m")]
Range = Annotated[tuple[float, float], partial(number_range, least=LEAST_THICKNESS, unit="m")]


def check_point(field: str, value: Any, dim: int) -> tuple[float, ...]:
    """Point of d finite numbers, as a tuple."""
    point = tuple(value) if is_sequence(value) else ()
    if len(point) != dim or not all(abs(to_float(x)) <= LARGEST for x in point):
        raise_invalid(field, value, f"{dim} finite numbers, from {-LARGEST:g} to {LARGEST:g} m")
    return tuple(to_float(x) for x in point)


class Drawn:
    """Frozen dataclass of obstacle settings, with the keys of files as fields."""

    def __post_init__(self) -> None:
        check_fields(self, f"obstacles: {type(self).__name__}.{{}}")


class Shape(Drawn):
    """Protocol of one obstacle."""

    @property
    def dim(self) -> int:
        """Dimension of the shape."""
        raise NotImplementedError

    def packed(self) -> list[float]:
        """Table row."""
        raise NotImplementedError


class Outline(NamedTuple):
    """Outline of an obstacle for drawings, or one of its balls in 3-D; m."""

    centre: NDArray[np.float64]  # (d,), of the bounding ball
    radius: float  # of the bounding ball
    vertices: NDArray[np.float64]  # (k, d); empty for a ball


def round_outlines(centres: Iterable[NDArray[np.float64]], radius: float) -> list[Outline]:
    """Discs or balls of one radius."""
    return [Outline(centre, float(radius), np.empty((0, len(centre)))) for centre in centres]


class ShapeKind(NamedTuple):
    """One kind of shape, as functions for kernels.

    Arguments start with row and number of corners. Points and vectors are triples, m, with z = 0 in
    2-D.
    """

    kind: int
    """Number of the kind in tables."""
    surface: Callable[..., Any]
    """(row, corners, point) → signed distance ± min_q ‖p − q‖ to the surface, m, negative
    inside, and the outward unit normal at the nearest q."""
    entry: Callable[..., Any]
    """(row, corners, point p, path w, depth, skin) → least s in [0, 1] at which p + s w meets
    the surface, or inf. A path no deeper inside than ``depth``, m, does not meet it. Negative
    depths and skins, m, enlarge the shape."""
    normals: Callable[..., Any]
    """(row, corners, point) → both normals at a touching point; they differ only on vertices."""
    outlines: Callable[[NDArray[np.float64], int, int], list[Outline]]
    """(row, corners, dimension) → outlines."""
    edges: Callable[..., Any] | None = None
    """(row, corners, point outside) → unit bearings of the counterclockwise and the clockwise
    edge; None for 3-D shapes."""
    cone: Callable[..., Any] | None = None
    """(row, corners, point, axes, out): boundary rays of its cone at azimuths k · 45°, into (8,
    3) ``out``. ``axes`` are u towards the centre, e at azimuth 0, u × e. None for 2-D shapes."""
    numbers: int = 0
    """Row entries beyond the bounding ball, without corners."""
    least_corners: int = 0
    """Minimum number of corners: 3 for polygons, 0 for shapes without corners."""


def one_normal(surface: Callable[..., Any]) -> Any:
    """``normals`` of a shape without vertices: the surface normal twice."""

    @kernel
    def normals(row, corners, point):
        _, normal = surface(row, corners, point)
        return normal, normal

    return normals


@kernel(inline="code")
def centre_of_row(row):
    """Centre of the bounding ball, a triple, m."""
    return row[MIDDLE], row[MIDDLE + 1], row[MIDDLE + 2]


@kernel
def centre_direction(point, centre):
    """Unit vector (c − p)/‖c − p‖ from a point to a centre, or the x axis."""
    offset = subtract(centre, point)
    distance = norm(offset)
    if distance == 0.0:
        return X_AXIS
    return offset[0] / distance, offset[1] / distance, offset[2] / distance


@kernel
def azimuth_axes(towards, net_bearing, axis_x, axis_y):
    """Unit vectors e (azimuth 0) and u × e perpendicular to the direction u.

        e = (f − (fᵀu) u)/‖f − (fᵀu) u‖,   f the net bearing, m/s

    If that vanishes, the robot's local x axis replaces f, and then its y axis.
    """
    for vector in (net_bearing, axis_x, axis_y):
        across = combine(1.0, vector, -dot(vector, towards), towards)
        if norm(across) > NEARLY_ZERO * max(1.0, norm(vector)):  # above rounding errors
            break
    length = norm(across)
    e = (across[0] / length, across[1] / length, across[2] / length)
    return e, cross(towards, e)
