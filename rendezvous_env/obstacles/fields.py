"""Random fields of discs or spheres, and the seam at which any kind of field enters a start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from ..checks import flag, is_whole, shown
from ..compilation import by_type, inner_kernel, kernel
from ..limits import MOST_OBSTACLES
from ..physics.random_streams import uniform
from ..physics.vectors import load
from .disc import BALL
from .obstacle_set import CENTRE, RADIUS, distance_to
from .reachability import none_walled_in
from .shape import ABSENT, check_length, check_range, is_sequence
from .walls import WallField, WallRules, draw_walls

_TRIES_PER_OBSTACLE = 1000


@dataclass(frozen=True)
class ObstacleField:
    """Discs (in the plane) or spheres (in 3-D), drawn anew for every episode."""

    count: int | tuple[int, int]
    """How many; a pair is an inclusive range to draw from."""
    radius: tuple[float, float]
    """Range that each radius is drawn from, m."""
    region: float
    """Edge length of the square or cube about the origin in which the centres lie, m."""
    keep_out: float
    """No robot starts nearer than this to a surface, m."""
    overlap: bool = True
    """Whether obstacles may overlap."""
    passage: float = 0.0
    """Every robot can reach every other through gaps at least this wide, m: a start where some are
    walled in is drawn again. 0, and always in 3-D: that is not looked at."""

    def __post_init__(self) -> None:
        low, high = _check_count(self.count)
        object.__setattr__(self, "count", low if is_whole(self.count) else (low, high))
        object.__setattr__(self, "radius", check_range("ObstacleField", "radius", self.radius))
        for field in ("region", "keep_out", "passage"):
            value = check_length("ObstacleField", field, getattr(self, field))
            object.__setattr__(self, field, value)
        if self.passage > 2 * self.keep_out:
            raise ValueError(
                f"obstacles: passage {shown(self.passage)} of an ObstacleField must be at most "
                f"twice keep_out, {2 * self.keep_out:g} m, or a start may lie within a gap"
            )
        flag("obstacles: overlap of an ObstacleField", self.overlap)

    @property
    def count_range(self) -> tuple[int, int]:
        """Least and largest number of obstacles."""
        return (self.count, self.count) if isinstance(self.count, int) else self.count

    @property
    def rules(self) -> FieldRules:
        """How the obstacles of an episode are drawn."""
        return FieldRules(
            counts=self.count_range,
            radii=self.radius,
            region=self.region,
            keep_out=self.keep_out,
            overlap=self.overlap,
            passage=self.passage,
        )


def _check_count(value: Any) -> tuple[int, int]:
    """Least and largest number of obstacles of a field."""
    pair = tuple(value) if is_sequence(value) else (value, value)
    whole = len(pair) == 2 and all(map(is_whole, pair))
    if not whole or not 0 <= pair[0] <= pair[1] <= MOST_OBSTACLES:
        raise ValueError(
            f"obstacles: count {shown(value)} of an ObstacleField must be a whole number, or a "
            f"pair (low, high) with 0 <= low <= high <= {MOST_OBSTACLES}"
        )
    return int(pair[0]), int(pair[1])


Field = ObstacleField | WallField
"""What draws the obstacles of every episode."""


class FieldRules(NamedTuple):
    """An ``ObstacleField`` as kernels take it: numbers and ranges by the same names, m."""

    counts: tuple[int, int]
    radii: tuple[float, float]
    region: float
    keep_out: float
    overlap: bool
    passage: float


@kernel
def draw_field(key, rules, starts, n_starts, world):
    """Draw the discs or spheres of one episode, as ``draw_obstacles`` says.

    A draw that comes too near to a start, or overlaps where it must not, is replaced by another. If
    an obstacle finds no place in 1000 tries, those from there on are absent.
    """
    d = starts.shape[1]
    world.kinds[:] = ABSENT
    world.corners[:] = 0
    world.shapes[:] = 0.0
    low, high = rules.counts
    count = low + int(uniform(key, 0) * (high - low + 1))
    counter = 1
    for m in range(count):
        placed = False
        for _ in range(_TRIES_PER_OBSTACLE):
            _draw_ball(key, counter, rules, d, world, m)
            counter += 1 + d
            if _keeps_out(world, m, starts, n_starts, rules.keep_out) and (
                rules.overlap or _apart(world, m)
            ):
                placed = True
                break
        if not placed:
            world.kinds[m] = ABSENT
            return False
    return True


@inner_kernel
def _draw_ball(key, counter, rules, d, world, m):
    low, high = rules.radii
    world.kinds[m] = BALL
    world.shapes[m, RADIUS] = low + (high - low) * uniform(key, counter)
    for k in range(d):
        place = rules.region * (uniform(key, counter + 1 + k) - 0.5)
        world.shapes[m, CENTRE + k] = place


@inner_kernel
def _keeps_out(world, m, starts, n_starts, keep_out):
    for i in range(n_starts):
        if distance_to(world, m, load(starts[i])) < keep_out:
            return False
    return True


@inner_kernel
def _apart(world, m):
    """Whether ball m overlaps none of those before it."""
    centre = load(world.shapes[m, CENTRE : CENTRE + 3])
    for other in range(m):
        if distance_to(world, other, centre) < world.shapes[m, RADIUS]:
            return False
    return True


# ---- any kind of field --------------------------------------------------------------------------


Rules = FieldRules | WallRules


@by_type("rules", lambda kind: draw_walls if kind is WallRules else draw_field)
def draw_obstacles(key, rules, starts, n_starts, world):
    """Draw the obstacles of one episode into ``world``, obstacles of one team; whether they found
    room, clear of the first ``n_starts`` of the starts (n, d), m.
    """


@kernel
def _walls_are_possible(rules, world, positions, chains):
    return True  # they close nothing in


@kernel
def _field_is_possible(rules, world, positions, chains):
    return rules.passage == 0.0 or none_walled_in(world, positions, rules.passage, chains)


@by_type("rules", lambda kind: _walls_are_possible if kind is WallRules else _field_is_possible)
def is_possible(rules, world, positions, chains):
    """Whether the robots, at positions (n, d), m, can reach one another, if the field promises
    that; ``chains`` is (M, 2) int64 working memory.
    """
