"""Learned policies as pure functions: network, features and base controller over arrays."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form
from rendezvous_env.jax.filters.heading import Heading
from rendezvous_env.jax.filters.tank import Tank
from rendezvous_env.physics.vectors import rotated
from rendezvous_env.safety.heading import certify_one, scale_of_step, turn_limit
from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.safety.turning import Robot, robot_of

from ..learned.base_controller import BaseController
from ..learned.features import FeatureLayout
from ..learned.learned_policy import LearnedPolicy
from ..learned.numpy_actor import NumpyActor, RecurrentUnit
from ..learned.policy_settings import PolicySettings
from ..learned.shipped import NAMES
from ..policy import AT_PATH
from ..steering import WITHIN
from . import steady_frames
from .arrays import Array, divided, parts_of, where
from .features import FeatureMemory, RecentMotion, features, no_memory
from .filters import TeamFilter, account_of, spend
from .merged_intervals import direction_of, merged_headings
from .policy import (
    JaxPolicy,
    Memory,
    Rows,
    degree_of,
    register,
    sum_of,
    within_limits,
)

Layer = tuple[Array, Array]


class Parameters(NamedTuple):
    """Weights of a network: pairs of a matrix (outputs, inputs) and a bias (outputs,)."""

    neighbours: list[Layer]
    obstacles: list[Layer]
    memory: tuple[Layer, Layer] | None
    layers: list[Layer]
    last: Layer


def parameters_of(actor: NumpyActor) -> Parameters:
    """Weights of an actor, as JAX arrays."""
    unit = actor.memory
    memory: Any = None if unit is None else (unit.seen, unit.kept)
    given: Any = *actor.sets, memory, actor.layers, actor.last
    return jax.tree.map(jnp.asarray, Parameters(*given))


def preferences(
    parameters: Parameters, layout: FeatureLayout, shown: Array, hidden: Array
) -> tuple[Array, Array]:
    """Logits of the choices, (..., choices), and recurrent state, as ``NumpyActor.preferences``.

    Args:
        parameters: the weights.
        layout: of the features.
        shown: features (..., layout.size).
        hidden: recurrent state, (..., units); (..., 0) without one.
    """
    seen = layout.split(shown.astype(jnp.float32))
    sets = (parameters.neighbours, seen.neighbours), (parameters.obstacles, seen.obstacles)
    pooled = [part for layers, rows in sets for part in _pooled(layers, rows)]
    known = jnp.concatenate([*pooled, seen.context], axis=-1)
    if parameters.memory is not None:
        unit = _Unit(*parameters.memory)
        hidden = array_form(RecurrentUnit.next)(unit, known, hidden)
        known = jnp.concatenate([hidden, known], axis=-1)
    return _linear(parameters.last, _through(parameters.layers, known)), hidden


class _Unit(NamedTuple):
    """Weights of a recurrent unit by the names that its equations use."""

    seen: Layer
    kept: Layer


def _linear(layer: Layer, values: Array) -> Array:
    weight, bias = layer
    return jnp.matmul(values, weight.T, precision="highest") + bias


def _through(layers: list[Layer], values: Array) -> Array:
    for layer in layers:
        values = jnp.maximum(_linear(layer, values), 0.0)
    return values


def _pooled(layers: list[Layer], rows: Array) -> tuple[Array, Array]:
    """Mean and maximum of features, which are not negative, over the rows that are present."""
    if rows.shape[-2] == 0:
        none = jnp.zeros((*rows.shape[:-2], len(layers[-1][1])), rows.dtype)
        return none, none
    present = jnp.any(rows != 0.0, axis=-1, keepdims=True)
    found = jnp.where(present, _through(layers, rows), 0.0)
    count = jnp.sum(present, axis=-2).astype(rows.dtype)
    return divided(jnp.sum(found, axis=-2), count), jnp.max(found, axis=-2)


class _Kept(NamedTuple):
    """Memory of a learned policy: arrays (...), (..., n) and (..., n, …).

    Headings and velocities of robots that turn, or in 3-D, are in a frame or plane.
    """

    steps: Array  # (...), since the last decision
    choices: Array  # (..., n)
    headings: Array  # (..., n, 2)
    velocities: Array  # (..., n, 2), m/s
    levels: Array  # (..., n), m²/s
    features: FeatureMemory
    hidden: Array  # (..., n, units)
    bodies: Any  # memory of frames or planes, else ()
    filter: Any  # state of the filter there, else ()


@dataclass(frozen=True)
class Learned(JaxPolicy):
    """As ``LearnedPolicy``, greedy: a network rotates f for the rule of merged intervals.

    ``dataclasses.replace(policy, parameters=…)`` is the policy with other weights.
    """

    settings: PolicySettings
    parameters: Parameters

    def begin(self, batch: tuple[int, ...] = ()) -> Memory:
        """Memory before the first decision, with full tanks."""
        robots = *batch, self.scenario.n_robots
        zero = jnp.zeros(robots, jnp.result_type(float))
        vectors = jnp.zeros((*robots, 2), zero.dtype)
        return _Kept(
            jnp.full(batch, self._period, jnp.int32),
            zero.astype(jnp.int32),
            vectors,
            vectors,
            zero + self.settings.budget_of(self.scenario),
            no_memory(robots, self.scenario.observation_layout.obstacle_slots),
            jnp.zeros((*robots, self.settings.units), jnp.float32),
            () if self._way is None else steady_frames.no_memory(self._way, robots),
            () if self._way is None else self._filter.begin(batch),
        )

    @property
    def _period(self) -> int:
        return self.settings.decision_period(self.scenario)

    @property
    def _has_tank(self) -> bool:
        return self.settings.guarantee == "tank"

    @property
    def _robot(self) -> Robot:
        return robot_of(self.scenario, self.settings.min_alignment)

    @cached_property
    def _controller(self) -> BaseController:
        """Constants of the base controller."""
        return BaseController(self.settings, self.scenario, 1)

    @property
    def _way(self) -> Any:
        """How robots that turn, or in 3-D, are steered; None for others."""
        return None if self._controller.bodies is None else self._controller.bodies._way

    @cached_property
    def _filter(self) -> TeamFilter:
        form: Any = Tank if self._has_tank else Heading
        return TeamFilter(form(self._controller.steering, jnp.float32), self.scenario)

    def act(self, observations: Any, memory: Memory, time: Any = 0.0) -> tuple[Array, Memory]:
        """As ``JaxPolicy.act``."""
        seen, kept = self.rows_of(observations), memory._replace(steps=memory.steps + 1)
        due = kept.steps >= self._period
        kept = jax.lax.cond(
            jnp.any(due), lambda: where(due, self._decided(seen, kept), kept), lambda: kept
        )
        if self._way is not None:
            return self._followed_in_frames(observations, seen, kept)
        actions, kept = self._followed(seen, kept)
        return within_limits(actions, self.scenario), kept

    def _decided(self, seen: Rows, kept: _Kept) -> _Kept:
        """Memory after a decision of all environments."""
        layout, angles = self.settings.layout_of(self.scenario), self._angles
        levels = velocities = None
        if self._has_tank:
            stored = kept.levels if self._way is None else kept.filter.levels
            levels, velocities = stored / unit_of_tanks(self.scenario), kept.velocities
        if self._way is not None:
            view, bodies = steady_frames.look(self._way, seen, kept.bodies)
            seen, kept, velocities = view.rows, kept._replace(bodies=bodies), kept.velocities
        motion = RecentMotion(kept.headings, velocities, levels, angles[kept.choices])
        elapsed = self._period * float(self.scenario.tau)
        shown, remembered = features(
            seen, motion, kept.features, elapsed, robot_of(self.scenario), layout
        )
        logits, hidden = preferences(self.parameters, layout, shown, kept.hidden)
        alive = jnp.any(shown != 0.0, axis=-1)
        return kept._replace(
            steps=jnp.zeros_like(kept.steps),
            choices=jnp.where(alive, jnp.argmax(logits, axis=-1), 0).astype(jnp.int32),
            features=remembered,
            hidden=jnp.where(alive[..., None], hidden, 0.0),
        )

    @property
    def _angles(self) -> Array:
        return jnp.asarray(self.settings.angles, jnp.result_type(float))

    def _aim(self, seen: Rows, kept: _Kept) -> tuple[Array, Array]:
        """Directions of the rule for f rotated by the choices, pairs."""
        aside = array_form(rotated)(parts_of(sum_of(seen)), self._angles[kept.choices])[:2]
        rule = self.settings.clearance, parts_of(kept.headings), self.settings.persistence
        return merged_headings(direction_of(aside), seen.obstacles, *rule)

    def _followed_in_frames(
        self, observations: Any, seen: Rows, kept: _Kept
    ) -> tuple[Array, _Kept]:
        """Actions of the base controller in a frame or plane, and memory."""
        way = self._way
        view, bodies = steady_frames.look(way, seen, kept.bodies)
        headings = jnp.stack(self._aim(view.rows, kept), axis=-1)
        choices = steady_frames.follow(way, seen, view, bodies, headings)
        if not self._has_tank and way.robot.turns:
            choices = choices[..., 1:]
        actions, state = self._filter.apply(observations, choices, kept.filter)
        velocities, bodies = steady_frames.turn(way, view, bodies, actions)
        return within_limits(actions, self.scenario), kept._replace(
            headings=headings, velocities=velocities, bodies=bodies, filter=state
        )

    def _followed(self, seen: Rows, kept: _Kept) -> tuple[Array, _Kept]:
        """Actions of the base controller, and memory."""
        settings, robot = self.settings, self._robot
        net, degree, carried = sum_of(seen), degree_of(seen), parts_of(kept.headings)
        f, raw = parts_of(net), self._aim(seen, kept)
        if self._has_tank:
            account = account_of(f, degree, robot)
            law_speed = array_form(scale_of_step)(degree, robot.merge_radius, robot.gate.duration)
            share = jnp.minimum(law_speed * account.strength / robot.speed_limit, 1.0)
            speed = WITHIN * share * robot.speed_limit
            desired = tuple(part * speed for part in raw)
            sent, levels = spend(desired, account, kept.levels, robot)
            actions, h = jnp.stack(sent, axis=-1), jnp.stack(raw, axis=-1)
            return actions, kept._replace(headings=h, velocities=actions, levels=levels)
        limit = array_form(turn_limit)(settings.max_turn_rate * self.scenario.tau)
        gate = robot.gate
        certified = array_form(certify_one)
        h = certified(raw, f, carried, gate.min_alignment, gate.dead_zone, limit)
        h = jnp.stack(h, axis=-1)
        along = jnp.sum(h * net, axis=-1)
        if self.scenario.tau > self.scenario.certified_step:
            along = along * array_form(scale_of_step)(
                degree, robot.merge_radius, robot.gate.duration
            )
        return h * along[..., None], kept._replace(headings=h)


def form_of(policy: LearnedPolicy) -> JaxPolicy:
    """JAX form of a learned policy with a NumPy network."""
    if not isinstance(policy._chooser, NumpyActor):
        raise NotImplementedError(
            "networks from ONNX files are not covered by JAX; use baselines.make, which runs them"
        )
    return Learned(policy.scenario, policy.settings, parameters_of(policy._chooser))


register(AT_PATH, *(name for name in NAMES if name != "learned-search"))(form_of)
