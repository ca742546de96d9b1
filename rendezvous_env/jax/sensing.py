"""What robots see: rows of bearings, V, and the closest pair.

Positions are (n, d, *batch), frames n lists of d² arrays, weights (n, n, *batch). Small teams are
written out by pairs, as the engine's lanes are; of larger ones each robot looks at all at once.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from ..physics.potential import observed, sighting
from .array_form import Array, array_form

_MOST_BY_PAIRS = 12  # robots; the compiled code of pairs grows with n²


class Sight(NamedTuple):
    """What a team sees, and V."""

    rows: Array  # (n, K, d, *batch), a_ij g_ij in the robots' frames, m/s
    lyapunov: Array  # (*batch), V, m²/s
    closest: Array  # (*batch), the least square distance of neighbours, m²; inf without any


def sense(positions: Array, frames: Any, weights: Array, slots: int, one_way: bool) -> Sight:
    """Sense all neighbours; with ``slots`` < n − 1 rows those present stand first."""
    n = len(positions)
    by_pairs = n <= _MOST_BY_PAIRS
    rows, lyapunov, closest = (_by_pairs if by_pairs else _by_robots)(
        positions, frames, weights, one_way
    )
    if slots < n - 1:
        rows = _packed(rows, weights, slots)
    return Sight(rows, lyapunov, closest)


def _by_pairs(positions: Array, frames: Any, weights: Array, one_way: bool) -> Any:
    n, d = positions.shape[:2]
    sight, observe = array_form(sighting), array_form(observed)
    places = [tuple(positions[i, k] for k in range(d)) for i in range(n)]
    rows: list[list[Any]] = [[None] * (n - 1) for _ in range(n)]
    half_lyapunov, closest = 0.0, jnp.full(positions.shape[2:], jnp.inf, positions.dtype)
    for i in range(n):
        for j in range(i + 1, n):
            gain = weights[i, j]
            offset, square, distance, factor = sight(places[i], places[j], gain)
            back, weight = factor, gain
            if one_way:
                other = weights[j, i]
                back, weight = sight(places[i], places[j], other)[3], 0.5 * (gain + other)
            rows[i][j - 1] = observe(frames[i], offset, factor)
            rows[j][i] = observe(frames[j], offset, -back)
            half_lyapunov += weight * distance
            closest = jnp.where((weight > 0.0) & (square < closest), square, closest)
    numbers = [part for row in rows for seen in row for part in seen]
    shape = n, n - 1, d, *positions.shape[2:]
    return jnp.stack(numbers).reshape(shape), 2.0 * half_lyapunov, closest


def _by_robots(positions: Array, frames: Any, weights: Array, one_way: bool) -> Any:
    n, d = positions.shape[:2]
    rows, lyapunov = [], 0.0
    closest = jnp.full(positions.shape[2:], jnp.inf, positions.dtype)
    everyone = tuple(positions[:, k] for k in range(d))
    for i in range(n):
        here = tuple(positions[i, k] for k in range(d))
        offset, square, distance, factor = array_form(sighting)(here, everyone, weights[i])
        seen = jnp.stack(array_form(observed)(frames[i], offset, factor), axis=1)
        rows.append(jnp.concatenate([seen[:i], seen[i + 1 :]]))
        lyapunov += jnp.sum(weights[i] * distance, axis=0)
        near = jnp.min(jnp.where(weights[i] > 0.0, square, jnp.inf), axis=0)
        closest = jnp.minimum(closest, near)
    return jnp.stack(rows), lyapunov, closest


def _packed(rows: Array, weights: Array, slots: int) -> Array:
    """Rows of robots that are seen, in the order of their indices."""
    n = len(rows)
    packed = []
    for i in range(n):
        seen = jnp.concatenate([weights[i, :i], weights[i, i + 1 :]]) > 0.0
        place = jnp.cumsum(seen, axis=0) - 1
        packed.append([
            jnp.sum(jnp.where((seen & (place == slot))[:, None], rows[i], 0.0), axis=0)
            for slot in range(slots)
        ])
    return jnp.stack([jnp.stack(row) for row in packed])
