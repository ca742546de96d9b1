"""Policies as pure functions: observations and memory → actions and memory."""

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from rendezvous_env.checks import short_repr
from rendezvous_env.deprecation import warn_renamed
from rendezvous_env.jax.arrays.array_form import Array, array_form, total
from rendezvous_env.robots.single_integrator import limit_factor
from rendezvous_env.safety.heading import step_scale
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.scenarios import ScenarioLike, resolve

from .. import policy as policies
from .arrays import length_of, where

Memory = Any
"""Tree of arrays, (..., n, …); () of a policy without memory."""


class Rows(NamedTuple):
    """Parts of observations, as ``ObservedRows``."""

    neighbours: Array  # (..., K, d), m/s
    obstacles: Array  # (..., M, S, d)
    gravity: Array | None  # (..., d)
    velocity: Array | None  # (..., d), m/s


@dataclass(frozen=True)
class JaxPolicy(ABC):
    """Policy of a scenario as pure functions, for ``jit``, ``scan`` and ``grad``.

    Leading axes (...) are those of the observations, for example (B,) or none.
    """

    scenario: Scenario

    def begin(self, batch: tuple[int, ...] = ()) -> Memory:
        """Memory of environments (...) before their first step."""
        return ()

    @abstractmethod
    def act(self, observations: Any, memory: Memory, time: Any = 0.0) -> tuple[Array, Memory]:
        """Actions of a step, and the memory after it.

        Args:
            observations: (..., n, rows, d), see ``scenario.observation_layout``.
            memory: of ``begin`` or of the step before.
            time: since the start of each episode, s, (...) or a number.

        Returns:
            Actions (..., n, a), within ``scenario.action_bounds``, and memory.
        """

    def forget(self, memory: Memory, ended: Array) -> Memory:
        """Memory with that of environments whose mask (...) is true begun anew."""
        return where(jnp.asarray(ended), self.begin(jnp.shape(ended)), memory)

    def rows_of(self, observations: Any) -> Rows:
        """Parts of observations (..., rows, d), as ``ObservationLayout.split``."""
        layout, seen = self.scenario.observation_layout, jnp.asarray(observations)
        seen = seen.astype(jnp.result_type(float))
        slots = layout.obstacle_slots, layout.rows_per_obstacle, layout.dim
        return Rows(
            neighbours=seen[..., layout.neighbours, :],
            obstacles=seen[..., layout.obstacles, :].reshape(*seen.shape[:-2], *slots),
            gravity=seen[..., -1, :] if layout.senses_gravity else None,
            velocity=seen[..., -1, :] if layout.senses_velocity else None,
        )


def sum_of(seen: Rows) -> Array:
    """Net bearing fᵢ, (..., d), m/s."""
    return jnp.asarray(total(seen.neighbours, axis=-2))


def degree_of(seen: Rows) -> Array:
    """Degree Dᵢ = Σⱼ aᵢⱼ, (...), m/s."""
    return jnp.asarray(total(length_of(seen.neighbours), axis=-1))


def scale_of(degree: Array, scenario: Scenario) -> Array:
    """min(1, r/(2 Dᵢ τ)) of degrees (...), m/s (theory 4)."""
    return array_form(step_scale)(degree, scenario.merge_radius, scenario.tau)


def within_limits(actions: Array, scenario: Scenario) -> Array:
    """Limit actions (..., a) to the scenario's bounds, as ``baselines.policy.within_limits``."""
    bounds = jnp.asarray(scenario.action_bounds, actions.dtype)
    if scenario.model.nonholonomic:
        return jnp.clip(actions, -bounds, bounds)
    factor = array_form(limit_factor)(length_of(actions), scenario.action_bounds[0])
    return actions * factor[..., None]


_FORMS: dict[str, Callable[[Any], JaxPolicy]] = {}


def register(*names: str) -> Callable[[Any], Any]:
    """Decorator: a function of a policy of ``baselines`` with such a name, to its JAX form."""

    def enter(form_of: Any) -> Any:
        for name in names:
            _FORMS[name] = form_of
        return form_of

    return enter


def names() -> list[str]:
    """Names of policies with a JAX form."""
    return list(_FORMS)


def make(name: str | os.PathLike[str], scenario: ScenarioLike, **options: Any) -> JaxPolicy:
    """JAX form of a policy for a scenario; arguments are those of ``baselines.make``.

    Raises:
        NotImplementedError: for a policy, or robots, that the JAX form does not cover.
        ValueError: as ``baselines.make``.
    """
    if isinstance(name, str) and (current := policies.current_name(name)) != name:
        warn_renamed(f"policy {name!r}", repr(current))
        name = current
    policy = policies.make(name, scenario, **options)
    at_path = isinstance(name, os.PathLike) or name.startswith(policies.AT_PATH)
    kind = policies.AT_PATH if at_path else name
    if kind not in _FORMS:
        raise NotImplementedError(
            f"policy {short_repr(name)} has no JAX form; use baselines.make, or one of "
            f"{', '.join(_FORMS)}"
        )
    if resolve(scenario).mixes_models:
        raise NotImplementedError(
            f"policy {short_repr(name)} of a mixed team has no JAX form; use baselines.make"
        )
    return _FORMS[str(kind)](policy)
