"""Obstacles in a plane that contains f over arrays, as ``obstacle_rules.planes_in_space``.

Vectors are triples of arrays (...), the rays of cones a triple of arrays (..., M, 8). The loops
over cones, rays and candidate planes of the kernels are axes here.
"""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form, replaces
from rendezvous_env.obstacles.shape import azimuth_axes
from rendezvous_env.physics.vectors import X_AXIS, combine, cross, dot, split

from ..obstacle_rules import planes_in_space
from ..obstacle_rules.obstacle_edges import TOUCHED
from ..obstacle_rules.planes_in_space import _PLANES, _Y_AXIS, PASSABLE, _widened, lies_outside
from .arrays import Array, parts_of, select
from .merged_intervals import MergedInterval, direction_of, merged_headings, merged_interval

Triple = Any
_combine, _cross, _dot = map(array_form, (combine, cross, dot))


class Cones(NamedTuple):
    """Cones that obstacles cover, zero where not visible."""

    rays: Triple  # of (..., M, 8), in right-handed order
    seen: Array  # (..., M)


def any_of(vector: Triple) -> Array:
    """Mask of vectors other than zero."""
    return (vector[0] != 0.0) | (vector[1] != 0.0) | (vector[2] != 0.0)


def widened_cones(silhouettes: Array, clearance: float) -> Cones:
    """Cones of silhouettes (..., M, 8, 3), widened by an angle, rad."""
    points = parts_of(silhouettes)
    length, middle = array_form(split)(tuple(jnp.sum(part, axis=-1) for part in points))
    middle = select(length < TOUCHED, _middle_at_contact(points), middle)
    around = tuple(part[..., None] for part in middle)
    rays = array_form(_widened)(array_form(split)(points)[1], around, clearance)
    return Cones(rays, jnp.any(silhouettes[..., 0, :] != 0.0, axis=-1))


def _middle_at_contact(points: Triple) -> Triple:
    """``obstacle_edges.middle_of`` of boundary rays, (..., 8)."""
    first, second, third = (
        array_form(split)(tuple(p[..., s] for p in points))[1] for s in (0, 4, 2)
    )
    length, middle = array_form(split)(_combine(1.0, first, 1.0, second))
    return select(length >= TOUCHED, middle, array_form(split)(_cross(first, third))[1])


def cut_by(towards: Triple, aside: Triple, cones: Cones) -> Array:
    """Silhouettes (..., M, 2, 2) of cones in a plane, x along f and y aside."""
    u, e = (tuple(part[..., None, None] for part in axis) for axis in (towards, aside))
    height = _dot(_cross(u, e), cones.rays)
    after, following = (
        jnp.roll(height, -1, axis=-1), tuple(jnp.roll(part, -1, axis=-1) for part in cones.rays),
    )  # fmt: skip
    point = _combine(jnp.abs(after), cones.rays, jnp.abs(height), following)
    found = jnp.stack([_dot(point, u), _dot(point, e)], axis=-1)
    edges = [_first(found, (height < 0.0) & (after >= 0.0))]
    edges.append(_first(found, (height >= 0.0) & (after < 0.0)))
    return jnp.stack(edges, axis=-2)


def _first(values: Array, which: Array) -> Array:
    """The first of values (..., 8, 2) of a mask (..., 8), zero if it has none."""
    first = which & (jnp.cumsum(which, axis=-1) == 1)
    return jnp.sum(jnp.where(first[..., None], values, 0.0), axis=-2)


def interval_in_plane(silhouettes: Array) -> MergedInterval:
    """Merged interval around f of silhouettes of ``cut_by``."""
    return merged_interval(_ahead(silhouettes), silhouettes)


def _ahead(silhouettes: Array) -> tuple[Array, Array]:
    like = silhouettes[..., 0, 0, 0]
    return jnp.ones_like(like), jnp.zeros_like(like)


def _nearest_edge(joined: MergedInterval) -> Array:
    return jnp.minimum(joined.high, -joined.low)


def kept_azimuth(
    towards: Triple, before: Triple, keeps: Array, clearance: float, cones: Cones
) -> tuple[Triple, Array]:
    """Azimuth about f, a unit triple, and whether it is the previous one; as the kernel.

    ``keeps`` is (...), rad.
    """
    first = jnp.argmax(cones.seen, axis=-1)[..., None]
    ray = tuple(jnp.take_along_axis(part[..., 0], first, axis=-1)[..., 0] for part in cones.rays)
    before = select(any_of(before), before, ray)
    aside, _ = array_form(azimuth_axes)(towards, before, X_AXIS, _Y_AXIS)
    joined = interval_in_plane(cut_by(towards, aside, cones))
    kept = (keeps > 0.0) & ~joined.closed & (_nearest_edge(joined) < keeps)
    return select(kept, aside, _best_azimuth(towards, aside, clearance, cones)), kept


def _best_azimuth(towards: Triple, first: Triple, clearance: float, cones: Cones) -> Triple:
    """``planes_in_space._best_azimuth``, of all planes at once."""
    second = _cross(towards, first)
    angle = jnp.arange(_PLANES) * (math.pi / _PLANES)
    turned = [jnp.cos(angle), jnp.sin(angle)]
    first, second, towards = (
        [part[..., None] for part in axis] for axis in (first, second, towards)
    )
    asides = _combine(turned[0], first, turned[1], second)
    shown = Cones(tuple(part[..., None, :, :] for part in cones.rays), cones.seen)
    joined = interval_in_plane(cut_by(towards, asides, shown))
    free = (joined.low >= clearance) | (joined.high <= -clearance)
    cost = jnp.where(joined.closed, jnp.inf, _nearest_edge(joined))
    best = jnp.argmin(jnp.where(free, -jnp.inf, cost), axis=-1)[..., None]
    back = ~free & ~joined.closed & (joined.high > -joined.low)
    asides = tuple(jnp.where(back, -part, part) for part in asides)
    return tuple(jnp.take_along_axis(part, best, axis=-1)[..., 0] for part in asides)


@replaces(lies_outside)
def _lies_outside(direction: Triple, cones: Cones) -> Array:
    following = tuple(jnp.roll(part, -1, axis=-1) for part in cones.rays)
    one = tuple(jnp.asarray(part)[..., None, None] for part in direction)
    within = jnp.all(_dot(one, _cross(cones.rays, following)) >= 0.0, axis=-1)
    return ~jnp.any(within & cones.seen, axis=-1)


def headings_in_planes(
    net_bearing: Triple, silhouettes: Array, rule: Any, carried: Triple, asides: Triple
) -> tuple[Triple, Triple]:
    """Headings of ``tangent-merged-tuned``, and unit vectors across f of the kept planes.

    Silhouettes are (..., M, 8, 3); ``rule`` is clearance, rad, and persistence.
    """
    clearance, persistence = rule
    towards, cones = direction_of(net_bearing), widened_cones(silhouettes, 0.5 * clearance)
    known = any_of(asides)
    before = select(known, asides, _nearest_ray(towards, cones))
    keeps = jnp.where(known, PASSABLE, 0.0)
    aside, _ = kept_azimuth(towards, before, keeps, clearance, cones)
    cut = cut_by(towards, aside, cones)
    kept = _dot(carried, towards), _dot(carried, aside)
    x, y = merged_headings(_ahead(cut), cut, clearance, kept, persistence)
    heading = _combine(x, towards, y, aside)
    return heading, tuple(jnp.where(y != 0.0, part, 0.0) for part in aside)


def _nearest_ray(towards: Triple, cones: Cones) -> Triple:
    """``planes_in_space._nearest_ray``."""
    flat = tuple(part.reshape(*part.shape[:-2], -1) for part in cones.rays)
    cosine = _dot(tuple(part[..., None] for part in towards), flat)
    seen = jnp.repeat(cones.seen, 8, axis=-1)
    nearest = jnp.argmax(jnp.where(seen, cosine, -jnp.inf), axis=-1)[..., None]
    return tuple(jnp.take_along_axis(part, nearest, axis=-1)[..., 0] for part in flat)


axis_is_clear = array_form(planes_in_space.axis_is_clear_3d)
"""``axis_is_clear_3d`` of rates, pitch, ``Cones`` and gate."""
