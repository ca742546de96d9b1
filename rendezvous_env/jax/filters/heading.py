"""The heading filter (theorem C) over arrays: ``safety.heading``.

Arrays have the environment axis last. Vectors are tuples of arrays (n, *batch): all robots at once.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from ...physics.vectors import dot, split, triple
from ...safety.heading import (
    HeadingFilter,
    certify_one,
    scale_of_step,
    turn_limit,
    without_error,
)
from ...safety.turning import Gate, desired_rates, gated_rates, mean_axis, rates_of
from ..arrays.array_form import Array, array_form
from .frames import LastObservation, held, look, nothing_seen, vector_of

Vector = Any


class HeadingMemory(NamedTuple):
    """State of the filter between steps."""

    headings: Array  # (n, d, *batch), in the robots' frames; zero if none yet
    seen: LastObservation


class Heading:
    """The filter of a scenario, with the settings of an engine filter.

    Args:
        safety_filter: with the settings.
        sent_as: type of actions, to which they are rounded.
    """

    def __init__(self, safety_filter: HeadingFilter, sent_as: Any) -> None:
        self.filter, self._sent_as = safety_filter, sent_as
        self._constants = safety_filter._constants

    def begin(self, n: int, d: int, batch: tuple[int, ...], dtype: Any) -> HeadingMemory:
        """State before the first observation."""
        return HeadingMemory(jnp.zeros((n, d, *batch), dtype), nothing_seen(n, d, batch, dtype))

    def observe(self, rows: Array, memory: HeadingMemory) -> tuple[Array, HeadingMemory]:
        """Rows (n, rows, d, *batch) in the frame of the policy."""
        rows, seen = look(self.filter, self._constants.robot, rows, memory.seen)
        return rows, memory._replace(seen=seen)

    def apply(self, choices: Array, memory: HeadingMemory) -> tuple[Array, HeadingMemory]:
        """Actions (n, a, *batch) of choices (n, k, *batch), by law (4)."""
        if self.filter.turns_body:
            return self._turn_bodies(choices, memory), memory
        constants, seen = self._constants, memory.seen
        raw, f = held(self.filter, choices, seen), vector_of(seen.net_bearing)
        gate = constants.robot.gate
        if constants.certified:
            limit, previous = array_form(turn_limit)(constants.max_turn), vector_of(memory.headings)
            certified = array_form(certify_one)
            h = certified(raw, f, previous, gate.min_alignment, gate.dead_zone, limit)
        else:
            h = array_form(split)(raw)[1]
        along = array_form(dot)(h, f)
        headings = jnp.stack(h, axis=1)
        return headings * self._sure(along, seen.degree)[:, None], memory._replace(
            headings=headings
        )

    def _sure(self, along: Array, degree: Array) -> Array:
        """Speed s sgn(hᵀf) max(0, |hᵀf| − e), m/s."""
        robot = self._constants.robot
        sure = array_form(without_error)(along, robot.error_chord * degree)
        if not self._constants.speed_scaled:
            return sure
        scale = array_form(scale_of_step)
        return sure * scale(degree, robot.merge_radius, robot.gate.duration)

    def _turn_bodies(self, choices: Array, memory: HeadingMemory) -> Array:
        """Gated turn rates, and speed v = s mᵀf along the mean body axis m (theory 4)."""
        seen, gate = memory.seen, self._constants.robot.gate
        f = array_form(triple)(vector_of(seen.net_bearing))
        rates = array_form(desired_rates)(vector_of(choices), gate)
        if self._constants.certified:
            rates = array_form(gated_rates)(rates, f, seen.pitch, gate)
        sent, m = turned(rates, seen.pitch, gate, self._sent_as)
        speed = self._sure(array_form(dot)(m, f), seen.degree)
        actions = jnp.stack([speed, *sent], axis=1)
        return jnp.where((seen.degree == 0.0)[:, None], 0.0, actions)


def turned(rates: Any, pitch: Array, gate: Gate, sent_as: Any) -> tuple[Any, Vector]:
    """``turning.turn``: the rates that are sent, and the mean body axis for the rounded ones."""
    sent = [jnp.broadcast_to(rate, pitch.shape) for rate in rates[: 1 if gate.planar else 2]]
    rounded = [rate.astype(sent_as).astype(pitch.dtype) for rate in sent]
    executed = array_form(rates_of)((None, *rounded), gate)
    return rounded, array_form(mean_axis)(executed, pitch, gate)
