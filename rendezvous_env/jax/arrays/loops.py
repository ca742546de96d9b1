"""Loops over trees of arrays, packed so that XLA compiles few kernels."""

from collections.abc import Callable
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .array_form import Array


def while_busy(body: Callable[[Any], Any], begun: Any) -> Any:
    """Repeat ``body`` while any entry of the last array of its tree, (*batch), is true.

    The arrays (…, *batch) are carried as rows of one array of floats, integers below 2²⁴ too: on a
    CPU, XLA makes a kernel for each array that a loop carries, and compiles kernels slowly.
    """
    given, tree = jax.tree.flatten(begun)
    leaves = [jnp.asarray(leaf) for leaf in given]
    batch, dtype = leaves[-1].shape, jnp.result_type(float)
    own = [leaf.shape[: leaf.ndim - len(batch)] for leaf in leaves]
    ends = np.cumsum([prod(shape) for shape in own])

    def packed(values: Any) -> Array:
        parts = [jnp.asarray(leaf, dtype).reshape(-1, *batch) for leaf in jax.tree.leaves(values)]
        return jnp.concatenate(parts)

    def unpacked(rows: Array) -> Any:
        parts = zip(jnp.split(rows, ends[:-1]), own, leaves, strict=True)
        each = [part.reshape(shape + batch).astype(leaf.dtype) for part, shape, leaf in parts]
        return jax.tree.unflatten(tree, each)

    rows = jax.lax.while_loop(
        lambda rows: jnp.any(rows[-1] != 0.0),
        lambda rows: packed(body(unpacked(rows))),
        packed(begun),
    )
    return unpacked(rows)
