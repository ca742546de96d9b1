"""Initial conditions that ``engine.reset`` samples for (seed, episode), of a whole batch.

Arrays have the batch axis last. Random numbers equal those of the engine.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..engine.preparation import start_rules
from ..engine.reset import _MAX_DRAWS
from ..graphs.edges import pair_index
from ..physics.random_streams import FRAMES, GRAPH, OBSTACLES, START, draw_rotation
from ..robots.motion import init_memory
from ..robots.robot_models import constants_of
from ..scenario.scenario import Scenario
from .arrays.array_form import Array, array_form
from .arrays.loops import while_busy
from .arrays.random_streams import Numbers, Word, numbers, stream_keys, uniform
from .obstacles.fields import Fields


class InitialConditions(NamedTuple):
    """Initial positions, frames, memory and weights of environments."""

    positions: Array  # (n, d, *batch), m
    frames: Array  # (n, d·d, *batch), row by row; (n, 0, *batch) where memory has them
    memory: Array  # (n, k, *batch)
    weights: Array  # (n, n, *batch), m/s
    obstacles: Any  # World; () where there are none, or the same in all episodes


class InitialConditionSampler:
    """Initial conditions of a scenario."""

    def __init__(self, scenario: Scenario, fields: Fields | None, dtype: Any) -> None:
        self._scenario, self._fields, self._dtype = scenario, fields, dtype
        self._rules, n = start_rules(scenario), scenario.n_robots
        self._base: NDArray[np.float64] = scenario.sensing_graph.base_weights(n)
        self._linked = (self._base > 0.0) | (self._base.T > 0.0)

    def __call__(self, seed: Array, episode: Array) -> InitialConditions:
        """Sample initial conditions of episodes (*batch) of seeds (2, *batch)."""
        words, batch = (seed[0], seed[1]), episode.shape
        purposes = START, FRAMES, GRAPH, OBSTACLES
        positions, frames, weights, field = stream_keys(words, episode, *purposes)
        obstacles: Any = ()
        if self._fields is not None and self._fields.fixed is None:
            given = self._scenario.start_positions
            starts = None if given is None else self._given(given, batch)
            obstacles = self._fields.draw(field, batch, starts)
        drawn = self._numbers(frames, batch)
        return InitialConditions(
            self._positions(positions, obstacles, batch),
            self._frames(drawn, batch),
            self._memory(drawn, batch),
            self._weights(weights, batch),
            obstacles,
        )

    def _numbers(self, key: Word, batch: tuple[int, ...]) -> Numbers:
        """Three numbers for each robot, (3, n, *batch)."""
        first = self._given(3 * np.arange(self._scenario.n_robots), batch).astype(jnp.uint32)
        return numbers(key, first, 3, self._dtype)

    def _given(self, table: Any, batch: tuple[int, ...]) -> Array:
        rows = jnp.asarray(np.array(table), self._dtype)
        return jnp.broadcast_to(rows.reshape(*rows.shape, *[1] * len(batch)), rows.shape + batch)

    def _positions(self, key: Word, obstacles: Any, batch: tuple[int, ...]) -> Array:
        """Uniform positions in the spawn area, away from neighbours and obstacles.

        NaN if there is no room.
        """
        scenario, rules = self._scenario, self._rules
        if scenario.start_positions is not None:
            return self._given(scenario.start_positions, batch)
        n, d = scenario.n_robots, scenario.dim
        robots = np.arange(n).reshape(n, *[1] * len(batch))
        edges = np.array(rules.spawn_edges[:d], self._dtype).reshape(d, *[1] * len(batch))
        near, linked = rules.least_distance**2, jnp.asarray(self._linked)

        def sampled(counter: Array) -> Array:
            return edges * (numbers(key, counter, d, self._dtype).values - 0.5)

        def draw(drawn: Any) -> Any:
            positions, robot, counter, tries, place, busy = drawn
            square = sum((positions[:, axis] - place[axis]) ** 2 for axis in range(d))
            others = jnp.moveaxis(linked[jnp.minimum(robot, n - 1)], -1, 0) & (robots < robot)
            kept = busy & ~jnp.any(others & (square < near), axis=0)
            if self._fields is not None:
                world = self._fields.world(obstacles, len(batch))
                kept &= self._fields.shapes.is_clear(world, tuple(place), self._fields.keep_out)
            mine = (robots == robot) & kept
            positions = jnp.where(mine[:, None], place[None], positions)
            tries = jnp.where(kept, 0, tries + busy)
            counter, robot = counter + d * busy, robot + kept
            busy = (robot < n) & (tries < _MAX_DRAWS)
            return positions, robot, counter, tries, sampled(counter), busy

        none = jnp.zeros(batch, jnp.int32)
        begun = jnp.zeros((n, d, *batch), self._dtype), none, none, none, sampled(none)
        positions, robot, *_ = while_busy(draw, (*begun, none == 0))
        return jnp.where(robot < n, jnp.nan, positions)

    def _frames(self, drawn: Numbers, batch: tuple[int, ...]) -> Array:
        """Uniform rotations, or the identity."""
        n, d = self._scenario.n_robots, self._scenario.dim
        if self._scenario.model.n_angles:
            return jnp.zeros((n, 0, *batch), self._dtype)
        if not self._rules.draw_frames:
            return self._given(np.tile(np.eye(d).ravel(), (n, 1)), batch)
        return jnp.stack(array_form(draw_rotation)(drawn, 0, range(d)), axis=1)

    def _memory(self, drawn: Numbers, batch: tuple[int, ...]) -> Array:
        """Angles and velocities."""
        scenario = self._scenario
        n, size = scenario.n_robots, scenario.model.memory_size(scenario.dim)
        if size == 0:
            return jnp.zeros((n, 0, *batch), self._dtype)
        if scenario.start_headings is not None:
            return self._given(scenario.start_headings, batch)
        sampled = array_form(init_memory)(constants_of(scenario), drawn, 0)
        shape, dtype = (n, *batch), self._dtype
        each = [jnp.broadcast_to(jnp.asarray(value, dtype), shape) for value in sampled]
        return jnp.stack(each, axis=1)

    def _weights(self, key: Word, batch: tuple[int, ...]) -> Array:
        """a_ij, sampled from their range: both of a pair use one number of the stream."""
        low, high = self._scenario.sensing_graph.weight_range
        if low == high:
            return self._given(self._base * low, batch)
        n = self._scenario.n_robots
        pairs = np.array(
            [
                [pair_index(min(i, j), max(i, j), n) if i != j else 0 for j in range(n)]
                for i in range(n)
            ]
        )
        counters = jnp.asarray(pairs.reshape(n, n, *[1] * len(batch)))
        share = uniform(key, jnp.broadcast_to(counters, (n, n, *batch)), self._dtype)
        return self._given(self._base, batch) * (low + (high - low) * share)
