"""Arithmetic of arrays with finite derivatives, and small vectors as the last axis of arrays."""

from typing import Any

import jax
import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import Array, angle_of, select, square_root
from rendezvous_env.jax.arrays.selection import divided

__all__ = [
    "Array", "angle_of", "divided", "length_of", "parts_of", "select", "square_root", "where",
]  # fmt: skip


def where(mask: Array, new: Any, old: Any) -> Any:
    """The first of two trees of arrays (..., …) where a mask (...) holds, else the second."""

    def one(a: Array, b: Array) -> Array:
        return jnp.where(mask.reshape(*mask.shape, *[1] * (a.ndim - mask.ndim)), a, b)

    return jax.tree.map(one, new, old)


def length_of(vectors: Array) -> Array:
    """Lengths of vectors (..., d), with a derivative of 0 at zero."""
    return square_root(jnp.sum(vectors * vectors, axis=-1))


def parts_of(vectors: Array) -> tuple[Array, ...]:
    """Vectors (..., d) as a tuple of d arrays, as equations of ``physics`` take them."""
    return tuple(vectors[..., k] for k in range(vectors.shape[-1]))
