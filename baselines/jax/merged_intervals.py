"""Rule of merged intervals in the plane over arrays, as ``obstacle_rules.merged_intervals_2d``.

Silhouettes are (..., M, 2, 2), counter-clockwise edge first; vectors are pairs or triples of arrays
(...). The loops over obstacles of the kernels are reductions over the axis M.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form, replaces
from rendezvous_env.physics.vectors import cross_in_plane, dot, rotated, split

from ..obstacle_rules.merged_intervals_2d import (
    _ROUNDING,
    TWO_PI,
    _between,
    comes_near,
    counter_clockwise,
    is_clear,
    least_square_cosine,
)
from .arrays import Array, angle_of, parts_of

_cross, _dot, _rotated = map(array_form, (cross_in_plane, dot, rotated))


class MergedInterval(NamedTuple):
    """Merged interval of angles around a direction, (...), rad; see ``merged_interval_2d``."""

    low: Array
    high: Array
    gap_below: Array
    gap_above: Array

    @property
    def closed(self) -> Array:
        """True if no direction is free."""
        return self.high - self.low >= TWO_PI


@replaces(counter_clockwise)
def _counter_clockwise(angle: Any) -> Any:
    rounding = max(_ROUNDING, 8.0 * float(jnp.finfo(angle.dtype).eps))
    turned = jnp.mod(angle, TWO_PI)
    return jnp.where(turned >= TWO_PI - rounding, 0.0, turned)


def merged_interval(towards: Any, silhouettes: Array) -> MergedInterval:
    """Interval that silhouettes (..., M, 2, 2) cover around unit pairs, and the gaps beyond it."""
    if silhouettes.shape[-3] == 0:
        free, none = jnp.full_like(towards[0], TWO_PI), jnp.full_like(towards[0], jnp.inf)
        return MergedInterval(none, -none, free, free)
    u = tuple(part[..., None] for part in towards)
    last, first = ((silhouettes[..., s, 0], silhouettes[..., s, 1]) for s in (0, 1))
    seen = (last[0] != 0.0) | (last[1] != 0.0)
    start = angle_of(_cross(u, first), _dot(u, first))
    width = angle_of(_cross(first, last), _dot(first, last))
    width = jnp.where(width > -0.25 * TWO_PI, jnp.maximum(width, 0.0), width + TWO_PI)
    low, high = _merged(start, width, seen)
    beyond = _counter_clockwise(start - low[..., None])
    apart = seen & (beyond > (high - low)[..., None])
    free = TWO_PI - (high - low)
    above = jnp.where(apart, beyond - (high - low)[..., None], jnp.inf)
    below = jnp.where(apart, TWO_PI - (beyond + width), jnp.inf)
    some = jnp.any(seen, axis=-1)
    return MergedInterval(
        low=jnp.where(some, low, jnp.inf),
        high=jnp.where(some, high, -jnp.inf),
        gap_below=jnp.where(some, jnp.minimum(free, jnp.min(below, axis=-1)), TWO_PI),
        gap_above=jnp.where(some, jnp.minimum(free, jnp.min(above, axis=-1)), TWO_PI),
    )


def _merged(start: Array, width: Array, seen: Array) -> tuple[Array, Array]:
    """Merge the interval around 0, or the nearest one, with all that overlap it."""
    end = start + width
    distance = jnp.minimum(jnp.minimum(jnp.abs(start), jnp.abs(end)), TWO_PI - end)
    distance = jnp.where((start <= 0.0) & (end >= 0.0), -1.0, distance)
    nearest = jnp.argmin(jnp.where(seen, distance, jnp.inf), axis=-1)[..., None]
    low, high = (jnp.take_along_axis(part, nearest, axis=-1)[..., 0] for part in (start, end))
    from_below = (low > 0.0) & (TWO_PI - high < low)
    low, high = (jnp.where(from_below, part - TWO_PI, part) for part in (low, high))

    def grow(_: Any, edges: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = edges
        open_ = seen & (high - low < TWO_PI)[..., None]
        after = _counter_clockwise(start - low[..., None])
        within = after <= (high - low)[..., None]
        up = jnp.where(open_ & within, low[..., None] + after + width, -jnp.inf)
        wraps = open_ & ~within & (after + width >= TWO_PI)
        down = jnp.where(wraps, low[..., None] + after - TWO_PI, jnp.inf)
        return jnp.minimum(low, jnp.min(down, -1)), jnp.maximum(high, jnp.max(up, -1))

    return jax.lax.fori_loop(0, start.shape[-1], grow, (low, high))


def merged_headings(
    towards: Any, silhouettes: Array, clearance: float, carried: Any, persistence: float
) -> tuple[Array, Array]:
    """Headings towards the nearer edge of the interval that blocks a unit pair, as
    ``merged_heading_2d``.
    """
    known = (carried[0] != 0.0) | (carried[1] != 0.0)
    kept = jnp.where(known, angle_of(_cross(towards, carried), _dot(towards, carried)), 0.0)
    weight = jnp.where(known, persistence, 0.0)
    joined = merged_interval(towards, silhouettes)
    blocked = ~joined.closed & (joined.low < clearance) & (joined.high > -clearance)
    low, high = (jnp.where(blocked, edge, 0.0) for edge in (joined.low, joined.high))
    between = array_form(_between)
    above, below = high + weight * between(high, kept), -low + weight * between(low, kept)
    up = high + jnp.minimum(clearance, 0.5 * joined.gap_above)
    down = low - jnp.minimum(clearance, 0.5 * joined.gap_below)
    turn = jnp.where(blocked, jnp.where(above <= below, up, down), 0.0)
    x, y, _ = _rotated(towards, turn)
    return x, y


def direction_of(vector: Any) -> tuple[Array, ...]:
    """Unit pair or triple along one; the x axis for zero."""
    length, (x, *others) = array_form(split)(vector)
    return jnp.where(length > 0.0, x, 1.0), *others


@replaces(is_clear)
def _is_clear(towards: Any, silhouettes: Array, clearance: float) -> Array:
    u = tuple(jnp.asarray(part)[..., None] for part in towards[:2])
    last, first = (parts_of(silhouettes[..., s, :]) for s in (0, 1))
    near = array_form(comes_near)(u, last, first, least_square_cosine(clearance))
    seen = jnp.any(silhouettes[..., 0, :] != 0.0, axis=-1)
    return ~jnp.any(near & seen, axis=-1) & (clearance < 0.25 * TWO_PI)
