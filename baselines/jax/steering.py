"""Inputs of robots that turn over arrays, from the equations of ``baselines.steering``.

Vectors are pairs or triples of arrays (..., n), actions arrays (..., n, a).
"""

from typing import Any

import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form
from rendezvous_env.safety.turning import Gate, mean_axis, rates_of
from rendezvous_env.scenario.scenario import Scenario

from .. import steering
from ..obstacle_rules import merged_intervals_2d
from ..obstacle_rules.obstacle_avoidance import FLAT
from . import planes
from .arrays import Array, angle_of, parts_of
from .policy import Rows, within_limits

axis_is_clear = array_form(merged_intervals_2d.axis_is_clear)
inputs_towards = array_form(steering.inputs_towards)
"""Speed and turn rates for a desired velocity, a triple, m/s, and the pitch, (..., n), rad."""


def pitch_of(seen: Rows, gate: Gate) -> Array:
    """β, (..., n), rad; 0 in the plane and for robots that do not turn."""
    if gate.planar or seen.gravity is None:
        return jnp.zeros(seen.neighbours.shape[:-2], seen.neighbours.dtype)
    return angle_of(-seen.gravity[..., 0], -seen.gravity[..., 2])


def padded(vector: Any) -> Any:
    """A pair or triple as a triple."""
    return (*vector, jnp.zeros_like(vector[0])) if len(vector) == 2 else tuple(vector)


def sent(speed: Array, rates: Any, gate: Gate) -> Array:
    """Actions of a speed and turn rates, in float32."""
    parts = [jnp.broadcast_to(part, speed.shape) for part in rates[: 1 if gate.planar else 2]]
    return jnp.stack([speed, *parts], axis=-1).astype(jnp.float32)


def rates_in(actions: Array, gate: Gate) -> Any:
    """Executed turn rates of actions, a pair, rad/s."""
    return array_form(rates_of)(parts_of(actions), gate)


def turned(vectors: Array, actions: Array, pitch: Array, gate: Gate) -> Array:
    """Vectors (..., n, d) in the body frames after actions."""
    after = array_form(steering.turned_back)(
        padded(parts_of(vectors)), rates_in(actions, gate), pitch, gate
    )
    return jnp.stack(after[: vectors.shape[-1]], axis=-1)


def velocities(actions: Array, pitch: Array, gate: Gate) -> Any:
    """Mean velocities v m over the step of actions, triples, m/s."""
    m = array_form(mean_axis)(rates_in(actions, gate), pitch, gate)
    return tuple(part * actions[..., 0] for part in m)


def steered(velocity: Any, seen: Rows, pitch: Array, gate: Gate, scenario: Scenario) -> Array:
    """As ``obstacle_avoidance.steered`` for robots that turn: actions (..., n, a)."""
    speed, rates = inputs_towards(padded(velocity), pitch, gate)
    actions = within_limits(sent(speed, rates, gate), scenario)
    rates = rates_in(actions, gate)
    if gate.planar:
        clear = axis_is_clear(rates, seen.obstacles, gate)
    else:
        clear = planes.axis_is_clear(rates, pitch, planes.widened_cones(seen.obstacles, FLAT), gate)
    return actions.at[..., 0].set(jnp.where(clear, actions[..., 0], 0.0))
