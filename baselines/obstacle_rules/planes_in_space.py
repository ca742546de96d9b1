"""Obstacles of 3-D scenarios in a plane that contains f.

A robot passes obstacles at an azimuth about f. The intersections of their cones, widened by a
clearance, with its plane are angular extents in 2-D.
"""

import math

import numpy as np

from rendezvous_env.compilation import inner_kernel, kernel
from rendezvous_env.obstacles.shape import azimuth_axes
from rendezvous_env.physics.vectors import (
    ORIGIN,
    X_AXIS,
    combine,
    cross,
    dot,
    load,
    split,
    store,
    without,
)
from rendezvous_env.safety.turning import mean_axis

from .merged_intervals_2d import TWO_PI, merged_heading_2d, merged_interval_2d
from .obstacle_edges import TOUCHED, direction_of, is_seen, middle_of

_Y_AXIS = (0.0, 1.0, 0.0)
_WIDEST = 0.5 * math.pi - 0.01  # rad; maximum half angle of a widened cone
_PLANES = 8  # candidate planes through f, with two azimuths each
PASSABLE = 1.4
"""rad; farther from f, law (4) is slow."""


@kernel(allocates=True)
def headings_in_planes(net_bearing, silhouettes, clearance, carried, persistence, asides, out):
    """``merged_headings_2d`` in a plane of 3-D, which is kept while an obstacle in it blocks f.

    Inputs are as there, with f (N, 3) and cones (N, M, 8, 3), widened by half of the clearance.
    ``asides``, (N, 3), are the unit vectors across f of the kept planes, zero where undefined; they
    are updated in place.
    """
    slots = silhouettes.shape[1]
    rays, cut, intervals = np.empty((slots, 8, 3)), np.empty((slots, 2, 2)), np.empty((slots, 2))
    for i in range(out.shape[0]):
        towards, before, was = direction_of(net_bearing[i]), load(asides[i]), load(carried[i])
        seen = widened_rays(silhouettes[i], 0.5 * clearance, rays)
        views = rays[:seen], cut[:seen], intervals[:seen]
        keeps = PASSABLE if before != ORIGIN else 0.0
        if before == ORIGIN:
            before = _nearest_ray(towards, views[0])
        aside, _ = kept_azimuth(towards, before, keeps, clearance, views)
        kept, rule = (dot(was, towards), dot(was, aside), 0.0), (clearance, persistence)
        heading = merged_heading_2d(X_AXIS, views[1], kept, rule, views[2])
        store(combine(heading[0], towards, heading[1], aside), out[i])
        store(aside if heading[1] != 0.0 else ORIGIN, asides[i])


@inner_kernel
def _nearest_ray(towards, rays):
    """Boundary ray nearest to f, for any order of obstacles; zero without one."""
    nearest, best = ORIGIN, -math.inf
    for m in range(rays.shape[0]):
        for s in range(8):
            cosine = dot(towards, load(rays[m, s]))
            if cosine > best:
                nearest, best = load(rays[m, s]), cosine
    return nearest


@inner_kernel
def widened_rays(silhouettes, clearance, out):
    """Number of visible cones of (M, 8, 3); ``out`` starts with them, widened by an angle, rad."""
    count = 0
    for m in range(silhouettes.shape[0]):
        if not is_seen(silhouettes[m]):
            continue
        total = ORIGIN
        for s in range(8):
            total = combine(1.0, total, 1.0, load(silhouettes[m, s]))
        length, middle = split(total)
        if length < TOUCHED:
            middle = middle_of(silhouettes[m])
        for s in range(8):
            store(_widened(split(load(silhouettes[m, s]))[1], middle, clearance), out[count, s])
        count += 1
    return count


@inner_kernel
def _widened(ray, middle, clearance):
    """Ray turned away from the middle of its cone by an angle, rad; unit triples."""
    angle = math.acos(min(max(dot(ray, middle), -1.0), 1.0))
    angle = max(angle, min(angle + clearance, _WIDEST))
    outward = split(without(ray, middle))[1]
    return combine(math.cos(angle), middle, math.sin(angle), outward)


@inner_kernel
def kept_azimuth(towards, before, keeps, clearance, views):
    """Azimuth about f for passing an obstacle, and whether it is that of the previous step.

    The azimuth is a unit triple across f; the previous one is ``before``, zero where undefined. It
    is kept while the nearest free direction in its plane is nearer to f than ``keeps``, rad, 0 =
    never. Otherwise it is the one with the smallest turn. ``views`` are ``widened_rays``, (K, 8,
    3), and working memory, (K, 2), with the intersections with the chosen plane, (K, 2, 2).
    """
    rays, cut, intervals = views
    if before == ORIGIN and rays.shape[0] > 0:
        before = load(rays[0, 0])
    aside, _ = azimuth_axes(towards, before, X_AXIS, _Y_AXIS)
    if keeps > 0.0:
        cut_by(towards, aside, rays, cut)
        low, high, _, _ = merged_interval_2d(X_AXIS, cut, intervals)
        if high - low < TWO_PI and min(high, -low) < keeps:
            return aside, True
    aside = _best_azimuth(towards, aside, clearance, views)
    cut_by(towards, aside, rays, cut)
    return aside, False


@inner_kernel
def _best_azimuth(towards, first, clearance, views):
    """Azimuth with the free direction nearest to f, or the first one."""
    rays, cut, intervals = views
    best, least, second = first, math.inf, cross(towards, first)
    for k in range(_PLANES):
        angle = k * math.pi / _PLANES
        aside = combine(math.cos(angle), first, math.sin(angle), second)
        cut_by(towards, aside, rays, cut)
        low, high, _, _ = merged_interval_2d(X_AXIS, cut, intervals)
        if low >= clearance or high <= -clearance:
            return aside
        if high - low < TWO_PI and min(high, -low) < least:
            best, least = aside, min(high, -low)
            if high > -low:
                best = combine(-1.0, aside, 0.0, aside)
    return best


@inner_kernel
def lies_outside(direction, rays):
    """True if a triple lies outside all cones, (K, 8, 3), with rays in right-handed order."""
    for m in range(rays.shape[0]):
        for s in range(8):
            if dot(direction, cross(load(rays[m, s]), load(rays[m, (s + 1) % 8]))) < 0.0:
                break
        else:
            return False
    return True


@inner_kernel
def axis_is_clear_3d(rates, pitch, rays, gate):
    """As ``axis_is_clear``, for cones (K, 8, 3); the pitch is β at the start of the step, rad."""
    on_the_way = mean_axis(rates, pitch, gate)
    return lies_outside(X_AXIS, rays) and lies_outside(on_the_way, rays)


@inner_kernel
def cut_by(towards, aside, rays, out):
    """Intersections of a plane with the cones, flat between rays: (K, 2, 2), x along f, y aside.

    The rays are in right-handed order and cross the plane upward at the counter-clockwise edge.
    """
    normal = cross(towards, aside)
    for m in range(rays.shape[0]):
        out[m, :, :] = 0.0
        found, above = 0, dot(normal, load(rays[m, 0]))
        for s in range(8):
            after = (s + 1) % 8
            below = dot(normal, load(rays[m, after]))
            if (above >= 0.0) != (below >= 0.0) and found < 2:
                point = combine(abs(below), load(rays[m, s]), abs(above), load(rays[m, after]))
                edge = 0 if above < 0.0 else 1
                out[m, edge, 0], out[m, edge, 1] = dot(point, towards), dot(point, aside)
                found += 1
            above = below
