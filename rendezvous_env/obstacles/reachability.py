"""Reachability: test whether discs separate robots from each other.

Overlapping discs are connected by the segment of their centres. Two points p and q outside the
union lie in different components iff a closed chain of discs encloses exactly one of them. The
segments of such a chain cross the segment p q an odd number of times (Alexander duality modulo 2;
by the nerve theorem such chains find every hole). So p and q are connected if and only if every
disc can be given a side, 0 or 1, with this property: connected discs are on different sides exactly
if their segment crosses p q.
"""

from ..compilation import inner_kernel, kernel
from ..physics.vectors import load
from .shape import ABSENT, BOUND, centre_of_row

# columns of a disc's row: an earlier disc of its chain, itself for the first; and whether it is
# on the other side of that one
_BEFORE, _SIDE = 0, 1


@kernel
def all_reachable(world, positions, passage, chains):
    """True if every robot can reach every other through gaps at least ``passage``, m, wide.

    Positions, (n, 2), m, are at least half a passage from every disc; ``chains`` is (M, 2) int64
    working memory.
    """
    for i in range(1, positions.shape[0]):
        if _apart(world, load(positions[0]), load(positions[i]), passage, chains):
            return False
    return True


@inner_kernel
def _apart(world, p, q, passage, chains):
    """True if discs separate two points: whether a chain has contradicting sides.

    Discs less than a passage apart count as connected.
    """
    for m in range(world.kinds.shape[0]):
        chains[m, _BEFORE], chains[m, _SIDE] = m, 0
        if world.kinds[m] == ABSENT:
            continue
        for k in range(m):
            reach = world.shapes[k, BOUND] + world.shapes[m, BOUND] + passage
            a, b = centre_of_row(world.shapes[k]), centre_of_row(world.shapes[m])
            x, y = b[0] - a[0], b[1] - a[1]
            if world.kinds[k] == ABSENT or not x * x + y * y < reach * reach:
                continue
            side = int(crosses(a, b, p, q))
            first, side_of_k = _first_of_chain(chains, k)
            other, side_of_m = _first_of_chain(chains, m)
            if first != other:
                chains[other, _BEFORE] = first
                chains[other, _SIDE] = side ^ side_of_k ^ side_of_m
            elif side != side_of_k ^ side_of_m:
                return True
    return False


@inner_kernel
def _first_of_chain(chains, m):
    """First disc of a disc's chain, and the side of the disc relative to it."""
    first, side = m, 0
    while chains[first, _BEFORE] != first:
        side ^= chains[first, _SIDE]
        first = chains[first, _BEFORE]
    chains[m, _BEFORE], chains[m, _SIDE] = first, side
    return first, side


@kernel
def _is_left(a, b, point):
    """True if a point is strictly to the left of the line from a to b."""
    return (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) > 0.0


@kernel
def crosses(a, b, p, q):
    """True if the segments a b and p q of the plane cross, each with its ends on both sides."""
    return _is_left(p, q, a) != _is_left(p, q, b) and _is_left(a, b, p) != _is_left(a, b, q)
