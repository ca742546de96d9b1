"""Energy tank of single integrators over arrays (theorem D), as ``safety.tank`` books it.

Vectors are pairs of arrays (...), stored energies arrays (...), m²/s. Steps are booked as
commanded.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form
from rendezvous_env.physics.vectors import dot, scaled, split
from rendezvous_env.robots.single_integrator import limit_factor
from rendezvous_env.safety.tank import (
    _moved,
    certain_descent,
    descending_velocity,
    descent_scale,
    promised_descent,
)
from rendezvous_env.safety.turning import Robot

from .arrays import Array, select

_dot, _scaled, _split = map(array_form, (dot, scaled, split))
_certain, _scale, _promised = map(array_form, (certain_descent, descent_scale, promised_descent))


class Account(NamedTuple):
    """Constants of a step of a robot with a tank."""

    f: Any  # pair, m/s
    degree: Array  # D, m/s
    strength: Array  # ‖f‖, m/s
    scale: Array  # s of theorem D
    owed: Array  # decrease of V that a step must promise, m²/s


def account_of(f: Any, degree: Array, robot: Robot) -> Account:
    """Account of a step with net bearing f, a pair, and degree D, m/s."""
    gate, strength = robot.gate, _split(f)[0]
    scale = _scale(strength, degree, robot.merge_radius, gate.duration, robot.speed_limit)
    return Account(
        f, degree, strength, scale, _promised(strength, scale, gate.min_alignment, gate.duration)
    )


def gain_of(account: Account, displacement: Any, robot: Robot) -> Array:
    """Gain G(Δ) of the tank from a displacement Δ, a pair, m; m²/s."""
    sure = _certain(account.f, account.degree, displacement, robot.merge_radius)
    return sure - account.owed


def spend(desired: Any, account: Account, levels: Array, robot: Robot) -> tuple[Any, Array]:
    """Executed velocities, a pair, m/s, of desired ones, and the levels after the step.

    A desired velocity is executed where A + G ≥ 0, else law (4) along it.
    """
    limit, duration, margin = robot.speed_limit, robot.gate.duration, robot.gate.min_alignment
    wanted = _rounded(_scaled(desired, array_form(limit_factor)(_split(desired)[0], limit)))
    accepted = levels + gain_of(account, _moved_by(wanted, limit, duration), robot) >= 0.0
    law = array_form(descending_velocity)(desired, account.f, account.scale, margin)
    law = _rounded(law)
    sees = account.degree > 0.0
    sent = _scaled(select(accepted, wanted, law), jnp.where(sees, 1.0, 0.0))
    gain = gain_of(account, _moved_by(sent, limit, duration), robot)
    return sent, jnp.where(sees, jnp.maximum(levels + gain, 0.0), levels)


def _moved_by(velocity: Any, limit: float, duration: float) -> Any:
    return array_form(_moved)(velocity, limit, duration)[0]


def _rounded(vector: Any) -> Any:
    """Round to float32, as the commands of robots are."""
    return tuple(part.astype(jnp.float32).astype(part.dtype) for part in vector)
