"""Random straight walls in 2-D, sampled in every episode by layout.

No layout encloses an area. Its pieces are disjoint and contractible: the U of a trap, both walls of
a corridor, the central cross of rooms and the outer part of each of their walls. Any number of such
pieces leaves the plane around them connected. Robots outside the walls can therefore always reach
each other. Boxes overlap by half their thickness or are disjoint, and need no skins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

from ..checks import format_limit, raise_invalid
from ..compilation import inner_kernel, kernel
from ..field_checks import names_unknown_fields
from ..field_docs import lists_fields
from ..field_repr import repr_of_changes
from ..physics.random_streams import uniform
from ..physics.vectors import load
from .obstacle_set import clear, clear_of_obstacles
from .polygon import POLYGON
from .shape import BOUND, MIDDLE, OWN, Drawn, Length, Range, Thickness

LAYOUTS = {"trap": 3, "corridor": 2, "rooms": 8}
"""Layout names with their number of boxes."""
TRAP, CORRIDOR, ROOMS = range(3)
"""Layout indices, in that order."""
BOX = 8  # numbers of the four vertices of a wall
# excess length of a wall over its door, in thicknesses: both pieces beside the door are walls
_LEAST_PIECES = 3.0
_TRIES = 1000
_NUMBERS = 15  # random numbers per trial: 3 for the pose, at most 3 for each of four walls


@lists_fields
@names_unknown_fields("WallField")
@dataclass(frozen=True)
class WallField(Drawn):
    """Walls of a layout, with position and angle sampled in every episode.

    A trap is a U. A corridor is two parallel walls. Rooms are the four quarters between four walls
    that meet in the middle, each with a door. No layout encloses an area, so every initial
    condition allows rendezvous. A robot that must not move away from the others, as under law (4),
    can get stuck.
    """

    layout: Literal["trap", "corridor", "rooms"]
    """"trap", "corridor" or "rooms"."""
    size: Range
    """Length range of each arm of the trap, or of each other wall, m."""
    opening: Range
    """Range of the mouth of the trap, the width of the corridor, or each door, m."""
    thickness: Thickness
    """Thickness of all walls, m."""
    region: Length
    """Edge length of the square about the origin in which the middle of the layout lies, m."""
    keep_out: Length
    """Minimum distance of initial positions to a surface, m."""

    numbers = BOX
    only_balls = False

    __repr__ = repr_of_changes

    def __post_init__(self) -> None:
        super().__post_init__()
        least = self.opening[1] + _LEAST_PIECES * self.thickness
        if self.layout == "rooms" and self.size[0] < least:
            wanted = (
                f"at least {format_limit(least)} m, so that a wall is left on both sides of a door"
            )
            raise_invalid("obstacles: WallField.size", self.size, wanted)

    def check_dim(self, dim: int) -> None:
        """Reject an unsupported dimension."""
        if dim == 3:
            raise_invalid("obstacles", self, "an ObstacleField in 3-D: walls are 2-D")

    @property
    def most(self) -> int:
        """Number of obstacles."""
        return LAYOUTS[self.layout]

    @property
    def rules(self) -> WallRules:
        """Sampling rules of an episode."""
        return WallRules(**{**vars(self), "layout": list(LAYOUTS).index(self.layout)})


class WallRules(NamedTuple):
    """Kernel representation of a ``WallField``, with the layout index."""

    layout: int
    size: tuple[float, float]
    opening: tuple[float, float]
    thickness: float
    region: float
    keep_out: float
    passage: float = 0.0  # no layout encloses an area


@kernel
def draw_walls(key, rules, starts, n_starts, world):
    """Sample the walls of one episode until they are clear of initial positions.

    After 1000 samples they are absent.
    """
    for trial in range(_TRIES):
        clear(world)
        _draw_layout(key, trial * _NUMBERS, rules, world)
        for i in range(n_starts):
            if not clear_of_obstacles(load(starts[i]), world, rules.keep_out):
                break
        else:
            return True
    clear(world)
    return False


@inner_kernel
def _between(bounds, key, counter):
    low, high = bounds
    return low + (high - low) * uniform(key, counter)


@inner_kernel
def _draw_layout(key, counter, rules, world):
    half = 0.5 * rules.region
    x = _between((-half, half), key, counter)
    y = _between((-half, half), key, counter + 1)
    turn = _between((0.0, 2.0 * math.pi), key, counter + 2)
    pose = (x, y, math.cos(turn), math.sin(turn))
    counter += 3
    if rules.layout == TRAP:
        _draw_trap(key, counter, rules, pose, world)
    elif rules.layout == CORRIDOR:
        _draw_corridor(key, counter, rules, pose, world)
    else:
        for k in range(4):
            _draw_wall_with_door(key, counter + 3 * k, rules, pose, world, 2 * k)
            pose = (x, y, -pose[3], pose[2])  # rotated by 90°


@inner_kernel
def _draw_trap(key, counter, rules, pose, world):
    """A U that opens along x, centred at the middle of the longer arm."""
    half = 0.5 * _between(rules.opening, key, counter)
    one = _between(rules.size, key, counter + 1)
    other = _between(rules.size, key, counter + 2)
    thick = rules.thickness
    bottom = -0.5 * max(one, other)
    # the arms extend through the bottom, so that there is no seam
    _put_box(world, 0, pose, (bottom - thick, bottom), (-half - thick, half + thick))
    _put_box(world, 1, pose, (bottom - thick, bottom + one), (half, half + thick))
    _put_box(world, 2, pose, (bottom - thick, bottom + other), (-half - thick, -half))


@inner_kernel
def _draw_corridor(key, counter, rules, pose, world):
    """Two walls along x, on either side of the middle."""
    half = 0.5 * _between(rules.opening, key, counter)
    thick = rules.thickness
    for k in range(2):
        end = 0.5 * _between(rules.size, key, counter + 1 + k)
        low = half if k == 0 else -half - thick
        _put_box(world, k, pose, (-end, end), (low, low + thick))


@inner_kernel
def _draw_wall_with_door(key, counter, rules, pose, world, m):
    """Wall from the middle along x as two obstacles, m and m + 1, with a door between them."""
    size = _between(rules.size, key, counter)
    door = _between(rules.opening, key, counter + 1)
    thick = rules.thickness
    # both pieces are at least as long as the walls are thick; so the outer one stays clear of the
    # walls on either side, and those in the middle overlap
    first = _between((1.5 * thick, size - door - thick), key, counter + 2)
    across = (-0.5 * thick, 0.5 * thick)
    _put_box(world, m, pose, (-0.5 * thick, first), across)
    _put_box(world, m + 1, pose, (first + door, size), across)


@inner_kernel
def _put_box(world, m, pose, along, across):
    """Make obstacle m a box with these ranges of x and y, transformed by the pose."""
    x, y, c, s = pose
    (x0, x1), (y0, y1) = along, across
    middle_x, middle_y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    world.kinds[m] = POLYGON
    world.corners[m] = 4
    world.shapes[m, BOUND] = 0.5 * math.hypot(x1 - x0, y1 - y0)
    world.shapes[m, MIDDLE] = x + c * middle_x - s * middle_y
    world.shapes[m, MIDDLE + 1] = y + s * middle_x + c * middle_y
    for k, (u, v) in enumerate(((x0, y0), (x1, y0), (x1, y1), (x0, y1))):  # counter-clockwise
        world.shapes[m, OWN + 2 * k] = x + c * u - s * v
        world.shapes[m, OWN + 2 * k + 1] = y + s * u + c * v
