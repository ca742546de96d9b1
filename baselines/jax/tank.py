"""Energy tank of single integrators over arrays (theorem D), as ``safety.tank`` books it.

Vectors are pairs of arrays (...), stored energies arrays (...), m²/s. Steps are booked as
commanded.
"""

from typing import Any

import jax.numpy as jnp

from rendezvous_env.jax.filters.tank import Account, account_of, executed, gain_of
from rendezvous_env.safety.turning import Robot

from .arrays import Array

__all__ = ["Account", "account_of", "gain_of", "spend"]


def spend(desired: Any, account: Account, levels: Array, robot: Robot) -> tuple[Any, Array]:
    """Executed velocities, a pair, m/s, of desired ones, and the levels after the step.

    A robot without a visible neighbour stops at no cost.
    """
    velocity, gain = executed(desired, account, levels, robot)
    sees = account.degree > 0.0
    sent = tuple(jnp.where(sees, part, 0.0) for part in velocity)
    return sent, jnp.where(sees, jnp.maximum(levels + gain, 0.0), levels)
