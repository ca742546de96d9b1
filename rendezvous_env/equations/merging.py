"""Neighbours that come within the merge radius become one robot (theory 5), for one team at a
time.
"""

import numpy as np

from ..compilation import kernel
from ..guarantee.lyapunov import square_distance, team_lyapunov
from .geometry import clear_of_obstacles, first_crossing


@kernel
def merge_swept(positions, displacements, lengths, weights, merged_into, obstacles, radius, report):
    """Move one team by its displacements and merge whom the motion brings together.

    Pairs merge at the first moment of the motion when their distance falls to r, earliest first and
    then by index; both rest for what is left of the step. Afterwards pairs that stand closer than r
    merge, nearest first, until none is left.

    Args:
        positions: (n, d), m; the start of the motion on entry, its end on return.
        displacements: (n, d), m; straight or the chord of an arc. Overwritten.
        lengths: (n,) of the paths, m; shortened for robots that rest.
        weights: (n, n), m/s; contracted in place.
        merged_into: (n,), index of the robot that each one is now part of; updated in place.
        obstacles: (M, width) packed obstacles, in which no merged robot may be placed.
        radius: r, m.
        report: (4,) V just before the first merge, V just after the last, the largest rise of V at
            a merge, and its largest excess over the bound of theory 5, all m²/s. The first entry
            stays as it is when nothing merges.

    Returns:
        Number of merges.
    """
    n, d = positions.shape
    resting = np.zeros(n, dtype=np.bool_)
    crossings = _first_crossings(positions, displacements, weights, radius)
    here = np.empty((n, d))
    merges = 0
    while True:
        moment, i, j = _earliest(crossings, resting)
        if moment > 1.0:
            break
        for k in range(n):
            share = 0.0 if resting[k] else moment
            for axis in range(d):
                here[k, axis] = positions[k, axis] + share * displacements[k, axis]
        _merge(i, j, here, weights, merged_into, obstacles, radius, merges, report)
        merges += 1
        for robot in (i, j):
            resting[robot] = True
            positions[robot] = here[robot]
            displacements[robot] = 0.0
            lengths[robot] *= moment
    for k in range(n):
        for axis in range(d):
            positions[k, axis] += displacements[k, axis]
    while True:
        i, j = _nearest_within(positions, weights, radius)
        if i < 0:
            return merges
        _merge(i, j, positions, weights, merged_into, obstacles, radius, merges, report)
        merges += 1


@kernel
def _first_crossings(positions, displacements, weights, radius):
    """When each pair of neighbours first stands within r of each other, as a share of the
    motion.
    """
    n, d = positions.shape
    crossings = np.full((n, n), np.inf)
    offset, velocity = np.empty(d), np.empty(d)
    for i in range(n):
        for j in range(i + 1, n):
            if weights[i, j] > 0.0:
                for k in range(d):
                    offset[k] = positions[j, k] - positions[i, k]
                    velocity[k] = displacements[j, k] - displacements[i, k]
                crossings[i, j] = first_crossing(offset, velocity, radius)
    return crossings


@kernel
def _earliest(crossings, resting):
    n = resting.shape[0]
    moment, first, second = np.inf, -1, -1
    for i in range(n):
        for j in range(i + 1, n):
            if crossings[i, j] < moment and not (resting[i] or resting[j]):
                moment, first, second = crossings[i, j], i, j
    return moment, first, second


@kernel
def _nearest_within(positions, weights, radius):
    n = positions.shape[0]
    nearest, first, second = radius * radius, -1, -1
    for i in range(n):
        for j in range(i + 1, n):
            if weights[i, j] > 0.0:
                square = square_distance(positions, i, j)
                if square < nearest:
                    nearest, first, second = square, i, j
    return first, second


@kernel
def _merge(i, j, positions, weights, merged_into, obstacles, radius, earlier_merges, report):
    """Make j part of i, i < j, and report what that does to V."""
    before = team_lyapunov(positions, weights)
    at_midpoint = _place(i, j, positions, obstacles)
    bound = radius * max(0.0, _pull_at_merge(i, j, weights, at_midpoint) - 4.0 * weights[i, j])
    _contract(i, j, weights, merged_into)
    after = team_lyapunov(positions, weights)
    if earlier_merges == 0:
        report[0] = before
    report[1] = after
    report[2] = max(report[2], after - before)
    report[3] = max(report[3], after - before - bound)


@kernel
def _place(i, j, positions, obstacles):
    """Put both at their midpoint, or at the place of the lower index if that lies in an
    obstacle.
    """
    d = positions.shape[1]
    midpoint = np.empty(d)
    for k in range(d):
        midpoint[k] = 0.5 * (positions[i, k] + positions[j, k])
    at_midpoint = clear_of_obstacles(midpoint, obstacles, 0.0)
    if at_midpoint:
        positions[i] = midpoint
    positions[j] = positions[i]
    return at_midpoint


@kernel
def _pull_at_merge(i, j, weights, at_midpoint):
    degree_i, degree_j = np.sum(weights[i]), np.sum(weights[j])
    return degree_i + degree_j if at_midpoint else 2.0 * max(degree_i, degree_j)


@kernel
def _contract(i, j, weights, merged_into):
    """The neighbours of i become those of both; a weight is the larger of the two (assumption
    2).
    """
    n = weights.shape[0]
    for k in range(n):
        if k != i and k != j:
            weights[i, k] = max(weights[i, k], weights[j, k])
            weights[k, i] = weights[i, k]
        weights[j, k] = 0.0
        weights[k, j] = 0.0
        if merged_into[k] == j:
            merged_into[k] = i
