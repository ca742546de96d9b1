"""Sensing: rows of bearings, V, and the closest pair.

Positions are (n, d, *batch), frames (n, d·d, *batch), weights (n, n, *batch). The rows of
one robot are computed at once. The loop over robots is unrolled for a few of them; for many,
unrolled code would take long to compile.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..physics.potential import observed, sighting
from ..physics.vectors import local_axis, to_local
from .arrays.array_form import Array, array_form
from .imperfections import Sensor
from .obstacles.shapes import Shapes, World

_MOST_WRITTEN_OUT = 16  # robots


class Sight(NamedTuple):
    """Observations of an environment, and V."""

    rows: Array  # (n, K, d, *batch), a_ij g_ij in the robots' frames, m/s
    lyapunov: Array  # (*batch), V, m²/s
    closest: Array  # (*batch), the least square distance of neighbours, m²; inf without any
    net_bearings: Array  # (n, d, *batch), f_i in the global frame, m/s


def sense(
    positions: Array,
    frames: Array,
    weights: Array,
    slots: int,
    dtype: Any,
    sensor: Sensor | None = None,
    keys: Any = None,
) -> Sight:
    """Observe all neighbours; with ``slots`` < n − 1 rows those present come first.

    Rows are of this type. An imperfect ``sensor`` uses the keys of its streams.
    """
    n, d = positions.shape[:2]
    everyone = tuple(positions[:, k] for k in range(d))

    def look(robot: Any) -> tuple[Array, Array, Array, Array]:
        i, place, frame, gains = robot
        offset, square, distance, factor = array_form(sighting)(tuple(place), everyone, gains)
        seen = jnp.stack(array_form(observed)(tuple(frame), offset, factor), axis=1)
        seen, there = seen.astype(dtype), gains > 0.0
        if sensor is not None:
            seen = sensor.neighbours(i, seen, offset, tuple(frame), keys)
            there = jnp.any(seen != 0.0, axis=1)
        others = _without(i, seen)
        if slots < n - 1:
            others = _packed(others, _without(i, there), slots)
        near = jnp.where(gains > 0.0, square, jnp.inf)
        net = jnp.stack([jnp.sum(factor * part, axis=0) for part in offset])
        return others, jnp.sum(gains * distance, axis=0), jnp.min(near, axis=0), net

    robots = jnp.arange(n), positions, frames, weights
    rows, shares, nearest, net = _for_each_robot(look, robots)
    return Sight(rows, jnp.sum(shares, axis=0), jnp.min(nearest, axis=0), net)


def _for_each_robot(look: Callable[[Any], Any], robots: Any) -> Any:
    """Results of each robot, stacked; arrays of ``robots`` have the robots first."""
    n = len(robots[0])
    if n > _MOST_WRITTEN_OUT:
        return jax.lax.map(look, robots)
    looks = [look((i, *(array[i] for array in robots[1:]))) for i in range(n)]
    return tuple(jnp.stack(parts) for parts in zip(*looks, strict=True))


def sense_obstacles(
    shapes: Shapes,
    world: World,
    positions: Array,
    frames: Array,
    active: Array,
    net: Array,
    reach: float,
    dtype: Any,
    sensor: Sensor | None = None,
    keys: Any = None,
) -> tuple[Array, Array]:
    """Observe the obstacles within ``reach``, m.

    Returns rows (n, M·S, d, *batch) of unit bearings in the robots' frames, and distances to the
    nearest obstacle, (n, *batch), m; inf for inactive robots.
    """
    n, d = positions.shape[:2]

    def look(robot: Any) -> tuple[Array, Array]:
        i, place, frame, is_active, bearing = robot
        zero = jnp.zeros_like(place[0])
        point, entries = (*place, zero)[:3], tuple(frame)
        distance = jnp.where(is_active, shapes.distances(world, point), jnp.inf)
        axes = [array_form(local_axis)(entries, k) for k in range(2)] if d == 3 else ()
        seen = shapes.silhouettes(world, point, tuple(bearing), axes)
        local = [array_form(to_local)(entries, one[:d]) for one in seen]
        rows = jnp.stack([jnp.stack(one, axis=1) for one in local], axis=1)  # (M, S, d, *batch)
        rows = jnp.where((distance <= reach)[:, None, None], rows, 0.0).astype(dtype)
        if sensor is not None:
            rows = sensor.obstacles(i, rows, keys)
        return rows.reshape(-1, *rows.shape[2:]), jnp.min(distance, axis=0)

    rows, clearance = _for_each_robot(look, (jnp.arange(n), positions, frames, active, net))
    return rows, clearance


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
