"""Whether a robot sees a place: range, field of view, and what stands between."""

import math

from ..compilation import kernel
from ..obstacles.contact import CONTACT_DEPTH
from ..obstacles.obstacle_set import entry
from ..obstacles.shape import ABSENT
from ..physics.vectors import dot, square, triple


@kernel(inline="code")
def is_seen(offset, reach, half_field):
    """Whether a place lies within range and field of view.

        ‖offset‖ ≤ range   and   ∠(offset, x) ≤ field of view/2

    Args:
        offset: of the place from the robot in the robot's own frame, a pair or triple, m.
        reach: range, m; inf without a limit.
        half_field: half the field of view about the x axis, rad; π sees all round.
    """
    x, y, z = triple(offset)
    if square(offset) > reach * reach:
        return False
    # to find the angle takes as long as a step of a robot with an exact sensor
    return half_field >= math.pi or math.atan2(math.sqrt(y * y + z * z), x) <= half_field


@kernel
def is_hidden_by_obstacles(world, point, way):
    """Whether an obstacle stands between two places: the way between them goes into it, deeper than
    a contact does.

    Args:
        world: obstacles of one team.
        point: where the way begins, a triple, m.
        way: to the other place, a triple, m.
    """
    for m in range(world.kinds.shape[0]):
        if world.kinds[m] != ABSENT and entry(world, m, point, way, CONTACT_DEPTH) <= 1.0:
            return True
    return False


@kernel
def is_hidden_by_robot(offset, other, radius):
    """Whether a robot that is nearer hides another: the way to it goes through its disc or sphere.

    The nearest robot is always seen. A robot within the disc of another sees its far side only.

    Args:
        offset: of the robot that is looked at, from the one that looks, a triple, m.
        other: of the one between, likewise.
        radius: of its disc or sphere, m.
    """
    distance_squared, other_squared = dot(offset, offset), dot(other, other)
    along = dot(offset, other)
    if along <= 0.0 or other_squared >= distance_squared:
        return False
    return other_squared - along * along / distance_squared < radius * radius
