"""Control laws of the paper as functions of arrays, for policies and gradients."""

from typing import Any

import jax.numpy as jnp

from ..scenario.observation_layout import ObservationLayout
from .arrays.array_form import Array, total


def net_bearing(observations: Any, layout: ObservationLayout) -> Array:
    """fᵢ = Σⱼ aᵢⱼ gᵢⱼ, (..., d), m/s, of observations (..., rows, d) with this layout."""
    rows = jnp.asarray(observations)[..., layout.neighbours, :]
    return total(rows, axis=-2)


def bearing_only_law(net_bearing: Any) -> Array:
    """Velocity of the bearing-only law.

        ṗᵢ = fᵢ                                                         (Zhao & Zheng, eq. 1)

    Args:
        net_bearing: fᵢ, (..., d), m/s, in the robot's frame.

    Returns:
        Velocities, (..., d), m/s.
    """
    return jnp.asarray(net_bearing)


def flexible_velocity(net_bearing: Any, headings: Any) -> Array:
    """Velocity of the flexible bearing-only law.

        ṗᵢ = hᵢ hᵢᵀ fᵢ                                                  (Zhao & Zheng, eq. 4)

    Args:
        net_bearing: fᵢ, (..., d), m/s, in the robot's frame.
        headings: hᵢ, (..., d), unit vectors in the same frame.

    Returns:
        Velocities, (..., d), m/s.
    """
    f, h = jnp.asarray(net_bearing), jnp.asarray(headings)
    return h * jnp.sum(h * f, axis=-1, keepdims=True)
