"""Sensing: rows of bearings, V, clearances, and the closest pair, of all robots at once.

Positions are (n, d, *batch), frames (n, d·d, *batch), weights (n, n, *batch).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..physics.potential import observed, sighting
from ..physics.vectors import local_axis, to_local
from .arrays.array_form import Array, array_form
from .imperfections import SensorModel
from .obstacles.shapes import Shapes, World


class NeighbourObservation(NamedTuple):
    """Observations of an environment, and V."""

    rows: Array  # (n, K, d, *batch), a_ij g_ij in the robots' frames, m/s
    lyapunov: Array  # (*batch), V, m²/s
    closest: Array  # (*batch), the least square distance of neighbours, m²; inf without any
    net_bearings: Array  # (n, d, *batch), f_i in the global frame, m/s


def _pairs(positions: Array, weights: Array) -> tuple[Any, Array, Array, Array]:
    """``sighting`` of all pairs: p_j − p_i, and arrays (n, n, *batch)."""
    axes = range(positions.shape[1])
    own = tuple(positions[:, None, k] for k in axes)
    return array_form(sighting)(own, tuple(positions[None, :, k] for k in axes), weights)


def lyapunov(positions: Array, weights: Array) -> Array:
    """V = Σᵢ Σⱼ aᵢⱼ ‖pⱼ − pᵢ‖, (*batch), m²/s."""
    return _lyapunov(weights, _pairs(positions, weights)[2])


def _lyapunov(weights: Array, distance: Array) -> Array:
    return jnp.sum(jnp.sum(weights * distance, axis=1), axis=0)


def sense(
    positions: Array,
    frames: Array,
    weights: Array,
    slots: int,
    dtype: Any,
    sensor: SensorModel | None = None,
    keys: Any = None,
) -> NeighbourObservation:
    """Observe all neighbours; with ``slots`` < n − 1 rows those present come first.

    Rows are of this type. An imperfect ``sensor`` uses the keys of its streams.
    """
    offset, square, distance, factor = _pairs(positions, weights)
    frame = tuple(frames[:, None, k] for k in range(frames.shape[1]))
    rows = jnp.stack(array_form(observed)(frame, offset, factor), axis=2).astype(dtype)
    there = weights > 0.0
    if sensor is not None:
        rows = sensor.neighbours(rows, offset, frame, keys)
        there = jnp.any(rows != 0.0, axis=2)
    others = _others(rows)
    if slots < len(positions) - 1:
        others = _packed(others, _others(there), slots)
    closest = jnp.min(jnp.where(weights > 0.0, square, jnp.inf), axis=(0, 1))
    net = jnp.stack([jnp.sum(factor * part, axis=1) for part in offset], axis=1)
    return NeighbourObservation(others, _lyapunov(weights, distance), closest, net)


def clearances(shapes: Shapes, world: World, positions: Array, active: Array) -> Array:
    """Distance to the nearest obstacle, (n, *batch), m; inf for inactive robots."""
    return jnp.min(_distances(shapes, _of_robots(world), positions, active), axis=0)


def sense_obstacles(
    shapes: Shapes,
    world: World,
    positions: Array,
    frames: Array,
    active: Array,
    net: Array,
    reach: float,
    dtype: Any,
    sensor: SensorModel | None = None,
    keys: Any = None,
) -> tuple[Array, Array]:
    """Observe the obstacles within ``reach``, m.

    Returns rows (n, M·S, d, *batch) of unit bearings in the robots' frames, and ``clearances``.
    """
    n, d = positions.shape[:2]
    world = _of_robots(world)
    distance = _distances(shapes, world, positions, active)  # (M, n, *batch)
    frame, bearing = (tuple(a[:, k] for k in range(a.shape[1])) for a in (frames, net))
    axes = [array_form(local_axis)(frame, k) for k in range(2)] if d == 3 else ()
    seen = shapes.silhouettes(world, _points(positions), bearing, axes)
    local = [jnp.stack(array_form(to_local)(frame, one), axis=2) for one in seen]
    rows = jnp.swapaxes(jnp.stack(local, axis=2), 0, 1)  # (n, M, S, d, *batch)
    near = jnp.swapaxes(distance <= reach, 0, 1)
    rows = jnp.where(near[:, :, None, None], rows, 0.0).astype(dtype)
    if sensor is not None:
        rows = sensor.obstacles(rows, keys)
    return rows.reshape(n, -1, *rows.shape[3:]), jnp.min(distance, axis=0)


def _of_robots(world: World) -> World:
    """Obstacles (…, *batch) with an axis for the robots before the batch."""
    edges = jax.tree.map(lambda values: values[:, :, None], world.edges)
    return World(world.present[:, None], world.shapes[:, :, None], world.skins[:, None], edges)


def _points(positions: Array) -> Any:
    """Positions as a tuple of (n, *batch)."""
    return tuple(positions[:, k] for k in range(positions.shape[1]))


def _distances(shapes: Shapes, world: World, positions: Array, active: Array) -> Array:
    return jnp.where(active, shapes.distances(world, _points(positions)), jnp.inf)


def _others(values: Array) -> Array:
    """Entries of pairs (n, n, …) without those of a robot and itself, (n, n − 1, …).

    In a flat list of all pairs the diagonal is every (n + 1)-th entry.
    """
    n, *rest = values.shape[1:]
    flat = values.reshape(n * n, *rest)[1:].reshape(n - 1, n + 1, *rest)
    return flat[:, :-1].reshape(n, n - 1, *rest)


def _packed(rows: Array, seen: Array, slots: int) -> Array:
    """Move the rows of neighbours to the first slots, in the order of their indices."""
    place = jnp.cumsum(seen, axis=1) - 1
    each = [
        jnp.sum(jnp.where((seen & (place == slot))[:, :, None], rows, 0.0), axis=1)
        for slot in range(slots)
    ]
    return jnp.stack(each, axis=1)
