"""What one robot and one obstacle are to each other: distance, normal, silhouette, crossing.

Pure numba functions of small arrays. An obstacle is one packed row (see ``obstacles.pack``):

    [number of vertices, radius, centre (d numbers), x0, y0, x1, y1, ...]

with -1 vertices for an absent slot, 0 for a disc or sphere, and at least 3, counter-clockwise, for
a convex polygon; a polygon's centre is its centroid and its radius the bounding one about it.
"""

import math

import numpy as np

from ..compilation import kernel

ABSENT, ROUND = -1, 0
"""First number of the row of an absent obstacle, and of a disc or sphere."""
COUNT, RADIUS, CENTRE = 0, 1, 2
"""Columns of a row; the vertices follow the d numbers of the centre."""

_FIRST_VERTEX = CENTRE + 2
_NEARLY_ZERO = 1e-9  # m, or m/s: a shorter vector has no direction worth the name
_AZIMUTHS = 0.25 * math.pi * np.arange(8)
_COS_AZIMUTH, _SIN_AZIMUTH = np.cos(_AZIMUTHS), np.sin(_AZIMUTHS)


@kernel
def dot(a, b):
    """Scalar product of two (d,) arrays."""
    total = 0.0
    for k in range(a.shape[0]):
        total += a[k] * b[k]
    return total


@kernel
def third(vector):
    """The z component of a (d,) array; 0 in the plane."""
    return vector[2] if vector.shape[0] == 3 else 0.0


@kernel
def first_crossing(offset, velocity, radius):
    """When a point that moves straight comes within a ball about the origin.

    The smallest s in [0, 1] with ‖offset + s velocity‖ ≤ radius.

    Args:
        offset: (d,), from the centre of the ball to the point, m.
        velocity: (d,), m per unit of s.
        radius: of the ball, m.

    Returns:
        s; 0.0 if the point is within from the start, inf if it never is.
    """
    return _crossing(
        offset[0], offset[1], third(offset), velocity[0], velocity[1], third(velocity), radius
    )


@kernel
def ball_crossing(obstacle, position, velocity, radius):
    """``first_crossing`` of the ball of a radius, m, about the centre of an obstacle."""
    x, y = position[0] - obstacle[CENTRE], position[1] - obstacle[CENTRE + 1]
    z = position[2] - obstacle[CENTRE + 2] if position.shape[0] == 3 else 0.0
    return _crossing(x, y, z, velocity[0], velocity[1], third(velocity), radius)


@kernel
def _crossing(x, y, z, vx, vy, vz, radius):
    distance = math.sqrt(x * x + y * y + z * z)
    if distance <= radius:
        return 0.0
    approach = -(x * vx + y * vy + z * vz)
    speed_squared = vx * vx + vy * vy + vz * vz
    if approach <= 0.0 or radius < 0.0 or speed_squared == 0.0:
        return np.inf
    nearest = approach / speed_squared
    nx, ny, nz = x + nearest * vx, y + nearest * vy, z + nearest * vz
    miss = math.sqrt(nx * nx + ny * ny + nz * nz)
    if miss > radius:
        return np.inf
    # the smaller root of the quadratic, as c / (-b + √(b² - ac)): no difference of near equals
    root = math.sqrt(speed_squared * (radius - miss) * (radius + miss))
    s = (distance - radius) * (distance + radius) / (approach + root)
    return s if s <= 1.0 else np.inf


@kernel
def centre_distance(obstacle, position):
    """Distance from a position to the centre of an obstacle, m."""
    total = 0.0
    for k in range(position.shape[0]):
        difference = position[k] - obstacle[CENTRE + k]
        total += difference * difference
    return math.sqrt(total)


@kernel
def obstacle_distance(obstacle, position):
    """Signed distance from a position to the surface of an obstacle.

    Args:
        obstacle: (width,) packed row.
        position: (d,), m.

    Returns:
        Distance in m, negative inside; inf for an absent slot.
    """
    if obstacle[COUNT] == ROUND:
        return centre_distance(obstacle, position) - obstacle[RADIUS]
    if obstacle[COUNT] < 0:
        return np.inf
    distance, _, _ = _nearest_of_polygon(obstacle, position)
    return distance


@kernel
def clear_of_obstacles(position, obstacles, margin):
    """Whether a position is at least ``margin`` (m, signed) from every surface.

    Args:
        position: (d,), m.
        obstacles: (M, width) packed rows.
        margin: least signed distance, m.
    """
    for m in range(obstacles.shape[0]):
        if obstacle_distance(obstacles[m], position) < margin:
            return False
    return True


@kernel
def outward_normal(obstacle, position, out):
    """Unit normal of an obstacle at the surface point nearest to a position.

    On a polygon's vertex, where there is no one normal, it is that of an adjacent edge; at the
    centre of a disc or sphere it is the x axis.

    Args:
        obstacle: (width,) packed row of an obstacle that is there.
        position: (d,), m, in, on or outside the obstacle.
        out: (d,) array for the normal.
    """
    if obstacle[COUNT] > 0:
        _, out[0], out[1] = _nearest_of_polygon(obstacle, position)
        return
    distance = centre_distance(obstacle, position)
    for k in range(out.shape[0]):
        if distance > 0.0:
            out[k] = (position[k] - obstacle[CENTRE + k]) / distance
        else:
            out[k] = 1.0 if k == 0 else 0.0


@kernel
def polygon_edge(obstacle, k):
    """Edge k of a polygon: its first vertex (x, y), unit direction (ex, ey) and length, m.

    The outward normal is (ey, -ex), because the vertices go round counter-clockwise.
    """
    here = _FIRST_VERTEX + 2 * k
    there = here + 2 if k + 1 < int(obstacle[COUNT]) else _FIRST_VERTEX
    x, y = obstacle[here], obstacle[here + 1]
    dx, dy = obstacle[there] - x, obstacle[there + 1] - y
    length = math.sqrt(dx * dx + dy * dy)
    return x, y, dx / length, dy / length, length


@kernel
def _nearest_of_polygon(obstacle, position):
    """Signed distance to a convex polygon and its unit normal there, (distance, nx, ny).

    The plane falls into the inside, one strip before each edge and one wedge before each vertex.
    """
    highest, normal_x, normal_y = -np.inf, 0.0, 0.0
    nearest, vertex_x, vertex_y = np.inf, 0.0, 0.0
    for k in range(int(obstacle[COUNT])):
        x, y, ex, ey, length = polygon_edge(obstacle, k)
        dx, dy = position[0] - x, position[1] - y
        along, height = dx * ex + dy * ey, dx * ey - dy * ex
        if height > 0.0 and 0.0 <= along <= length:
            return height, ey, -ex
        if height > highest:
            highest, normal_x, normal_y = height, ey, -ex
        squared = dx * dx + dy * dy
        if squared < nearest:
            nearest, vertex_x, vertex_y = squared, dx, dy
    if highest <= 0.0:
        return highest, normal_x, normal_y
    distance = math.sqrt(nearest)
    if distance > _NEARLY_ZERO:
        normal_x, normal_y = vertex_x / distance, vertex_y / distance
    return distance, normal_x, normal_y


@kernel
def silhouette_2d(obstacle, position, out):
    """Bearings of the two edges of an obstacle, as seen from a position outside it.

    On the surface they are the two directions along it.

    Args:
        obstacle: (width,) packed row of a disc or polygon.
        position: (2,), m.
        out: (2, 2) array for unit vectors in the global frame: first the counter-clockwise edge,
            then the clockwise one.
    """
    if obstacle[COUNT] == ROUND:
        _silhouette_of_disc(obstacle, position, out)
    else:
        _silhouette_of_polygon(obstacle, position, out)


@kernel
def _half_angle(distance, radius):
    """Cosine and sine of half the angle under which a ball is seen: sin α = R / distance."""
    if distance <= radius:
        return 0.0, 1.0
    return math.sqrt((distance - radius) * (distance + radius)) / distance, radius / distance


@kernel
def _centre_direction(obstacle, position):
    """Unit vector (x, y, z) towards the centre, and the distance; the x axis at the centre."""
    distance = centre_distance(obstacle, position)
    if distance == 0.0:
        return 1.0, 0.0, 0.0, 0.0
    x = (obstacle[CENTRE] - position[0]) / distance
    y = (obstacle[CENTRE + 1] - position[1]) / distance
    z = (obstacle[CENTRE + 2] - position[2]) / distance if position.shape[0] == 3 else 0.0
    return x, y, z, distance


@kernel
def disc_edges(x, y, radius):
    """Bearings of both edges of a disc: the offset o of its centre turned by ± α.

        (√(o² − R²) o ± R o^⊥) / o²

    On the surface, or inside, they are the two directions across o. Written without branches, for
    loops over lanes.

    Args:
        x: of the centre, seen from the robot, m.
        y: likewise.
        radius: R, m.

    Returns:
        x and y of the counter-clockwise edge, of the clockwise edge, and the distance of the
        centre, m.
    """
    distance = math.sqrt(x * x + y * y)
    along = distance if distance > 0.0 else 1.0
    x = x if distance > 0.0 else 1.0
    square = (along - radius) * (along + radius)
    per_square = 1.0 / (along * along)
    c = math.sqrt(square if square > 0.0 else 0.0) * per_square
    s = (radius if radius < along else along) * per_square
    return c * x - s * y, s * x + c * y, c * x + s * y, c * y - s * x, distance


@kernel
def _silhouette_of_disc(obstacle, position, out):
    x, y = obstacle[CENTRE] - position[0], obstacle[CENTRE + 1] - position[1]
    out[0, 0], out[0, 1], out[1, 0], out[1, 1], _ = disc_edges(x, y, obstacle[RADIUS])


@kernel
def _silhouette_of_polygon(obstacle, position, out):
    """The vertices farthest to the left and to the right of the direction to the centroid."""
    centre_x, centre_y, _, _ = _centre_direction(obstacle, position)
    left_x, left_y = centre_x, centre_y
    right_x, right_y = centre_x, centre_y
    for k in range(int(obstacle[COUNT])):
        x = obstacle[_FIRST_VERTEX + 2 * k] - position[0]
        y = obstacle[_FIRST_VERTEX + 2 * k + 1] - position[1]
        if x * x + y * y < _NEARLY_ZERO * _NEARLY_ZERO:
            continue  # the robot stands on this vertex: its neighbours are the silhouette
        if centre_x * y - centre_y * x > 0.0:
            if left_x * y - left_y * x > 0.0:
                left_x, left_y = x, y
        elif right_x * y - right_y * x < 0.0:
            right_x, right_y = x, y
    left = math.sqrt(left_x * left_x + left_y * left_y)
    right = math.sqrt(right_x * right_x + right_y * right_y)
    out[0, 0], out[0, 1] = left_x / left, left_y / left
    out[1, 0], out[1, 1] = right_x / right, right_y / right


@kernel
def silhouette_3d(obstacle, position, net_bearing, axis_x, axis_y, out):
    """Boundary rays of the cone under which a sphere is seen, at eight azimuths φ = k · 45°.

        ray = cos α u + sin α (cos φ e + sin φ u × e),   sin α = R / distance

    with u the direction to the centre and e, azimuth 0, the part of the net bearing that is
    perpendicular to u; if that vanishes, of axis_x, and then of axis_y.

    Args:
        obstacle: (width,) packed row of a sphere.
        position: (3,), m, outside the sphere or on it.
        net_bearing: f, (3,), m/s, in the global frame.
        axis_x: (3,), the robot's local x axis in the global frame.
        axis_y: (3,), its y axis.
        out: (8, 3) array for unit vectors in the global frame.
    """
    x, y, z, distance = _centre_direction(obstacle, position)
    c, s = _half_angle(distance, obstacle[RADIUS])
    ex, ey, ez, length = _perpendicular_part(net_bearing, x, y, z)
    if length <= _NEARLY_ZERO:
        ex, ey, ez, length = _perpendicular_part(axis_x, x, y, z)
    if length <= _NEARLY_ZERO:
        ex, ey, ez, length = _perpendicular_part(axis_y, x, y, z)
    ex, ey, ez = ex / length, ey / length, ez / length
    wx, wy, wz = y * ez - z * ey, z * ex - x * ez, x * ey - y * ex
    for k in range(8):
        a, b = s * _COS_AZIMUTH[k], s * _SIN_AZIMUTH[k]
        out[k, 0] = c * x + a * ex + b * wx
        out[k, 1] = c * y + a * ey + b * wy
        out[k, 2] = c * z + a * ez + b * wz


@kernel
def _perpendicular_part(vector, x, y, z):
    """The part of a vector that is perpendicular to the unit vector (x, y, z), and its length."""
    along = vector[0] * x + vector[1] * y + vector[2] * z
    px, py, pz = vector[0] - along * x, vector[1] - along * y, vector[2] - along * z
    return px, py, pz, math.sqrt(px * px + py * py + pz * pz)
