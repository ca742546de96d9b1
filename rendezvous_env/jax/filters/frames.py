"""Observations under a filter over arrays: ``safety.frames``, and what actions depend on.

Arrays have the environment axis last.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ...physics.vectors import cross, split, without
from ...safety.frames import _CLEARLY_LONGER, _NEARLY_ALONG
from ...safety.safety_filter import SafetyFilter
from ...safety.turning import Robot
from ..arrays.array_form import Array, array_form, select, square_root

_UNROLLED = 8  # rows: code for each of hundreds would take minutes to compile


class LastObservation(NamedTuple):
    """Last observation, as far as actions depend on it."""

    frames: Array  # (n, d, d, *batch), of the policy; columns are axes in the robot's frame
    net_bearing: Array  # (n, d, *batch), f, m/s
    degree: Array  # (n, *batch), D, m/s
    pitch: Array  # (n, *batch), β, rad; 0 in the plane


def nothing_seen(n: int, d: int, batch: tuple[int, ...], dtype: Any) -> LastObservation:
    """State before the first observation: frames equal to the local ones."""
    identity = jnp.eye(d, dtype=dtype).reshape(d, d, *[1] * len(batch))
    zero = jnp.zeros((n, d, *batch), dtype)
    return LastObservation(
        jnp.broadcast_to(identity, (n, d, d, *batch)), zero, zero[:, 0], zero[:, 0]
    )


def look(
    safety_filter: SafetyFilter, robot: Robot, rows: Array, seen: LastObservation
) -> tuple[Array, LastObservation]:
    """Rows (n, rows, d, *batch) in the frame of the policy: x along f (theory 7)."""
    exact, slots = rows.astype(seen.net_bearing.dtype), robot.neighbour_slots
    neighbours = exact[:, :slots]
    f = jnp.sum(neighbours, axis=1)
    lengths = square_root(jnp.sum(neighbours * neighbours, axis=2))
    seen = seen._replace(net_bearing=f, degree=jnp.sum(lengths, axis=1))
    if robot.turns and not robot.gate.planar:
        gravity = exact[:, robot.gravity_row]
        seen = seen._replace(pitch=jnp.arctan2(-gravity[:, 0], -gravity[:, 2]))
    if not safety_filter.along_net_bearing:
        return rows, seen
    seen = seen._replace(frames=_aimed(exact, f, seen.frames, robot.gate.dead_zone))
    turned = jnp.stack(
        [jnp.sum(seen.frames[:, None, :, k] * exact, axis=2) for k in range(rows.shape[2])],
        axis=2,
    )
    return turned.astype(rows.dtype), seen


def vector_of(values: Array) -> Any:
    """Vectors (n, d, *batch) as a tuple."""
    return tuple(values[:, k] for k in range(values.shape[1]))


def held(safety_filter: SafetyFilter, choices: Array, seen: LastObservation) -> Any:
    """Choices (n, k, *batch) as a tuple; vectors in the robots' frames."""
    if safety_filter.along_net_bearing:
        choices = jnp.sum(seen.frames * choices[:, None], axis=2)
    return vector_of(choices)


def _aimed(rows: Array, f: Array, frames: Array, dead_zone: float) -> Array:
    """Frames with x along f; kept where ‖f‖ < δ."""
    d = rows.shape[2]
    strength, towards = array_form(split)(vector_of(f))
    if d == 2:
        x, y = towards
        columns = [jnp.stack([x, y], 1), jnp.stack([-y, x], 1)]
    else:
        columns = [jnp.stack(axis, 1) for axis in _axes_in_space(rows, towards)]
    aimed = jnp.stack(columns, axis=2)
    return jnp.where((strength >= dead_zone)[:, None, None], aimed, frames)


def _axes_in_space(rows: Array, towards: Any) -> Any:
    """``safety.frames._aim_in_space`` for all robots."""

    def longer_of(k: Any, now: Any) -> Any:
        longest, across = now
        row = jax.lax.dynamic_index_in_dim(rows, k, axis=1, keepdims=False)
        length, direction = array_form(split)(array_form(without)(vector_of(row), towards))
        longer = length > _CLEARLY_LONGER * longest + _NEARLY_ALONG
        return jnp.where(longer, length, longest), select(longer, direction, across)

    begun = jnp.full_like(towards[0], _NEARLY_ALONG), tuple(jnp.zeros_like(x) for x in towards)
    longest, across = jax.lax.fori_loop(0, rows.shape[1], longer_of, begun, unroll=_UNROLLED)
    zero, one = jnp.zeros_like(longest), jnp.ones_like(longest)
    axis = select(jnp.abs(towards[0]) < 0.9, (one, zero, zero), (zero, one, zero))
    _, other = array_form(split)(array_form(without)(axis, towards))
    across = select(longest == _NEARLY_ALONG, other, across)
    return towards, across, array_form(cross)(towards, across)
