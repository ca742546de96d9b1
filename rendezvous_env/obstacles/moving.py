"""Description of a moving obstacle, and the tables of all of them for kernels."""

from __future__ import annotations

import itertools
import math
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import flag, is_sequence, number, positive, raise_invalid
from ..field_checks import names_unknown_fields
from ..field_docs import lists_fields
from ..field_repr import repr_of_changes
from . import shape
from .capsule import Capsule
from .disc import Disc, Sphere
from .polygon import Polygon
from .shape import AHEAD, MIDDLE

Still = Disc | Sphere | Polygon | Capsule
"""Shapes that a moving obstacle can have."""
STILL, STEADY, WAYPOINTS, WALK = range(4)
"""Kinds of motion."""
_FIRST = "the obstacle's place: a time of 0 s and zeros"
_MODES = "velocity, waypoints or speed"


def _check_shape(field: str, value: Any) -> Still:
    if not isinstance(value, Still):
        raise_invalid(field, value, "a Disc, Polygon, Capsule or Sphere")
    return value


def _check_vector(field: str, value: Any) -> tuple[float, ...]:
    return shape.check_point(field, value, 3 if is_sequence(value) and len(value) == 3 else 2)


def _check_waypoints(field: str, value: Any) -> tuple[tuple[float, ...], ...]:
    """Validated rows of a time, s, and a displacement, m, by increasing time, the first zero."""
    wanted = "a list of two or more rows [time in s, displacement in m], first a row of zeros"
    if not is_sequence(value) or len(value) < 2:
        raise_invalid(field, value, wanted)
    rows: list[tuple[float, ...]] = []
    for k, row in enumerate(value):
        if not is_sequence(row) or len(row) not in (3, 4):
            raise_invalid(f"{field}[{k}]", row, "a time and a displacement, [t, x, y] or with z")
        rows.append(tuple(number(f"{field}[{k}][{c}]", x) for c, x in enumerate(row)))
        if k == 0 and any(rows[0]):
            raise_invalid(f"{field}[0]", row, _FIRST)
        if k and rows[k][0] <= rows[k - 1][0]:
            raise_invalid(f"{field}[{k}][0]", row[0], f"later than {rows[k - 1][0]:g} s")
    return tuple(rows)


def _check_box(field: str, value: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    corners = tuple(value) if is_sequence(value) else ()
    if len(corners) != 2:
        raise_invalid(field, value, "two corners, m, the lower and the upper one")
    low, high = (_check_vector(f"{field}[{k}]", corner) for k, corner in enumerate(corners))
    if len(low) != len(high) or any(a > b for a, b in zip(low, high, strict=True)):
        raise_invalid(field, value, "two corners, m, no component of the first above the second")
    return low, high


@lists_fields
@names_unknown_fields("Moving")
@dataclass(frozen=True)
class Moving(shape.Shape):
    """Obstacle that moves: with a constant velocity, along waypoints, or as a random walk.

        Moving(Disc((0.0, 0.0), 0.5), velocity=(0.3, 0.0))
        Moving(Disc((0.0, 0.0), 0.5), waypoints=((0, 0, 0), (4, 2, 0), (8, 0, 0)))
        Moving(Disc((0.0, 0.0), 0.5), speed=0.4, box=((-3, -3), (3, 3)))

    It does not rotate. Within a step it moves straight at constant speed. ``obstacle_push`` of the
    scenario selects whether it pushes robots or stops at them.

    Raises:
        ValueError: naming the field, its value and the remedy.
    """

    shape: Annotated[Still, _check_shape]
    """Disc, Polygon, Capsule or Sphere at its initial place."""
    _: KW_ONLY
    velocity: Annotated[tuple[float, ...], _check_vector] | None = None
    """Constant velocity, m/s."""
    waypoints: Annotated[tuple[tuple[float, ...], ...], _check_waypoints] | None = None
    """Rows of a time, s, and the displacement from the initial place, m; linear in between. The
    first is zero."""
    repeat: Annotated[bool, flag] = True
    """True if waypoints start again after the last one, which must then be zero, too; False if the
    obstacle stays there."""
    speed: Annotated[float, partial(positive, unit="m/s")] | None = None
    """Speed of a random walk, m/s: straight in a uniformly random direction, which is sampled again
    after each interval, and reflected at the box."""
    box: Annotated[tuple[tuple[float, ...], tuple[float, ...]], _check_box] | None = None
    """Lower and upper corner of the box in which a random walk keeps the obstacle's centre, m."""
    interval: Annotated[float, partial(positive, unit="s")] = 2.0
    """Time between two directions of a random walk, s."""

    __repr__ = repr_of_changes

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in ("velocity", "waypoints", "speed") if self._given(name)]
        name = "obstacles: Moving"
        if len(given) != 1:
            found = " and ".join(given) or "no motion"
            raise ValueError(f"{name} has {found}; give exactly one of {_MODES}")
        if self.velocity is not None and len(self.velocity) != self.dim:
            raise_invalid(f"{name}.velocity", self.velocity, f"{self.dim} numbers, m/s")
        if self.waypoints is not None:
            self._check_waypoints(name)
        if self.speed is None:
            if self.box is not None:
                raise_invalid(f"{name}.box", self.box, "omitted without speed")
            return
        if self.box is None or len(self.box[0]) != self.dim:
            raise_invalid(f"{name}.box", self.box, f"two corners of {self.dim} numbers, m")
        centre = self.packed()[shape.CENTRE : shape.CENTRE + self.dim]
        for low, x, high in zip(self.box[0], centre, self.box[1], strict=True):
            if not low <= x <= high:
                raise_invalid(f"{name}.box", self.box, f"around the centre, {centre}")

    def _given(self, name: str) -> bool:
        return getattr(self, name) is not None

    def _check_waypoints(self, name: str) -> None:
        assert self.waypoints is not None
        for k, row in enumerate(self.waypoints):
            if len(row) != 1 + self.dim:
                raise_invalid(f"{name}.waypoints[{k}]", row, f"{1 + self.dim} numbers")
        if self.repeat and any(self.waypoints[-1][1:]):
            wanted = "a displacement of zero, as the first, or pass repeat=False"
            raise_invalid(f"{name}.waypoints[{len(self.waypoints) - 1}]", row, wanted)

    @property
    def dim(self) -> int:
        """Dimension of the shape."""
        return self.shape.dim

    def packed(self) -> list[float]:
        """Table row of the shape at its initial place."""
        return self.shape.packed()

    @property
    def max_speed(self) -> float:
        """Highest speed of the obstacle, m/s."""
        if self.velocity is not None:
            return math.hypot(*self.velocity)
        if self.speed is not None:
            return self.speed
        pairs = itertools.pairwise(self.waypoints or ())
        return max(math.dist(a[1:], b[1:]) / (b[0] - a[0]) for a, b in pairs)


class Traffic(NamedTuple):
    """Motion of all obstacles of a scenario, for kernels."""

    kinds: NDArray[np.int64]  # (M,), STILL … WALK
    velocities: NDArray[np.float64]  # (M, 3), m/s
    walks: NDArray[np.float64]  # (M, 2), speed, m/s, and interval, s
    boxes: NDArray[np.float64]  # (M, 2, 3), corners, m
    times: NDArray[np.float64]  # (M, K), of waypoints, s; the last is repeated
    places: NDArray[np.float64]  # (M, K, 3), displacements at waypoints, m
    repeats: NDArray[np.bool_]  # (M,)
    base: NDArray[np.float64]  # (M, width), rows of the shapes at their initial places
    skins: NDArray[np.float64]  # (M,), m; 0 for obstacles that move
    pushes: bool  # Whether obstacles push robots, rather than stop at them


def moves(obstacles: Any) -> bool:
    """True if any obstacle of a scenario moves."""
    return isinstance(obstacles, tuple) and any(isinstance(one, Moving) for one in obstacles)


def moving_slots(obstacles: Any) -> list[int]:
    """Indices of the obstacles of a scenario that move."""
    return (
        [m for m, one in enumerate(obstacles) if isinstance(one, Moving)]
        if moves(obstacles)
        else []
    )


def walks(obstacles: Any) -> bool:
    """True if the motion of any obstacle is random."""
    return moves(obstacles) and any(getattr(one, "speed", None) is not None for one in obstacles)


def max_speed(obstacles: Any) -> float:
    """Bound on the speed of all obstacles in a step, m/s.

    An obstacle that has stopped on the chord of two waypoints returns to its path by at most twice
    its speed.
    """
    speeds = [
        one.max_speed * (1.0 if one.waypoints is None else 3.0)
        for one in (obstacles if moves(obstacles) else ())
        if isinstance(one, Moving)
    ]
    return max(speeds, default=0.0)


def traffic_of(obstacles: Any, table: NDArray[np.float64], skins: Any, pushes: bool) -> Traffic:
    """Motion of a scenario's obstacles, from their table (M, width) and skins (M,), m."""
    slots = len(table)
    most = max(
        (len(one.waypoints or ()) for one in obstacles if isinstance(one, Moving)), default=0
    )
    made = Traffic(
        kinds=np.zeros(slots, np.int64),
        velocities=np.zeros((slots, 3)),
        walks=np.zeros((slots, 2)),
        boxes=np.zeros((slots, 2, 3)),
        times=np.zeros((slots, max(most, 1))),
        places=np.zeros((slots, max(most, 1), 3)),
        repeats=np.zeros(slots, np.bool_),
        base=np.ascontiguousarray(table[:, AHEAD:]),
        skins=np.ascontiguousarray(skins),
        pushes=pushes,
    )
    for m, one in enumerate(obstacles):
        if not isinstance(one, Moving):
            continue
        d = one.dim
        if one.velocity is not None:
            made.kinds[m], made.velocities[m, :d] = STEADY, one.velocity
        elif one.waypoints is not None:
            rows = np.array(one.waypoints)
            made.kinds[m], made.repeats[m] = WAYPOINTS, one.repeat
            made.times[m], made.places[m, :, :d] = rows[-1, 0], rows[-1, 1:]
            made.times[m, : len(rows)], made.places[m, : len(rows), :d] = rows[:, 0], rows[:, 1:]
        else:
            assert one.box is not None
            made.kinds[m], made.walks[m] = WALK, (one.speed, one.interval)
            made.boxes[m, :, :d] = one.box
            made.boxes[m, :, :] -= made.base[m, MIDDLE : MIDDLE + 3]  # of displacements
    return made
