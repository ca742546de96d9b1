"""Functions of a few environments of a batch, for rare events: merges and new episodes."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from .array_form import Array

_SHARE = 32  # part of a batch that is computed at a time
_FEWEST = 16  # environments


def for_teams(
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

    packed, unpack = _packed(given)

    def work(now: Any) -> Any:
        left, results = now
        place = jnp.where(left, jnp.cumsum(left) - 1, size)
        teams = jnp.full(size, batch).at[place].set(jnp.arange(batch), mode="drop")
        some = unpack({name: jnp.take(a, teams, axis=1, mode="clip") for name, a in packed.items()})
        found, _ = _packed(function(some))
        results = {
            name: a.at[:, teams].set(found[name], mode="drop") for name, a in results.items()
        }
        return left.at[teams].set(False, mode="drop"), results

    begun, unpack_results = _packed(otherwise)
    return unpack_results(jax.lax.while_loop(lambda now: jnp.any(now[0]), work, (which, begun))[1])


def _packed(tree: Any) -> tuple[dict[str, Array], Callable[[dict[str, Array]], Any]]:
    """Leaves (…, *batch) as one matrix (rows, batch) for each type, and the inverse.

    One gather or scatter of a matrix is compiled faster than one of every leaf.
    """
    leaves, structure = jax.tree.flatten(tree)
    names = [str(leaf.dtype) for leaf in leaves]
    rows = {
        name: [one.reshape(-1, one.shape[-1]) for one, its in zip(leaves, names, strict=True)
               if its == name]
        for name in dict.fromkeys(names)
    }  # fmt: skip

    def unpack(matrices: dict[str, Array]) -> Any:
        first, found = dict.fromkeys(matrices, 0), []
        for leaf, name in zip(leaves, names, strict=True):
            count = leaf.size // leaf.shape[-1]
            part = matrices[name][first[name] : first[name] + count]
            found.append(part.reshape(*leaf.shape[:-1], part.shape[-1]))
            first[name] += count
        return jax.tree.unflatten(structure, found)

    return {name: jnp.concatenate(parts) for name, parts in rows.items()}, unpack
