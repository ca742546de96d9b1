"""The heading filter (theorem C) over arrays: ``safety.heading`` and ``safety.frames``.

Arrays have the environment axis last. Vectors are tuples of arrays (n, *batch): all robots at once.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from ..physics.vectors import _VERTICAL, combine, cross, dot, split, split_across, without, x_axis
from ..safety.frames import _CLEARLY_LONGER, _NEARLY_ALONG
from ..safety.heading import (
    _NEARLY_ANTIPODAL,
    NO_CAP,
    HeadingFilter,
    into_cap,
    scale_of_step,
    without_error,
)
from .array_form import Array, array_form, select, square_root


class Memory(NamedTuple):
    """State of the filter between steps."""

    headings: Array  # (n, d, *batch), in the robots' frames; zero if none yet
    frames: Array  # (n, d, d, *batch), of observations; columns are axes
    net_bearing: Array  # (n, d, *batch), f of the last observation, m/s
    degree: Array  # (n, *batch), D of the last observation, m/s


def _without(a: Any, h: Any) -> Any:
    return array_form(without)(a, h)


@dataclass(frozen=True)
class Heading:
    """The filter of single integrators, with the settings of an engine filter."""

    filter: HeadingFilter

    @property
    def _constants(self) -> Any:
        return self.filter._constants

    def begin(self, n: int, d: int, batch: tuple[int, ...], dtype: Any) -> Memory:
        """State before the first observation: no headings, frames equal to the local ones."""
        identity = jnp.eye(d, dtype=dtype).reshape(d, d, *[1] * len(batch))
        zero = jnp.zeros((n, d, *batch), dtype)
        frames = jnp.broadcast_to(identity, (n, d, d, *batch))
        return Memory(zero, frames, zero, zero[:, 0])

    def observe(self, rows: Array, memory: Memory) -> tuple[Array, Memory]:
        """Rows (n, rows, d, *batch), float32, in the frame of the policy: x along f (theory 7)."""
        dtype = memory.net_bearing.dtype
        exact, slots = rows.astype(dtype), self._constants.robot.neighbour_slots
        seen = exact[:, :slots]
        f = jnp.sum(seen, axis=1)
        lengths = square_root(jnp.sum(seen * seen, axis=2))
        memory = memory._replace(net_bearing=f, degree=jnp.sum(lengths, axis=1))
        if not self.filter.along_net_bearing:
            return rows, memory
        memory = memory._replace(frames=self._aimed(exact, f, memory.frames))
        turned = jnp.stack(
            [jnp.sum(memory.frames[:, None, :, k] * exact, axis=2) for k in range(rows.shape[2])],
            axis=2,
        )
        return turned.astype(rows.dtype), memory

    def _aimed(self, rows: Array, f: Array, frames: Array) -> Array:
        """Frames with x along f; kept where ‖f‖ < δ."""
        d = rows.shape[2]
        strength, towards = array_form(split)(tuple(f[:, k] for k in range(d)))
        if d == 2:
            x, y = towards
            columns = [jnp.stack([x, y], 1), jnp.stack([-y, x], 1)]
        else:
            columns = [jnp.stack(axis, 1) for axis in _axes_in_space(rows, towards)]
        aimed = jnp.stack(columns, axis=2)
        return jnp.where(
            (strength >= self._constants.robot.gate.dead_zone)[:, None, None], aimed, frames
        )

    def apply(self, choices: Array, memory: Memory) -> tuple[Array, Memory]:
        """Actions (n, d, *batch), m/s, of choices (n, d, *batch), by law (4)."""
        constants, d = self._constants, choices.shape[1]
        held = choices
        if self.filter.along_net_bearing:
            held = jnp.sum(memory.frames * choices[:, None], axis=2)
        raw = tuple(held[:, k] for k in range(d))
        f = tuple(memory.net_bearing[:, k] for k in range(d))
        robot = constants.robot
        if constants.certified:
            previous = tuple(memory.headings[:, k] for k in range(d))
            limit = turn_limit(constants.max_turn)
            gate = robot.gate
            h = certify(raw, f, previous, gate.min_alignment, gate.dead_zone, limit)
        else:
            h = array_form(split)(raw)[1]
        along = array_form(dot)(h, f)
        sure = array_form(without_error)(along, robot.error_chord * memory.degree)
        if constants.speed_scaled:
            scale = array_form(scale_of_step)
            sure = sure * scale(memory.degree, robot.merge_radius, robot.gate.duration)
        headings = jnp.stack(h, axis=1)
        return headings * sure[:, None], memory._replace(headings=headings)


def _axes_in_space(rows: Array, towards: Any) -> Any:
    """``safety.frames._aim_in_space`` for all robots."""
    longest = jnp.full_like(towards[0], _NEARLY_ALONG)
    across = tuple(jnp.zeros_like(part) for part in towards)
    for k in range(rows.shape[1]):
        row = tuple(rows[:, k, axis] for axis in range(3))
        length, direction = array_form(split)(_without(row, towards))
        longer = length > _CLEARLY_LONGER * longest + _NEARLY_ALONG
        longest, across = jnp.where(longer, length, longest), select(longer, direction, across)
    zero, one = jnp.zeros_like(longest), jnp.ones_like(longest)
    axis = select(jnp.abs(towards[0]) < 0.9, (one, zero, zero), (zero, one, zero))
    _, other = array_form(split)(_without(axis, towards))
    across = select(longest == _NEARLY_ALONG, other, across)
    return towards, across, array_form(cross)(towards, across)


def turn_limit(max_turn: float) -> tuple[float, float, float]:
    """``safety.heading.turn_limit`` as Python numbers."""
    from ..safety.heading import turn_limit as kernel

    cosine, sine, square = kernel(max_turn)
    return float(cosine), float(sine), float(square)


def certify(
    raw: Any, f: Any, previous: Any, min_alignment: float, dead_zone: float, limit: Any
) -> Any:
    """``safety.heading.certify_one`` over arrays: vectors are tuples of arrays."""
    product, cap = array_form(dot), array_form(into_cap)
    strength, towards = array_form(split)(f)
    margin = min_alignment * jnp.clip(strength / dead_zone - 1.0, 0.0, 1.0)
    lost = strength == 0.0
    towards, margin = select(lost, array_form(x_axis)(f), towards), jnp.where(lost, NO_CAP, margin)
    length, heading = array_form(split)(previous)
    flips = (margin != NO_CAP) & (product(heading, towards) < 0.0)
    heading = tuple(jnp.where(flips, -part, part) for part in heading)
    carried = select(length == 0.0, towards, cap(heading, towards, margin, towards))
    length, direction = array_form(split)(raw)
    aim = select(length > 0.0, cap(direction, towards, margin, carried), carried)
    return cap(_turn(carried, aim, towards, limit), towards, margin, towards)


def _turn(carried: Any, aim: Any, towards: Any, limit: Any) -> Any:
    cos_limit, sin_limit, square_chord = limit
    product, add, across = array_form(dot), array_form(combine), array_form(split_across)
    gap = add(1.0, aim, -1.0, carried)
    opposite = (across(aim, carried)[0] < _NEARLY_ANTIPODAL) & (product(aim, carried) < 0.0)
    other = select(
        across(towards, carried)[0] < _NEARLY_ANTIPODAL, _perpendicular(carried), towards
    )
    through = select(opposite, other, aim)
    turned = add(cos_limit, carried, sin_limit, across(through, carried)[1])
    return select(product(gap, gap) <= square_chord, aim, turned)


def _perpendicular(h: Any) -> Any:
    if len(h) == 2:
        return -h[1], h[0]
    level = (-h[1], h[0], jnp.zeros_like(h[0]))
    one, zero = jnp.ones_like(h[0]), jnp.zeros_like(h[0])
    return select(
        h[0] * h[0] + h[1] * h[1] >= _VERTICAL * _VERTICAL, level, _without((one, zero, zero), h)
    )
