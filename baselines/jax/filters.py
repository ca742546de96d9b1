"""Filters of ``rendezvous_env.jax`` for policies, which learn nothing of contacts and merges.

Arrays are (..., n, …).
"""

from typing import Any

import jax
import jax.numpy as jnp

from rendezvous_env.jax.filters.heading import Heading
from rendezvous_env.jax.filters.tank import Account, Tank, account_of, executed, gain_of
from rendezvous_env.safety.turning import Robot
from rendezvous_env.scenario.scenario import Scenario

from .arrays import Array

__all__ = ["Account", "TeamFilter", "account_of", "gain_of", "spend"]


def spend(desired: Any, account: Account, levels: Array, robot: Robot) -> tuple[Any, Array]:
    """Executed velocities, a pair, m/s, of desired ones, and the levels after the step.

    A robot without a visible neighbour stops at no cost.
    """
    velocity, gain = executed(desired, account, levels, robot)
    sees = account.degree > 0.0
    sent = tuple(jnp.where(sees, part, 0.0) for part in velocity)
    return sent, jnp.where(sees, jnp.maximum(levels + gain, 0.0), levels)


class TeamFilter:
    """A filter in the robots' frames.

    Args:
        form: the filter, whose arrays are (n, …, *batch).
        scenario: of the robots.
    """

    def __init__(self, form: Heading | Tank, scenario: Scenario) -> None:
        self._form, self._team = form, (scenario.n_robots, scenario.dim)

    def begin(self, batch: tuple[int, ...]) -> Any:
        """State of environments (...), arrays (..., n, …)."""
        return _first(self._form.begin(*self._team, batch, jnp.result_type(float)), len(batch))

    def apply(self, observations: Array, choices: Array, state: Any) -> tuple[Array, Any]:
        """Actions (..., n, a) of choices (..., n, k), and the state after their step."""
        axes = choices.ndim - 2
        rows, choices, state = (_last(tree, axes) for tree in (observations, choices, state))
        _, state = self._form.observe(rows, state)
        actions, state = self._form.apply(choices, state)
        if isinstance(self._form, Tank):
            never = jnp.zeros_like(state.levels, bool)
            alone = jnp.arange(len(never)).reshape(-1, *[1] * axes)
            alone = jnp.broadcast_to(alone, never.shape)
            state = self._form.update(state, never, alone, ~never[0])
        return _first((actions.astype(jnp.float32), state), axes)


def _first(tree: Any, axes: int) -> Any:
    """Trees with the last axes first."""
    return jax.tree.map(
        lambda part: jnp.moveaxis(part, range(-axes, 0), range(axes)) if axes else part, tree
    )


def _last(tree: Any, axes: int) -> Any:
    """Trees with the first axes last."""
    return jax.tree.map(
        lambda part: jnp.moveaxis(part, range(axes), range(-axes, 0)) if axes else part, tree
    )
