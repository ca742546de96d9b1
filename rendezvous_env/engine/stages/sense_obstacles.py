"""Stages that sense obstacles: 2-D discs in lanes, other shapes individually."""

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.edges import ARCS, load_links
from ...obstacles.disc import BALL, disc_edges
from ...obstacles.obstacle_set import (
    distance_to,
    silhouette_2d,
    silhouette_3d,
)
from ...obstacles.shape import BOUND, MIDDLE
from ...obstacles.spatial_index import nearest_group, square_distance
from ...physics.potential import net_bearings_of_arcs, net_bearings_of_links
from ...physics.vectors import load, local_axis, to_local
from ..memory import (
    CLEARANCE,
    CLOSENESS,
    MIN_CLEARANCE,
    lane_count,
    load_fields,
    load_point,
    load_positions,
    obstacles_of,
    read_row,
    write_row,
)

_FRAME, _ZERO = (0, 1, 2, 3), np.float32(0.0)
_LEFT, _RIGHT, _NEAREST, _REACH = 0, 2, 4, 5
"""Fields of a disc's observation in every lane, (6·L,): bearings of the counterclockwise and the
clockwise edge, zero if not visible; distance to the nearest disc so far, m; sensing range, m,
−inf for a merged robot."""


@kernel
def sense_discs(width, first, last, reach, own, robots, merged_into, discs, seen, rows, clearance):
    """Sense 2-D discs, over lanes, into the rows from ``own`` on; other shapes have zero rows.

    ``clearance``, (B, n), receives distances to the nearest disc, m; ``seen`` is working memory.
    """
    lanes, n = lane_count(width), robots.shape[1]
    for block in range(first, last):
        start = block * lanes
        count = min(lanes, len(merged_into) - start)
        for i in range(n):
            for lane in range(count):
                active = merged_into[start + lane, i] == i
                seen[_REACH * lanes + lane] = reach if active else -np.inf
            seen[_NEAREST * lanes : _REACH * lanes] = np.inf
            slot = own
            for m in range(discs.shape[1]):
                _see_disc(width, robots[block, i], discs[block, m], seen)
                row = rows[block - first, i]
                _turn_into(width, seen, _LEFT, robots[block, i], row[slot])
                _turn_into(width, seen, _RIGHT, robots[block, i], row[slot + 1])
                slot += 2
            for lane in range(count):
                active = seen[_REACH * lanes + lane] >= 0.0
                nearest = seen[_NEAREST * lanes + lane]
                clearance[start + lane, i] = nearest if active else np.inf


@inner_kernel(inline="code")
def _see_disc(width, robot, disc, seen):
    """Bearings of the two edges of a disc in the global frame."""
    lanes = lane_count(width)
    for lane in range(lanes):
        radius = disc[2 * lanes + lane]
        x, y = disc[lane] - robot[lane], disc[lanes + lane] - robot[lanes + lane]
        ax, ay, bx, by, distance = disc_edges(x, y, radius)
        gap = distance - radius
        near = gap <= seen[_REACH * lanes + lane]
        nearest = seen[_NEAREST * lanes + lane]
        seen[_NEAREST * lanes + lane] = gap if gap < nearest else nearest
        seen[_LEFT * lanes + lane] = ax if near else 0.0
        seen[(_LEFT + 1) * lanes + lane] = ay if near else 0.0
        seen[_RIGHT * lanes + lane] = bx if near else 0.0
        seen[(_RIGHT + 1) * lanes + lane] = by if near else 0.0


@inner_kernel(inline="code")
def _turn_into(width, seen, field, robot, row):
    """Write 2-D bearings into a row of observations, in the robots' local frames."""
    lanes = lane_count(width)
    for lane in range(lanes):
        bearing = seen[field * lanes + lane], seen[(field + 1) * lanes + lane]
        write_row(to_local(load_fields(robot, 2, lane, lanes, _FRAME), bearing), row, lane)


@kernel
def sense_shapes(
    axes,
    entries,
    lanes,
    first,
    last,
    reach,
    own,
    robots,
    merged_into,
    obstacles,
    links,
    silhouette,
    vectors,
    listed,
    weights,
    rows,
    clearance,
):
    """Sense 2-D polygons and capsules, and all 3-D shapes, into the rows from ``own`` on.

    Working memory: silhouette (S, d), vectors (3, n, d), listed (2, E) and weights (E,).
    """
    n, positions, net = robots.shape[1], vectors[0], vectors[1]
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            b = block * lanes + lane
            world = obstacles_of(obstacles, b)
            if len(axes) == 3:
                clearance[b] = np.inf
                load_positions(robots[block], lane, lanes, positions)
                _net_bearings(links, block, lane, positions, listed, weights, net)
            elif _has_discs_only(world):
                continue
            for i in range(n):
                active = merged_into[b, i] == i
                row = rows[block - first, i]
                _see_all(
                    axes, entries, lane, lanes, reach, own, active, robots[block, i], world,
                    net[i], row, clearance[b, i : i + 1], silhouette,
                )  # fmt: skip


@inner_kernel
def _net_bearings(links, block, lane, positions, listed, weights, out):
    n = positions.shape[0]
    if links.form == ARCS:
        net_bearings_of_arcs(positions, links.weights[block].reshape(n, n), out)
    else:
        count = load_links(links, block, lane, n, listed[0], listed[1], weights)
        found = listed[0, :count], listed[1, :count], weights[:count]
        net_bearings_of_links(positions, found, out)


@inner_kernel
def _has_discs_only(world):
    for m in range(world.kinds.shape[0]):
        if world.kinds[m] > BALL:
            return False
    return True


@inner_kernel
def _see_all(
    axes, entries, lane, lanes, reach, own, active, robot, world, net, row, clearance, silhouette
):
    """Sense all obstacles of one robot that ``sense_discs`` omits."""
    d, points = len(axes), silhouette.shape[0]
    point = load_point(robot, 0, lane, lanes, d)
    frame = load_fields(robot, d, lane, lanes, entries)
    for m in range(world.kinds.shape[0]):
        if len(axes) == 2:
            if world.kinds[m] <= BALL:
                continue
        distance = distance_to(world, m, point) if active else np.inf
        clearance[0] = min(clearance[0], distance)
        if distance <= reach:
            if len(axes) == 2:
                silhouette_2d(world, m, point, silhouette)
            else:
                x, y = local_axis(frame, 0), local_axis(frame, 1)
                silhouette_3d(world, m, point, load(net), x, y, silhouette)
        else:
            silhouette[:] = 0.0
        for s in range(points):
            bearing = to_local(frame, read_row(silhouette[s], 0, axes))
            write_row(bearing, row[own + m * points + s], lane)


@kernel
def sense_indexed(
    entries,
    first,
    last,
    reach,
    own,
    slots,
    robots,
    merged_into,
    obstacles,
    index,
    silhouette,
    listed,
    distances,
    rows,
    clearance,
):
    """Sense 2-D shapes by a spatial index of tables of obstacles, in blocks of one environment.

    The numbers are those of ``sense_discs`` and ``sense_shapes``; with fewer slots than obstacles,
    those that ``keep_nearest`` leaves. Working memory: silhouette (2, d), listed and distances
    (M,).
    """
    for b in range(first, last):
        table = index.source[b]
        world = obstacles_of(obstacles, table)
        for i in range(robots.shape[1]):
            row, nearest = rows[b - first, i], np.inf
            numbers = row[own : own + 2 * slots].reshape(-1)
            for k in range(len(numbers)):  # one loop, which becomes SIMD
                numbers[k] = _ZERO
            if merged_into[b, i] == i:
                point = load_point(robots[b, i], 0, 0, 1, 2)
                nearest, count = _find_near(
                    world, index, table, point, reach, slots, listed, distances
                )
                frame = load_fields(robots[b, i], 2, 0, 1, entries)
                for k in range(count):
                    m, place = listed[k], own + 2 * (listed[k] if slots >= len(listed) else k)
                    _see_edges(world, m, point, silhouette)
                    for s in range(2):
                        bearing = to_local(frame, (silhouette[s, 0], silhouette[s, 1]))
                        write_row(bearing, row[place + s], 0)
            clearance[b, i] = nearest


@inner_kernel
def _find_near(world, index, table, point, reach, slots, listed, distances):
    """List the obstacles in range, at most the nearest ``slots``, in their order.

    Returns the distance to the nearest obstacle, m, and the length of the list.
    """
    order, boxes, groups = index.order[table], index.boxes[table], index.groups[table]
    start, nearest, count = nearest_group(index, table, point), np.inf, 0
    for number in range(groups.shape[0]):  # the nearest group, then the others in their order
        g = start if number == 0 else number - 1 if number <= start else number
        if not square_distance(groups[g], point) <= max(reach, nearest) ** 2:
            continue
        for k in range(order.shape[1]):
            m = order[g, k]
            if m < 0 or not square_distance(boxes[g, k], point) <= max(reach, nearest) ** 2:
                continue
            gap = _gap(world, m, point)
            nearest = min(nearest, gap)
            if gap <= reach:
                distance = 0.0 if slots >= len(listed) else distance_to(world, m, point)
                count = _list_by_distance(m, distance, count, slots, listed, distances)
    for k in range(1, count if slots < len(listed) else 0):
        m, place = listed[k], k
        while place > 0 and listed[place - 1] > m:
            listed[place] = listed[place - 1]
            place -= 1
        listed[place] = m
    return nearest, count


@inner_kernel
def _list_by_distance(m, distance, count, slots, listed, distances):
    """Insert an obstacle into a list sorted by distance and index; returns the new length."""
    if slots >= len(listed):
        listed[count] = m
        return count + 1
    place = count
    while place > 0 and (
        distances[place - 1] > distance
        or (distances[place - 1] == distance and listed[place - 1] > m)
    ):
        if place < slots:
            listed[place], distances[place] = listed[place - 1], distances[place - 1]
        place -= 1
    if place < slots:
        listed[place], distances[place] = m, distance
    return min(count + 1, slots)


@inner_kernel
def _gap(world, m, point):
    """Distance to an obstacle, m; that to a disc as in ``sense_discs``."""
    if world.kinds[m] != BALL:
        return distance_to(world, m, point)
    shape = world.shapes[m]
    x, y, radius = shape[MIDDLE] - point[0], shape[MIDDLE + 1] - point[1], shape[BOUND]
    _, _, _, _, distance = disc_edges(x, y, radius)
    return distance - radius


@inner_kernel
def _see_edges(world, m, point, silhouette):
    """Bearings of both edges of an obstacle; those of a disc as in ``sense_discs``."""
    if world.kinds[m] != BALL:
        silhouette_2d(world, m, point, silhouette)
        return
    shape = world.shapes[m]
    x, y, radius = shape[MIDDLE] - point[0], shape[MIDDLE + 1] - point[1], shape[BOUND]
    ax, ay, bx, by, _ = disc_edges(x, y, radius)
    silhouette[0, 0], silhouette[0, 1] = ax, ay
    silhouette[1, 0], silhouette[1, 1] = bx, by


@kernel
def keep_nearest(obstacles, positions, observations, row, own, fitted, listed, distances):
    """Copy the rows of the nearest visible obstacles to observations with fewer slots.

    Rows of obstacles start at ``row`` of observations, (B, n, rows, d), and at ``own`` of
    ``fitted``. They stay in their order. Working memory: listed and distances, (slots,).
    """
    points = 2 if observations.shape[3] == 2 else 8
    for b in range(observations.shape[0]):
        world = obstacles_of(obstacles, b)
        for i in range(observations.shape[1]):
            rows, point, count = observations[b, i], load(positions[b, i]), 0
            for m in range(world.kinds.shape[0]):
                if _is_visible(rows, row + m * points, points):
                    distance = distance_to(world, m, point)
                    count = _keep_if_near(m, distance, count, listed, distances)
            for slot in range(count):
                for s in range(points):
                    for axis in range(rows.shape[1]):
                        number = rows[row + listed[slot] * points + s, axis]
                        fitted[b, i, own + slot * points + s, axis] = number


@inner_kernel
def _is_visible(rows, first, points):
    """True if any number of an obstacle's rows is not zero."""
    for s in range(points):
        for axis in range(rows.shape[1]):
            if rows[first + s, axis] != 0.0:
                return True
    return False


@inner_kernel
def _keep_if_near(m, distance, count, listed, distances):
    """Append an obstacle to a list in order, which loses the farthest one when it is full.

    Of equally far ones the last is lost. Returns the new count.
    """
    if count == len(listed):
        farthest = 0
        for k in range(1, count):
            if distances[k] >= distances[farthest]:
                farthest = k
        if not distance < distances[farthest]:
            return count
        for k in range(farthest, count - 1):
            listed[k], distances[k] = listed[k + 1], distances[k + 1]
        count -= 1
    listed[count], distances[count] = m, distance
    return count + 1


@kernel
def measure_clearance(lanes, first, last, reach, weighs, environments, clearance):
    """Minimum clearance, current and of the episode.

    Also closeness to obstacles, if it ``weighs`` in the reward.
    """
    for block in range(first, last):
        environment = environments[block]
        for lane in range(min(lanes, len(clearance) - block * lanes)):
            least, closeness = np.inf, 0.0
            for i in range(clearance.shape[1]):
                distance = clearance[block * lanes + lane, i]
                least = min(least, distance)
                closeness += max(0.0, 1.0 - distance / reach)
            before = environment[MIN_CLEARANCE * lanes + lane]
            environment[CLEARANCE * lanes + lane] = least
            environment[MIN_CLEARANCE * lanes + lane] = min(before, least)
            environment[CLOSENESS * lanes + lane] = closeness if weighs else 0.0
