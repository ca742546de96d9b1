"""What the robots of a block see of obstacles, and how near they are."""

from typing import Any

import numpy as np

from ..compilation import chosen_by_type, inlined_kernel, inner_kernel
from ..equations.potential import net_bearings_of_arcs, net_bearings_of_links
from ..equations.shapes.balls import disc_edges
from ..equations.shapes.obstacles import (
    ABSENT,
    BALL,
    CENTRE,
    RADIUS,
    Balls,
    distance_to,
    silhouette_2d,
    silhouette_3d,
)
from ..equations.vectors import load, local_axis, to_local
from .link_kinds import arcs_of
from .links import load_links
from .memory import CLOSENESS, MIN_CLEARANCE, lane_count, read
from .worlds import world_of

_CLEARANCE_PENALTY = 4  # place in ``Constants.reward_weights``


@inlined_kernel
def load_balls(block, count, layout, obstacles, buffers):
    """Bring the bounding balls of a block's obstacles into lanes."""
    if obstacles is not None:
        lanes, d = lane_count(layout.width), len(layout.axes)
        for lane in range(count):
            team = block * lanes + lane
            for m in range(buffers.balls.shape[0]):
                kind, radius = obstacles.kinds[team, m], obstacles.shapes[team, m, RADIUS]
                for k in range(d):
                    place = obstacles.shapes[team, m, CENTRE + k]
                    buffers.balls[m, k * lanes + lane] = place
                buffers.balls[m, d * lanes + lane] = radius if kind != ABSENT else np.nan
                buffers.balls[m, (d + 1) * lanes + lane] = radius if kind == BALL else np.nan


@inlined_kernel
def sense_obstacles(
    block, count, layout, constants, teams, links, obstacles, results, buffers, hand
):
    """Silhouettes, clearances, the least clearance of the episode, and closeness for the reward."""
    lanes = lane_count(layout.width)
    first, n = block * lanes, hand.lengths.shape[0]
    if obstacles is None:
        # in one piece: the entries of a table would be filled one by one, without SIMD
        results.clearance.reshape(-1)[first * n : (first + count) * n] = np.inf
    else:
        _see_discs(block, count, layout, constants, teams, results, buffers, layout.axes)
        _see_others(
            block, count, layout, constants, teams, links, obstacles, results, buffers, hand
        )
        for lane in range(count):
            least = teams.statistics[block, MIN_CLEARANCE * lanes + lane]
            closeness = 0.0
            for i in range(n):
                clearance = results.clearance[first + lane, i]
                least = min(least, clearance)
                closeness += max(0.0, 1.0 - clearance / constants.obstacle_range)
            teams.statistics[block, MIN_CLEARANCE * lanes + lane] = least
            weighs = constants.reward_weights[_CLEARANCE_PENALTY] != 0.0
            buffers.tally[CLOSENESS * lanes + lane] = closeness if weighs else 0.0


@inlined_kernel
def _see_discs(block, count, layout, constants, teams, results, buffers, axes):
    """Discs in the plane, over lanes; what is seen of everything else is nothing after it."""
    lanes, n = lane_count(layout.width), buffers.action.shape[0]
    first = block * lanes
    disc, wide = buffers.disc, buffers.rows.shape[0] // n
    others = wide - constants.rows + constants.neighbour_slots
    if len(axes) == 2:
        for i in range(n):
            for lane in range(count):
                active = teams.merged_into[first + lane, i] == i
                disc[7 * lanes + lane] = constants.obstacle_range if active else -np.inf
            disc[:lanes] = np.inf
            row = i * wide + others
            for m in range(buffers.balls.shape[0]):
                _see_disc(layout, teams.positions[block, i], buffers.balls[m], disc)
                for edge in range(2):
                    bearing = disc[(1 + 3 * edge) * lanes :]
                    _turn_into(layout, bearing, teams.frames[block, i], buffers.rows[row + edge])
                row += 2
            for lane in range(count):
                active = disc[7 * lanes + lane] >= 0.0
                results.clearance[first + lane, i] = disc[lane] if active else np.inf
    else:
        for lane in range(count):
            for i in range(n):
                results.clearance[first + lane, i] = np.inf


@inlined_kernel
def _see_disc(layout, position, ball, out):
    """Bearings of the two edges of a disc in the global frame, zero where it is not seen.

    Args:
        layout: of the memory.
        position: (2·L,), m.
        ball: centre and radius of the bounding ball and radius of the disc, m; NaN where there is
            none.
        out: the distance to the nearest disc so far, which falls; then 2 numbers of the
            counter-clockwise edge and 1 unused, the same of the clockwise edge, and from how near
            the robot sees, m.
    """
    lanes = lane_count(layout.width)
    for lane in range(lanes):
        radius = ball[3 * lanes + lane]
        ax, ay, bx, by, distance = disc_edges(
            ball[lane] - position[lane], ball[lanes + lane] - position[lanes + lane], radius
        )
        gap = distance - radius
        seen = gap <= out[7 * lanes + lane]
        out[lane] = gap if gap < out[lane] else out[lane]
        out[lanes + lane] = ax if seen else 0.0
        out[2 * lanes + lane] = ay if seen else 0.0
        out[4 * lanes + lane] = bx if seen else 0.0
        out[5 * lanes + lane] = by if seen else 0.0


@inlined_kernel
def _turn_into(layout, bearing, frame, row):
    """Write bearings of the plane into a row of observations, in the robots' own frames."""
    for lane in range(lane_count(layout.width)):
        seen = to_local(
            read(frame, lane, layout.width, layout.entries),
            read(bearing, lane, layout.width, layout.axes),
        )
        row[2 * lane], row[2 * lane + 1] = seen[0] + 0.0, seen[1] + 0.0


# ---- what no lane function does -----------------------------------------------------------------


def _see_others(
    block: int,
    count: int,
    layout: Any,
    constants: Any,
    teams: Any,
    links: Any,
    obstacles: Any,
    results: Any,
    buffers: Any,
    hand: Any,
) -> None:
    if len(layout.axes) == 3 or not isinstance(obstacles, Balls):
        _see_one_by_one(
            block, count, layout, constants, teams, links, obstacles, results, buffers, hand
        )


@inlined_kernel
def _see_no_others(
    block, count, layout, constants, teams, links, obstacles, results, buffers, hand
):
    pass


@chosen_by_type(_see_others)
def _compiled_see_others(
    block, count, layout, constants, teams, links, obstacles, results, buffers, hand
):
    axes = layout.types[layout.fields.index("axes")]
    only_discs = axes.count == 2 and obstacles.instance_class is Balls
    chosen = _see_no_others if only_discs else _see_one_by_one

    def implementation(
        block, count, layout, constants, teams, links, obstacles, results, buffers, hand
    ):
        return chosen(
            block, count, layout, constants, teams, links, obstacles, results, buffers, hand
        )

    return implementation


@inner_kernel
def _see_one_by_one(
    block, count, layout, constants, teams, links, obstacles, results, buffers, hand
):
    """Polygons and capsules of the plane, and everything in space."""
    lanes, d = lane_count(layout.width), len(layout.axes)
    for lane in range(count):
        team = block * lanes + lane
        world = world_of(obstacles, team)
        if d == 2 and _only_discs(world):
            continue
        for i in range(hand.lengths.shape[0]):
            for k in range(d):
                hand.positions[i, k] = teams.positions[block, i, k * lanes + lane]
        if d == 3:
            found = load_links(block, lane, links, hand)
            listed = (hand.first[:found], hand.second[:found], hand.weights[:found])
            _net_bearings(hand.positions, listed, arcs_of(links, block), hand.here)
        for i in range(hand.lengths.shape[0]):
            active = teams.merged_into[team, i] == i
            _see_all(
                block,
                lane,
                i,
                active,
                layout,
                constants,
                teams,
                world,
                results,
                buffers,
                hand,
                layout.axes,
            )


@inlined_kernel
def _net_bearings(positions, listed, arcs, out):
    if arcs is not None:
        net_bearings_of_arcs(positions, arcs.weights, out)
    else:
        net_bearings_of_links(positions, listed, out)


@inner_kernel
def _only_discs(world):
    for m in range(world.kinds.shape[0]):
        if world.kinds[m] > BALL:
            return False
    return True


@inner_kernel
def _see_all(block, lane, i, active, layout, constants, teams, world, results, buffers, hand, axes):
    """All obstacles of one robot that ``_see_discs`` leaves out."""
    width, n = layout.width, hand.lengths.shape[0]
    team, wide = block * lane_count(width) + lane, buffers.rows.shape[0] // n
    others = wide - constants.rows + constants.neighbour_slots
    point, points = load(hand.positions[i]), hand.silhouette
    frame = read(teams.frames[block, i], lane, width, layout.entries)
    for m in range(world.kinds.shape[0]):
        if len(axes) == 2:
            if world.kinds[m] <= BALL:
                continue
        distance = distance_to(world, m, point) if active else np.inf
        results.clearance[team, i] = min(results.clearance[team, i], distance)
        seen = distance <= constants.obstacle_range
        if seen:
            if len(axes) == 2:
                silhouette_2d(world, m, point, points)
            else:
                f = load(hand.here[i])
                x, y = local_axis(frame, 0), local_axis(frame, 1)
                silhouette_3d(world, m, point, f, x, y, points)
        row = i * wide + others + m * points.shape[0]
        _store_silhouette(lane, row, seen, frame, points, buffers.rows)


@inner_kernel
def _store_silhouette(lane, first, seen, frame, points, rows):
    """Turn silhouette bearings into the local frame; an obstacle that is not seen is zero."""
    d = points.shape[1]
    for s in range(points.shape[0]):
        for axis in range(d):
            along = 0.0
            if seen:
                for k in range(d):
                    along += frame[k * d + axis] * points[s, k]
            rows[first + s, lane * d + axis] = along
