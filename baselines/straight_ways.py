"""What stands in the way from one point of the plane to another."""

import math

import numpy as np

from rendezvous_env.compilation import kernel
from rendezvous_env.equations.obstacles import ABSENT, entry

_HALVINGS = 12
_TOUCH = 1e-7
"""m, less than the depth of a contact: so deep a way from the surface may go."""


@kernel
def margins_at(world, points, most, out):
    """How far ways from points can stay away from all obstacles.

    Args:
        world: Shapes of one team.
        points: (N, 2), m.
        most: what is enough, m.
        out: (N,), m; ``most``, or where a point is too near for that a half of it, a quarter, …
    """
    for i in range(len(points)):
        here, out[i] = (points[i, 0], points[i, 1], 0.0), -_TOUCH
        for halving in range(_HALVINGS):
            margin = most * 0.5**halving
            if not _in_the_way(world, here, (0.0, 0.0, 0.0), margin):
                out[i] = margin
                break


@kernel
def _in_the_way(world, here, way, margin):
    """Whether a way comes nearer to an obstacle; corners of polygons count as pointed."""
    for m in range(len(world.kinds)):
        if world.kinds[m] != ABSENT and entry(world, m, here, way, -margin) < np.inf:
            return True
    return False


@kernel
def straight_ways(world, points, targets, margins, out):
    """Lengths of the straight ways that keep away from all obstacles.

    Args:
        world: Shapes of one team.
        points: (N, 2), m.
        targets: (K, 2), m.
        margins: how far the ways from each point stay away from obstacles, (N,), m.
        out: (N, K), m; inf where an obstacle is in the way.
    """
    for i in range(len(points)):
        here = (points[i, 0], points[i, 1], 0.0)
        for k in range(len(targets)):
            way = (targets[k, 0] - here[0], targets[k, 1] - here[1], 0.0)
            out[i, k] = math.hypot(way[0], way[1])
            if _in_the_way(world, here, way, margins[i]):
                out[i, k] = np.inf
