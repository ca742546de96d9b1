"""The obstacles of one episode, drawn from the stream of its field."""

from typing import NamedTuple

from ...compilation import inner_kernel, kernel
from ...equations.random_streams import uniform
from ...equations.shapes.obstacles import ABSENT, BALL, CENTRE, RADIUS, distance_to
from ...equations.vectors import load

_TRIES_PER_OBSTACLE = 1000


class FieldRules(NamedTuple):
    """A random field of discs or spheres."""

    counts: tuple[int, int]
    """Least and largest number of obstacles."""
    radii: tuple[float, float]
    """Least and largest radius, m."""
    region: float
    """Edge length of the square or cube about the origin that holds the centres, m."""
    keep_out: float
    """Least distance of a start from a surface, m."""
    overlap: bool
    """Whether obstacles may overlap."""
    passage: float
    """Width of the gaps that join all robots of a start, m; 0 if that is not looked at."""


@kernel
def draw_field(key, rules, starts, n_starts, world):
    """Draw the discs or spheres of one episode.

    A draw that comes too near to a start, or overlaps where it must not, is replaced by another.

    Args:
        key: random stream, uint64.
        rules: FieldRules.
        starts: (n, d) start positions, m; only the first ``n_starts`` count.
        n_starts: number of starts to keep clear of.
        world: Balls of one team, written to.

    Returns:
        False if an obstacle found no place in 1000 tries; those from there on are then absent.
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
