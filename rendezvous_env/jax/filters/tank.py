"""The energy-tank filter (theorem D) over arrays: ``safety.tank``.

Arrays have the environment axis last. Vectors are tuples of arrays (n, *batch): all robots at once.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from ...physics.vectors import dot, norm, rounded, scaled, split, triple
from ...robots.single_integrator import limit_factor
from ...robots.unicycle import clip
from ...safety.heading import without_error
from ...safety.tank import (
    _LARGEST,
    EnergyTank,
    _driven,
    _moved,
    certain_descent,
    descending_velocity,
    descent_scale,
    promised_descent,
    unit_of_tanks,
)
from ...safety.turning import Robot, desired_rates, gated_rates, rates_of
from ..arrays.array_form import Array, array_form, select
from .frames import LastObservation, held, look, nothing_seen, vector_of
from .heading import turned


class TankMemory(NamedTuple):
    """State of the filter between steps."""

    levels: Array  # (n, *batch), stored energy A, m²/s
    deposits: Array  # (n, *batch), G of the action in progress, m²/s
    linked: Array  # (n, *batch), whether a robot has seen a neighbour before the action
    seen: LastObservation


class Account(NamedTuple):
    """Constants of a step of single integrators with a tank; arrays of one shape."""

    f: Any  # net bearing, a tuple, m/s
    degree: Array  # D, m/s
    strength: Array  # ‖f‖, m/s
    scale: Array  # s of theorem D
    owed: Array  # required decrease of V in a step, m²/s
    error: Any  # e, the error of f, m/s; 0.0 where bearings are exact


def account_of(f: Any, degree: Array, robot: Robot) -> Account:
    """Account of a step with net bearing f, a tuple, and degree D, m/s."""
    gate, (strength, _) = robot.gate, array_form(split)(f)
    error = robot.error_chord * degree if robot.error_chord > 0.0 else 0.0
    limits = robot.merge_radius, gate.duration, robot.speed_limit
    scale = array_form(descent_scale)(strength, degree, *limits)
    owed = array_form(promised_descent)(strength, scale, gate.min_alignment, gate.duration, error)
    return Account(f, degree, strength, scale, owed, error)


def gain_of(account: Account, displacement: Any, robot: Robot) -> Array:
    """Gain G(Δ) of the tank from a displacement Δ, a tuple, m; m²/s."""
    f, degree, radius = account.f, account.degree, robot.merge_radius
    sure = array_form(certain_descent)(f, degree, displacement, radius, account.error)
    return jnp.asarray(sure - account.owed)


def executed(desired: Any, account: Account, levels: Array, robot: Robot) -> tuple[Any, Array]:
    """``tank._spend``: the velocity sent, a tuple, m/s, for a desired one, and its gain, m²/s.

    A desired velocity is executed where A + G ≥ 0, else law (4) along it.
    """
    limit, gate = robot.speed_limit, robot.gate

    def gain(sent: Any) -> Array:
        moved, _ = array_form(_moved)(sent, limit, gate.duration)
        return gain_of(account, moved, robot)

    speed, _ = array_form(split)(desired)
    factor = array_form(limit_factor)(speed, limit)
    wanted = array_form(rounded)(array_form(scaled)(desired, factor))
    cap = account.scale, gate.min_alignment, account.error
    law = array_form(rounded)(array_form(descending_velocity)(desired, account.f, *cap))
    sent = select(levels + gain(wanted) >= 0.0, wanted, law)
    return sent, gain(sent)


class Tank:
    """The filter of a scenario, with the settings of an engine filter.

    Args:
        safety_filter: with the settings.
        sent_as: type of actions, to which they are rounded.
    """

    def __init__(self, safety_filter: EnergyTank, sent_as: Any) -> None:
        self.filter, self._sent_as = safety_filter, sent_as
        self._robot, self._unit = safety_filter._robot, unit_of_tanks(safety_filter.scenario)

    def begin(self, n: int, d: int, batch: tuple[int, ...], dtype: Any) -> TankMemory:
        """State before the first observation: the budget."""
        zero = jnp.zeros((n, *batch), dtype)
        seen = nothing_seen(n, d, batch, dtype)
        return TankMemory(zero + self.filter.budget, zero, jnp.zeros((n, *batch), bool), seen)

    def observe(self, rows: Array, memory: TankMemory) -> tuple[Array, TankMemory]:
        """Rows (n, rows, d, *batch) in the frame of the policy, and a row with the level."""
        rows, seen = look(self.filter, self._robot, rows, memory.seen)
        if self.filter.observes_level:
            level = jnp.minimum(memory.levels / self._unit, _LARGEST).astype(rows.dtype)
            none = [jnp.zeros_like(level)] * (rows.shape[2] - 1)
            rows = jnp.concatenate([rows, jnp.stack([level, *none], axis=1)[:, None]], axis=1)
        return rows, memory._replace(seen=seen)

    def apply(self, choices: Array, memory: TankMemory) -> tuple[Array, TankMemory]:
        """Actions (n, a, *batch) of choices (n, k, *batch): executed where A + G ≥ 0."""
        spend = self._spend_bodies if self.filter.turns_body else self._spend
        actions, deposits = spend(choices, memory)
        sees = memory.seen.degree > 0.0
        return jnp.where(sees[:, None], actions, 0.0), memory._replace(
            deposits=jnp.where(sees, deposits, 0.0), linked=sees
        )

    def _spend(self, choices: Array, memory: TankMemory) -> tuple[Array, Array]:
        """``tank._spend``: velocities and deposits of single integrators."""
        robot, seen = self._robot, memory.seen
        account = account_of(vector_of(seen.net_bearing), seen.degree, robot)
        desired = array_form(scaled)(held(self.filter, choices, seen), robot.speed_limit)
        sent, deposits = executed(desired, account, memory.levels, robot)
        return jnp.stack(sent, axis=1), deposits

    def _spend_bodies(self, choices: Array, memory: TankMemory) -> tuple[Array, Array]:
        """``tank._spend_bodies``: actions and deposits of nonholonomic robots."""
        robot, seen, gate = self._robot, memory.seen, self._robot.gate
        limit, radius, pitch = robot.speed_limit, robot.merge_radius, seen.pitch
        f, error = array_form(triple)(vector_of(seen.net_bearing)), robot.error_chord * seen.degree
        e = error if robot.error_chord > 0.0 else 0.0

        def driven(m: Any, speed: Array) -> tuple[Array, Array]:
            sent = speed.astype(self._sent_as).astype(pitch.dtype)
            moved = array_form(_driven)(m, (sent,), limit, gate)
            return sent, array_form(certain_descent)(f, seen.degree, moved, radius, e)

        choice = vector_of(choices)
        wanted, m = turned(array_form(desired_rates)(choice[1:], gate), pitch, gate, self._sent_as)
        speed, deposit = driven(m, array_form(clip)(choice[0], 1.0) * limit)
        accepted = memory.levels + deposit >= 0.0
        rates = array_form(rates_of)((speed, *wanted), gate)
        gated = array_form(gated_rates)(rates, f, pitch, gate)
        turning, m = turned(gated, pitch, gate, self._sent_as)
        strength = array_form(norm)(f)
        scale = array_form(descent_scale)(strength, seen.degree, radius, gate.duration, limit)
        law_speed = scale * array_form(without_error)(array_form(dot)(m, f), error)
        law_speed, law_deposit = driven(m, law_speed)
        sent = select(accepted, (speed, *wanted), (law_speed, *turning))
        return jnp.stack(sent, axis=1), jnp.where(accepted, deposit, law_deposit)

    def update(
        self, memory: TankMemory, contact: Array, merged_into: Array, ran: Array
    ) -> TankMemory:
        """``tank._book``: A ← max(A + G, 0) in environments that ran, (*batch)."""
        deposits = jnp.where(ran & ~(contact & (memory.deposits > 0.0)), memory.deposits, 0.0)
        levels = jnp.maximum(memory.levels + deposits, 0.0)
        robots = jnp.arange(len(levels)).reshape(-1, *[1] * (levels.ndim - 1))
        gone = merged_into != robots
        into = merged_into[None] == robots[:, None]  # (survivor, robot, *batch)
        levels = jnp.sum(jnp.where(into, levels, 0.0), axis=1)
        if self.filter._follow_v:
            before = jnp.sum(memory.linked, axis=0)
            lost = jnp.sum(memory.linked & gone, axis=0)
            kept = (before - lost - 1) / jnp.maximum(before - 1, 1)
            levels = jnp.where(lost > 0, levels * kept.astype(levels.dtype), levels)
        nothing = jnp.zeros_like(memory.deposits)
        return memory._replace(
            levels=levels, deposits=nothing, linked=jnp.zeros_like(memory.linked)
        )
