"""Loops over trees of arrays, packed so that XLA compiles few kernels."""

from collections.abc import Callable
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

_MOST = 8


def while_busy(body: Callable[[Any], Any], begun: Any) -> Any:
    """Repeat ``body`` while any entry of the last array of its tree, (*batch), is true.

    Arrays (…, *batch) of few rows are carried as rows of one array of floats, integers below 2²⁴
    too: on a CPU, XLA makes a kernel for each array that a loop carries, and kernels take most of
    the time of compilation.
    """
    given, tree = jax.tree.flatten(begun)
    leaves = [jnp.asarray(leaf) for leaf in given]
    batch, dtype = leaves[-1].shape, jnp.result_type(float)
    own = [leaf.shape[: leaf.ndim - len(batch)] for leaf in leaves]
    small = [prod(shape) <= _MOST for shape in own]
    ends = np.cumsum([prod(shape) for shape, few in zip(own, small, strict=True) if few])

    def packed(values: Any) -> Any:
        pairs = list(zip(jax.tree.leaves(values), small, strict=True))
        parts = [jnp.asarray(leaf, dtype).reshape(-1, *batch) for leaf, few in pairs if few]
        return jnp.concatenate(parts), [leaf for leaf, few in pairs if not few]

    def unpacked(carried: Any) -> Any:
        parts, large = iter(jnp.split(carried[0], ends[:-1])), iter(carried[1])
        return tree.unflatten(
            next(parts).reshape(shape + batch).astype(leaf.dtype) if few else next(large)
            for shape, leaf, few in zip(own, leaves, small, strict=True)
        )

    last = jax.lax.while_loop(
        lambda carried: jnp.any(carried[0][-1] != 0.0),
        lambda carried: packed(body(unpacked(carried))),
        packed(begun),
    )
    return unpacked(last)
