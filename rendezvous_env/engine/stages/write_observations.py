"""Stages that write observations: rows of all lanes, and the proprioceptive row."""

import numpy as np

from ...compilation import inner_kernel, kernel
from ...robots.motion import constants_of_robot, proprioception
from ..memory import lane_count, load_fields
from ..memory.transposition import TILE, transpose_tile

_TOGETHER = 32  # rows that, with those of the other lanes, fit into the L1 cache


@kernel
def write_observations(width, axes, first, last, rows, observations):
    """Copy rows, (blocks, n, rows, L·d), to observations, (B, n, rows, d)."""
    lanes, n_rows = lane_count(width), rows.shape[1] * rows.shape[2]
    if len(axes) == 2:  # both numbers of a row are one of float64
        source = rows.view(np.float64).reshape(rows.shape[0], n_rows * lanes)
        target = observations.view(np.float64).reshape(observations.shape[0], n_rows)
        for block in range(first, last):
            part = target[block * lanes : (block + 1) * lanes]
            _transpose(lanes, source[block - first], part)
    else:
        source = rows.reshape(rows.shape[0], n_rows, 3 * lanes)
        target = observations.reshape(observations.shape[0], 3 * n_rows)
        for block in range(first, last):
            part = target[block * lanes : (block + 1) * lanes]
            _copy_triples(source[block - first], part)


@inner_kernel(inline="code")
def _transpose(lanes, source, target):
    """Copy rows, (rows·L,), to the environments of a block, (up to L, rows).

    The last tiles overlap others instead of being smaller.
    """
    count, n_rows = target.shape
    if count < TILE or n_rows < TILE:
        for row in range(n_rows):
            for lane in range(count):
                target[lane, row] = source[row * lanes + lane]
        return
    flat = target.reshape(target.size)
    for k in range(0, count, TILE):
        lane = min(k, count - TILE)
        for j in range(0, n_rows, TILE):
            row = min(j, n_rows - TILE)
            start, begin = row * lanes + lane, lane * n_rows + row
            transpose_tile(source, start, lanes, flat, begin, n_rows)


@inner_kernel(inline="code")
def _copy_triples(source, target):
    """Copy rows of three numbers, some adjacent ones of a lane at a time."""
    n_rows = len(source)
    for k in range(0, n_rows, _TOGETHER):
        for lane in range(len(target)):
            for row in range(k, min(k + _TOGETHER, n_rows)):
                for part in range(3):
                    target[lane, 3 * row + part] = source[row, 3 * lane + part]


@kernel
def write_packed(lanes, first, last, slots, links, rows, counts, observations, over):
    """Copy rows if there are fewer neighbour rows, ``slots``, than other robots.

    Rows of present neighbours come first, in index order, followed by the other rows. ``over``,
    (B,), receives a robot with more neighbours; ``counts``, (n,), is working memory.
    """
    n, d, others = rows.shape[1], observations.shape[3], observations.shape[2] - slots
    for block in range(first, last):
        row = rows[block - first]
        for lane in range(min(lanes, len(observations) - block * lanes)):
            b = block * lanes + lane
            seen = observations[b]
            seen[:] = 0.0
            counts[:] = 0
            for pair in range(links.first.shape[1]):
                if links.weights[block, pair, lane] > 0.0:
                    for end in range(2):
                        i, j = links.first[0, pair], links.second[0, pair]
                        robot, own = (j, i) if end else (i, j - 1)
                        slot = counts[robot]
                        counts[robot] = slot + 1
                        if slot >= slots:
                            over[b] = robot
                            continue
                        for k in range(d):
                            seen[robot, slot, k] = row[robot, own, d * lane + k]
            for robot in range(n):
                for other in range(others):
                    for k in range(d):
                        value = row[robot, n - 1 + other, d * lane + k]
                        seen[robot, slots + other, k] = value


@kernel
def sense_oneself(robot, lanes, first, last, robots, merged_into, observations):
    """Last row of models with proprioception; zero for inactive robots."""
    d = len(robot.axes)
    for block in range(first, last):
        for lane in range(min(lanes, len(merged_into) - block * lanes)):
            b = block * lanes + lane
            for i in range(robots.shape[1]):
                state = robots[block, i]
                seen = proprioception(
                    constants_of_robot(robot.model, robot.limits, i),
                    load_fields(state, d, lane, lanes, robot.entries),
                    load_fields(state, d + d * d, lane, lanes, robot.memories),
                )
                active, last_row = merged_into[b, i] == i, observations.shape[2] - 1
                for k in range(len(seen)):
                    observations[b, i, last_row, k] = seen[k] if active else 0.0
