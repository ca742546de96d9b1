"""Functions of a few environments of a batch, for rare events: merges and new episodes."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from .array_form import Array

_SHARE = 32  # part of a batch that is computed at a time
_FEWEST = 16  # environments


def for_envs(
    which: Array, function: Callable[[Any], Any], given: Any, otherwise: Any, every: bool
) -> Any:
    """``function(given)`` where a mask (*batch) holds, else ``otherwise``.

    ``given`` and the results are trees of arrays with the environment axis last. With ``every`` the
    function is computed for all environments, so that gradients pass; else for the masked ones, a
    few at a time.
    """
    if every:
        return jax.tree.map(lambda a, b: jnp.where(which, a, b), function(given), otherwise)
    if which.ndim == 0:
        return jax.lax.cond(which, lambda: function(given), lambda: otherwise)
    batch = which.shape[0]
    size = min(batch, max(_FEWEST, batch // _SHARE))

    numbered = jnp.cumsum(which)
    place = jnp.where(which, numbered - 1, batch + size)
    # unsigned, so that no index is looked up from the end
    order = jnp.full(batch + size, batch, jnp.uint32)
    order = order.at[place].set(jnp.arange(batch, dtype=jnp.uint32), mode="drop")

    def work(now: Any) -> Any:
        first, results = now
        teams = jax.lax.dynamic_slice_in_dim(order, first, size)
        some = jax.tree.map(lambda a: jnp.take(a, teams, axis=-1, mode="clip"), given)
        results = jax.tree.map(
            lambda a, b: a.at[..., teams].set(b, mode="drop"), results, function(some)
        )
        return first + size, results

    begun = jnp.zeros((), numbered.dtype), otherwise
    return jax.lax.while_loop(lambda now: now[0] < numbered[-1], work, begun)[1]
