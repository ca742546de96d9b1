"""Rule of merged intervals in 3-D: overlapping cones count as one obstacle."""

import math

import numpy as np

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.physics.vectors import combine, dot, load, split, store, without

from .obstacle_edges import STRAIGHT_AHEAD, direction_of, is_seen, middle_of, unit


@kernel(allocates=True)
def merged_headings_3d(net_bearing, silhouettes, clearance, out):
    """Headings towards a free direction next to the merged cones that block f.

    Cones whose angular discs overlap, directly or through others, are merged. f is blocked if it
    lies in a disc widened by the clearance; of several discs, the one with f deepest inside counts.
    Candidates are the boundary rays, eight of each cone merged with that one, moved outward by the
    clearance. The heading is the candidate nearest to f that lies in no other cone. Without a
    blocking cone, or without such a candidate, the heading is f. Ray 0 of a cone is its boundary
    direction nearest to f, so the heading leaves a single cone on the shortest path.

    Inputs are fᵢ, (N, 3), silhouettes (N, M, 8, 3) and the clearance, rad; the output is ``out``,
    (N, 3).
    """
    cones = np.empty((silhouettes.shape[1], 4))  # unit axis, half angle in rad
    slots = np.empty(silhouettes.shape[1], np.int64)
    joined = np.empty(silhouettes.shape[1], np.bool_)
    for i in range(out.shape[0]):
        towards, count = direction_of(net_bearing[i]), 0
        for m in range(silhouettes.shape[1]):
            if is_seen(silhouettes[i, m]):
                centre = middle_of(silhouettes[i, m])
                store(centre, cones[count, :3])
                cones[count, 3], slots[count] = _angle(unit(silhouettes[i, m, 0]), centre), m
                count += 1
        seen, blocking, least = cones[:count], STRAIGHT_AHEAD, clearance
        for k in range(count):
            outside = _angle(towards, load(seen[k, :3])) - seen[k, 3]
            if outside < least:
                blocking, least = k, outside
        if blocking == STRAIGHT_AHEAD:
            store(towards, out[i])
            continue
        _join(blocking, seen, joined)
        store(_nearest_free_ray(towards, seen, joined, silhouettes[i], slots, clearance), out[i])


@inner_kernel
def _angle(a, b):
    """Angle between unit vectors, rad."""
    return math.acos(min(max(dot(a, b), -1.0), 1.0))


@inner_kernel
def _join(first, cones, joined):
    """Mark the cones that overlap the first one, directly or through others."""
    joined[:] = False
    joined[first] = True
    grown = True
    while grown:
        grown = False
        for k in range(cones.shape[0]):
            for other in range(cones.shape[0]):
                if joined[other] and not joined[k]:
                    apart = _angle(load(cones[k, :3]), load(cones[other, :3]))
                    if apart < cones[k, 3] + cones[other, 3]:
                        joined[k] = grown = True


@inner_kernel
def _nearest_free_ray(towards, cones, joined, silhouettes, slots, clearance):
    """Widened boundary ray nearest to f that lies in no other cone; f without one."""
    heading, best = towards, -math.inf
    for k in range(cones.shape[0]):
        if not joined[k]:
            continue
        centre = load(cones[k, :3])
        angle = min(cones[k, 3] + clearance, math.pi)
        for s in range(silhouettes.shape[1]):
            outward = split(without(unit(silhouettes[slots[k], s]), centre))[1]
            ray = combine(math.cos(angle), centre, math.sin(angle), outward)
            if dot(towards, ray) > best and _is_free(ray, k, cones):
                heading, best = ray, dot(towards, ray)
    return heading


@inner_kernel
def _is_free(ray, own, cones):
    for k in range(cones.shape[0]):
        if k != own and dot(ray, load(cones[k, :3])) > math.cos(cones[k, 3]):
            return False
    return True
