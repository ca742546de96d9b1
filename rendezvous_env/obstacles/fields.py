"""Random fields of discs or spheres, and the interface of all kinds of fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from ..checks import format_limit, is_int, is_sequence, raise_invalid
from ..compilation import by_type, inner_kernel, kernel
from ..field_checks import names_unknown_fields
from ..field_docs import lists_fields
from ..field_repr import repr_of_changes
from ..limits import MAX_OBSTACLES
from ..physics.random_streams import uniform
from ..physics.vectors import load
from .disc import BALL
from .obstacle_set import clear, distance_to
from .shape import ABSENT, BOUND, MIDDLE, Drawn, Length, Range
from .walls import WallField, WallRules, draw_walls

_TRIES_PER_OBSTACLE = 1000


def _check_count(field: str, value: Any) -> int | tuple[int, int]:
    pair = tuple(value) if is_sequence(value) else (value, value)
    whole = len(pair) == 2 and all(map(is_int, pair))
    if not whole or not 0 <= pair[0] <= pair[1] <= MAX_OBSTACLES:
        most = f"a pair (low, high) with 0 <= low <= high <= {MAX_OBSTACLES}"
        raise_invalid(field, value, f"an integer, or {most}")
    return int(value) if is_int(value) else (int(pair[0]), int(pair[1]))


@lists_fields
@names_unknown_fields("ObstacleField")
@dataclass(frozen=True)
class ObstacleField(Drawn):
    """Discs (2-D) or spheres (3-D), sampled in every episode.

        Scenario(obstacles=ObstacleField(4))

    The defaults suit the default ``spawn_size`` of 10 m.
    """

    count: Annotated[int | tuple[int, int], _check_count]
    """Number of obstacles; a pair is an inclusive range to sample from."""
    radius: Range = (0.5, 1.0)
    """Range of the sampled radii, m."""
    region: Length = 10.0
    """Edge length of the square or cube about the origin in which the centres lie, m."""
    keep_out: Length = 0.5
    """Minimum distance of initial positions to a surface, m."""
    overlap: bool = True
    """True if obstacles may overlap."""
    passage: Length = 0.0
    """Minimum passage width, m: initial conditions in which some robots cannot reach each other
    through such gaps are sampled again. 0 disables the check; 3-D requires 0."""

    numbers = 0
    only_balls = True

    __repr__ = repr_of_changes

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.passage > (widest := 2 * self.keep_out):
            wanted = (
                f"at most twice keep_out, {format_limit(widest)} m, or a robot may start in a gap"
            )
            raise_invalid("obstacles: ObstacleField.passage", self.passage, wanted)

    def check_dim(self, dim: int) -> None:
        """Reject an unsupported dimension."""
        if dim == 3 and self.passage > 0:
            wanted = "0 in 3-D; reachability is checked in the plane only"
            raise_invalid("obstacles: ObstacleField.passage", self.passage, wanted)

    @property
    def count_range(self) -> tuple[int, int]:
        """Minimum and maximum number of obstacles."""
        return (self.count, self.count) if isinstance(self.count, int) else self.count

    @property
    def most(self) -> int:
        """Maximum number of obstacles."""
        return self.count_range[1]

    @property
    def rules(self) -> FieldRules:
        """Sampling rules of an episode."""
        lengths = self.radius, self.region, self.keep_out
        return FieldRules(self.count_range, *lengths, self.overlap, self.passage)


Field = ObstacleField | WallField
"""Interface of obstacle fields that are sampled in every episode."""


class FieldRules(NamedTuple):
    """Kernel representation of an ``ObstacleField``."""

    counts: tuple[int, int]
    radius: tuple[float, float]
    region: float
    keep_out: float
    overlap: bool
    passage: float


@kernel
def draw_field(key, rules, starts, n_starts, world):
    """Sample the discs or spheres of one episode, with rejection.

    If 1000 samples of one do not fit, it and the following ones are absent. Seams stay open.
    """
    d = starts.shape[1]
    clear(world)
    least, most = rules.counts
    low, high = rules.radius
    count = least + int(uniform(key, 0) * (most - least + 1))
    counter = 1
    for m in range(count):
        world.kinds[m] = BALL
        placed = False
        for _ in range(_TRIES_PER_OBSTACLE):
            world.shapes[m, BOUND] = low + (high - low) * uniform(key, counter)
            for k in range(d):
                place = rules.region * (uniform(key, counter + 1 + k) - 0.5)
                world.shapes[m, MIDDLE + k] = place
            counter += 1 + d
            placed = _fits(world, m, rules, starts, n_starts)
            if placed:
                break
        if not placed:
            world.kinds[m] = ABSENT
            return False
    return True


@inner_kernel
def _fits(world, m, rules, starts, n_starts):
    """True if ball m is clear of initial positions and, if required, of earlier balls."""
    for i in range(n_starts):
        if distance_to(world, m, load(starts[i])) < rules.keep_out:
            return False
    if not rules.overlap:
        centre = load(world.shapes[m, MIDDLE : MIDDLE + 3])
        for other in range(m):
            if distance_to(world, other, centre) < world.shapes[m, BOUND]:
                return False
    return True


Rules = FieldRules | WallRules


@by_type("rules", lambda kind: draw_walls if kind is WallRules else draw_field)
def draw_obstacles(key, rules, starts, n_starts, world):
    """Sample the obstacles of one episode into ``world``, obstacles of one environment.

    Seams between discs or spheres stay open; see ``obstacle_set.close_seams``. Walls have none.

    Returns whether all fit, clear of the first ``n_starts`` initial positions (n, d), m.
    """
