"""Sensing: rows of bearings, V, and the closest pair.

Positions are (n, d, *batch), frames (n, d·d, *batch), weights (n, n, *batch). The rows of
one robot are computed at once. The loop over robots is unrolled for a few of them; for many,
unrolled code would take long to compile.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..physics.potential import observed, sighting
from .array_form import Array, array_form

_MOST_WRITTEN_OUT = 16  # robots


class Sight(NamedTuple):
    """Observations of an environment, and V."""

    rows: Array  # (n, K, d, *batch), a_ij g_ij in the robots' frames, m/s
    lyapunov: Array  # (*batch), V, m²/s
    closest: Array  # (*batch), the least square distance of neighbours, m²; inf without any


def sense(positions: Array, frames: Array, weights: Array, slots: int) -> Sight:
    """Observe all neighbours; with ``slots`` < n − 1 rows those present come first."""
    n, d = positions.shape[:2]
    everyone = tuple(positions[:, k] for k in range(d))

    def look(robot: Any) -> tuple[Array, Array, Array]:
        i, place, frame, gains = robot
        offset, square, distance, factor = array_form(sighting)(tuple(place), everyone, gains)
        seen = jnp.stack(array_form(observed)(tuple(frame), offset, factor), axis=1)
        others = _without(i, seen)
        if slots < n - 1:
            others = _packed(others, _without(i, gains) > 0.0, slots)
        near = jnp.where(gains > 0.0, square, jnp.inf)
        return others, jnp.sum(gains * distance, axis=0), jnp.min(near, axis=0)

    if n <= _MOST_WRITTEN_OUT:
        looks = [look((i, positions[i], frames[i], weights[i])) for i in range(n)]
        rows, shares, nearest = (jnp.stack(parts) for parts in zip(*looks, strict=True))
    else:
        robots = jnp.arange(n), positions, frames, weights
        rows, shares, nearest = jax.lax.map(look, robots)
    return Sight(rows, jnp.sum(shares, axis=0), jnp.min(nearest, axis=0))


def _without(i: Any, values: Array) -> Array:
    """Values (n, …) of all robots but i."""
    if isinstance(i, int):
        return jnp.concatenate([values[:i], values[i + 1 :]])
    before = jnp.arange(len(values) - 1) < i
    return jnp.where(before.reshape(-1, *[1] * (values.ndim - 1)), values[:-1], values[1:])


def _packed(rows: Array, seen: Array, slots: int) -> Array:
    """Move the rows of neighbours to the first slots, in the order of their indices."""
    place = jnp.cumsum(seen, axis=0) - 1
    return jnp.stack(
        [
            jnp.sum(jnp.where((seen & (place == slot))[:, None], rows, 0.0), axis=0)
            for slot in range(slots)
        ]
    )
