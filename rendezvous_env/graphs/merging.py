"""Merging of neighbours within the merge radius (assumption 2, theory 5).

One environment at a time, given by its positions and links: ``first[e] < second[e]`` are the robots
of link e, ``weight[e]`` its a_ij in m/s. A superfluous link gets the weight 0; nothing is
allocated.

For directed links, a pair merges if either robot observes the other. A link then has the mean
weight of a_ij and a_ji, so that V of the links equals that of the arcs; ``arcs`` holds both.

By default robots merge through obstacles. Otherwise a pair without line of sight remains two
robots, nearer than r, until no obstacle is between them. The theorems about V (A, C, D and the
bounds on V) need links of r or more, and do not hold for such pairs.
"""

import numpy as np

from ..compilation import inner_kernel, kernel
from ..obstacles.obstacle_set import clear_of_obstacles, is_hidden_by_obstacles
from ..physics.crossings import first_crossing
from ..physics.potential import distance_squared, lyapunov_of_links
from ..physics.vectors import load, subtract


@kernel
def merge_swept(
    positions, displacements, lengths, links, arcs, merged_into, world, radius, work, through=True
):
    """Move one environment by its displacements and merge robots that meet (theory 5).

    Pairs merge at the first time when their distance decreases to r, earliest first and then by
    index. Both rest for the remaining step. Afterwards pairs closer than r merge, nearest first,
    until none is left.

    Args:
        positions: (n, d), m; the start of the motion on entry, its end on return.
        displacements: (n, d), m; straight or the chord of an arc. Overwritten.
        lengths: (n,), path lengths, m; shortened for robots that rest.
        links: (first, second, weight), each (E,); contracted in place.
        arcs: a_ij, (n, n), of directed links, contracted in place; (0, 0) or None for others.
        merged_into: (n,), robot that each one has become part of; updated in place.
        world: obstacles, in which no merged robot may be placed, or None.
        radius: r, m.
        work: working memory (times (E,), positions (n, d), resting (n,) bool), and a report, (4,).
            The report, m²/s: V just before the first merge (unchanged without one) and V just
            after the last; the largest increase of V at a merge, and its largest excess over
            theory 5.
        through: whether robots merge through obstacles.

    Returns:
        Number of merges.
    """
    moments, here, resting, report = work
    first, second, _ = links
    n, d = positions.shape
    resting[:] = False
    _meeting_moments(positions, displacements, links, radius, moments)
    merges = 0
    while True:
        e = _earliest(moments, first, second, resting)
        if e < 0:
            break
        # the times computed at the start stay valid: a robot whose links change rests from then on
        # V at a merge is that of the positions at its time, while others are still moving
        moment, i, j = moments[e], first[e], second[e]
        for k in range(n):
            share = 0.0 if resting[k] else moment
            for axis in range(d):
                here[k, axis] = positions[k, axis] + share * displacements[k, axis]
        if not _may_merge(i, j, here, world, through):
            moments[e] = np.inf
            continue
        _merge(e, here, links, arcs, merged_into, world, radius, merges == 0, report)
        merges += 1
        for robot in (i, j):
            resting[robot] = True
            lengths[robot] *= moment  # assumes constant speed, which holds except for accelerations
            for axis in range(d):
                positions[robot, axis] = here[robot, axis]
                displacements[robot, axis] = 0.0
    for k in range(n):
        for axis in range(d):
            positions[k, axis] += displacements[k, axis]
    # a midpoint or a resting robot may be nearer than r to others without a crossing
    while True:
        e = _nearest_within(positions, links, radius, world, through)
        if e < 0:
            return merges
        _merge(e, positions, links, arcs, merged_into, world, radius, merges == 0, report)
        merges += 1


@inner_kernel
def _meeting_moments(positions, displacements, links, radius, moments):
    """Time at which the robots of each link are first within r, as a fraction of the motion."""
    first, second, weight = links
    for e in range(len(first)):
        moments[e] = np.inf
        if weight[e] > 0.0:
            i, j = first[e], second[e]
            offset = subtract(load(positions[j]), load(positions[i]))
            velocity = subtract(load(displacements[j]), load(displacements[i]))
            moments[e] = first_crossing(offset, velocity, radius)


@inner_kernel
def _comes_before(first, second, e, best):
    """True if the robots of link e precede those of another one by index; −1 is none."""
    # by robots, not by e: a contraction leaves the links unsorted, and ties must not depend on that
    if best < 0 or first[e] != first[best]:
        return best < 0 or first[e] < first[best]
    return second[e] < second[best]


@inner_kernel
def _earliest(moments, first, second, resting):
    """Link whose robots meet first, of those with both robots moving; −1 without one."""
    moment, best = np.inf, -1
    for e in range(len(first)):
        if moments[e] <= moment and moments[e] <= 1.0:
            if not (resting[first[e]] or resting[second[e]]):
                if moments[e] < moment or _comes_before(first, second, e, best):
                    moment, best = moments[e], e
    return best


@inner_kernel
def _may_merge(i, j, positions, world, through):
    """True if merges go through obstacles, or none is between two robots."""
    if world is not None:
        if not through:
            here = load(positions[i])
            return not is_hidden_by_obstacles(world, here, subtract(load(positions[j]), here))
    return True


@inner_kernel
def _nearest_within(positions, links, radius, world, through):
    """Shortest link below r that may merge; −1 without one."""
    first, second, weight = links
    nearest, best = radius * radius, -1
    for e in range(len(first)):
        if weight[e] > 0.0:
            square = distance_squared(positions, first[e], second[e])
            if square < nearest or (
                square == nearest and best >= 0 and _comes_before(first, second, e, best)
            ):
                if _may_merge(first[e], second[e], positions, world, through):
                    nearest, best = square, e
    return best


@inner_kernel
def _merge(e, positions, links, arcs, merged_into, world, radius, is_first, report):
    """Merge the second robot of link e into the first, and report the change of V."""
    first, second, weight = links
    i, j, gain = first[e], second[e], weight[e]
    before = lyapunov_of_links(positions, links)
    at_midpoint = _place(i, j, positions, world)
    # the bound refers to the degrees before contraction
    bound = radius * max(0.0, _pull_at_merge(i, j, links, at_midpoint) - 4.0 * gain)
    contract(i, j, links)
    if arcs is not None:
        if arcs.shape[0] > 0:
            contract_arcs(i, j, links, arcs)
    for k in range(len(merged_into)):
        if merged_into[k] == j:
            merged_into[k] = i
    after = lyapunov_of_links(positions, links)
    if is_first:
        report[0] = before
    report[1] = after
    report[2] = max(report[2], after - before)
    report[3] = max(report[3], after - before - bound)


@inner_kernel
def _place(i, j, positions, world):
    """Move both robots to their midpoint, or to i's position if that lies in an obstacle.

    Returns whether the midpoint was used.
    """
    d = positions.shape[1]
    at_midpoint = True
    if world is not None:  # the position of the lower index is collision-free
        a, b = load(positions[i]), load(positions[j])
        midpoint = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])
        at_midpoint = clear_of_obstacles(midpoint, world, 0.0)
    for k in range(d):
        if at_midpoint:
            positions[i, k] = 0.5 * (positions[i, k] + positions[j, k])
        positions[j, k] = positions[i, k]
    return at_midpoint


@inner_kernel
def _pull_at_merge(i, j, links, at_midpoint):
    """D_i + D_j at the midpoint, 2 max(D_i, D_j) at the lower index' position, m/s (theory 5)."""
    first, second, weight = links
    degree_i = degree_j = 0.0
    for e in range(len(first)):
        if first[e] == i or second[e] == i:
            degree_i += weight[e]
        if first[e] == j or second[e] == j:
            degree_j += weight[e]
    return degree_i + degree_j if at_midpoint else 2.0 * max(degree_i, degree_j)


@kernel
def contract(i, j, links):
    """Assign the links of j to i < j, in place; of two to the same robot the heavier remains.

    a_ik ← max(a_ik, a_jk),   a_ij ← 0                         (assumption 2)
    """
    first, second, weight = links
    for e in range(len(first)):
        if weight[e] > 0.0 and (first[e] == j or second[e] == j):
            k = first[e] if second[e] == j else second[e]
            if k == i:
                weight[e] = 0.0
                continue
            low, high = min(i, k), max(i, k)
            twin = _link_between(low, high, links)
            if twin >= 0:
                # the heavier, not the sum: no D_i exceeds the D̄ of the certified step,
                # and a* never decreases (theory 3 and 4)
                weight[twin] = max(weight[twin], weight[e])
                weight[e] = 0.0
            else:
                first[e], second[e] = low, high


@inner_kernel
def _link_between(low, high, links):
    first, second, weight = links
    for e in range(len(first)):
        if weight[e] > 0.0 and first[e] == low and second[e] == high:
            return e
    return -1


@kernel
def contract_arcs(i, j, links, arcs):
    """Contract arcs a_ij, (n, n), m/s; links that are already contracted get new mean weights.

    a_ik ← max(a_ik, a_jk),   a_ki ← max(a_ki, a_kj),   a_ij, a_ji ← 0     (assumption 2)
    """
    n = arcs.shape[0]
    for k in range(n):
        arcs[i, k] = max(arcs[i, k], arcs[j, k])
        arcs[k, i] = max(arcs[k, i], arcs[k, j])
    for k in range(n):
        arcs[j, k] = arcs[k, j] = 0.0
    arcs[i, i] = 0.0
    first, second, weight = links
    for e in range(len(first)):
        if weight[e] > 0.0 and (first[e] == i or second[e] == i):
            weight[e] = 0.5 * (arcs[first[e], second[e]] + arcs[second[e], first[e]])
