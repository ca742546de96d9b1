"""Whether discs wall robots in, each from the others."""

from ...compilation import inner_kernel, kernel
from ...equations.shapes.obstacles import ABSENT, RADIUS, centre_of
from ...equations.shapes.separation import are_joined, crosses
from ...equations.vectors import load

_BEFORE, _SIDE = 0, 1
"""Columns of a disc's row: an earlier disc of its chain, itself if it is the first; and whether it
is on the other side than that one."""


@kernel
def none_walled_in(world, positions, passage, chains):
    """Whether every robot can reach every other through gaps at least ``passage`` (m) wide.

    Discs that leave less between them count as joined, see ``equations.separation``.

    Args:
        world: Balls of one team in the plane.
        positions: (n, 2), m, at least half a passage from every disc.
        passage: m.
        chains: (M, 2) int64, working memory.
    """
    for i in range(1, positions.shape[0]):
        if _apart(world, load(positions[0]), load(positions[i]), passage, chains):
            return False
    return True


@inner_kernel
def _apart(world, p, q, passage, chains):
    """Whether discs lie between two points: whether a chain contradicts itself about sides."""
    for m in range(world.kinds.shape[0]):
        chains[m, _BEFORE], chains[m, _SIDE] = m, 0
        if world.kinds[m] == ABSENT:
            continue
        for k in range(m):
            reach = world.shapes[k, RADIUS] + world.shapes[m, RADIUS] + passage
            a, b = centre_of(world, k), centre_of(world, m)
            if world.kinds[k] == ABSENT or not are_joined(a, b, reach):
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
    """The first disc of the chain that a disc is in, and on which side of it the disc is."""
    first, side = m, 0
    while chains[first, _BEFORE] != first:
        side ^= chains[first, _SIDE]
        first = chains[first, _BEFORE]
    chains[m, _BEFORE], chains[m, _SIDE] = first, side
    return first, side
