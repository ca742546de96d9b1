"""Merging of robots that come within the merge radius, as ``graphs.merging`` does it.

Arrays have the environment axis last: positions (n, d, *batch), weights (n, n, *batch), and so on.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..physics.crossings import first_crossing
from .arrays.array_form import Array, array_form
from .obstacles.fields import Fields


class MergeArrays(NamedTuple):
    """Arrays that merges change."""

    positions: Array  # (n, d, *batch), m
    displacements: Array  # (n, d, *batch), m
    lengths: Array  # (n, *batch), of the paths, m
    weights: Array  # (n, n, *batch), a_ij, m/s
    merged_into: Array  # (n, *batch)
    obstacles: Any = ()  # of the state


class Merging:
    """Swept merges of environments of n robots.

    Args:
        n: number of robots.
        radius: r, m.
        one_way: whether links can be one-way.
        bounded: whether loops have a fixed length, n − 1, through which gradients pass.
        fields: obstacles, in which no merged robot may be placed, or None.
        through: whether robots merge through obstacles.
    """

    def __init__(
        self,
        n: int,
        radius: float,
        one_way: bool,
        bounded: bool,
        fields: Fields | None = None,
        through: bool = True,
    ) -> None:
        self._n, self._radius, self._one_way, self._bounded = n, radius, one_way, bounded
        self._fields, self._through = fields, through or fields is None
        self._first, self._second = np.triu_indices(n, 1)

    def __call__(self, moving: MergeArrays) -> MergeArrays:
        """Move robots by their displacements and merge those that come within r (theory 5).

        First those pairs merge that meet on their paths; then, at the end, those within r.
        """
        batch = moving.positions.shape[2:]
        begun = moving, self._moments(moving), jnp.zeros(batch, bool), jnp.ones(batch, bool)

        def go(now: Any) -> Any:
            moving, keys, arrived, busy = now
            moving, keys, merged = self._merge_next(moving, keys, arrived, busy)
            arrives = busy & ~arrived & ~jnp.any(keys < jnp.inf, axis=0)
            left = moving.displacements
            moving = moving._replace(
                positions=moving.positions + jnp.where(arrives, left, 0.0),
                displacements=jnp.where(arrives, 0.0, left),
            )
            changed = arrives | (arrived & merged)  # which also changes what pairs are hidden
            keys = jnp.where(changed, self._squares(moving), keys)
            return moving, keys, arrived | arrives, busy & jnp.any(keys < jnp.inf, axis=0)

        if self._bounded:  # a pass merges a pair, or has robots arrive, or finds a hidden pair
            passes = self._n + (0 if self._through else len(self._first))
            moving = jax.lax.fori_loop(0, passes, lambda _, now: go(now), begun)[0]
        else:
            moving = jax.lax.while_loop(lambda now: jnp.any(now[-1]), go, begun)[0]
        return moving._replace(obstacles=())

    def _links(self, weights: Array) -> Array:
        """Whether either robot of each pair observes the other, (E, *batch)."""
        linked = weights[self._first, self._second] > 0.0
        return linked | (weights[self._second, self._first] > 0.0) if self._one_way else linked

    def _moments(self, moving: MergeArrays) -> Array:
        """Fraction of the step at which the robots of each link first come within r; else inf."""
        places, ways, d = moving.positions, moving.displacements, moving.positions.shape[1]
        offset = tuple(places[self._second, k] - places[self._first, k] for k in range(d))
        velocity = tuple(ways[self._second, k] - ways[self._first, k] for k in range(d))
        moments = array_form(first_crossing)(offset, velocity, self._radius)
        due = self._links(moving.weights) & (moments < jnp.inf)  # never of NaN
        return jnp.where(due, moments, jnp.inf)

    def _squares(self, moving: MergeArrays) -> Array:
        """Square lengths of links shorter than r, m²; inf of others."""
        places, d = moving.positions, moving.positions.shape[1]
        squares: Any = sum(
            (places[self._second, k] - places[self._first, k]) ** 2 for k in range(d)
        )
        due = self._links(moving.weights) & (squares < self._radius * self._radius)
        return jnp.where(due, squares, jnp.inf)

    def _merge_next(
        self, moving: MergeArrays, keys: Array, arrived: Array, busy: Array
    ) -> tuple[MergeArrays, Array, Array]:
        """Merge the pair that meets first, or after arrival the closest.

        Both rest for the remainder of the step. Also returns the remaining keys, and whether a pair
        has merged, (*batch).
        """
        pair, key = jnp.argmin(keys, axis=0), jnp.min(keys, axis=0)
        due = busy & (key < jnp.inf)
        moment = jnp.where(due & ~arrived, key, 0.0)
        here = moving.positions + moment * moving.displacements
        hidden = self._is_hidden(moving, here, pair) & due
        due &= ~hidden
        moving, merging = self._merge(moving, here, pair, due)
        moving = moving._replace(
            displacements=jnp.where(merging[:, None], 0.0, moving.displacements),
            lengths=jnp.where(merging & ~arrived, moving.lengths * moment, moving.lengths),
        )
        rests = merging[self._first] | merging[self._second]
        if not self._through:
            rests |= self._numbers(pair) & hidden
        return moving, jnp.where(rests, jnp.inf, keys), due

    def _numbers(self, pair: Array) -> Array:
        """Whether each pair is this one, (E, *batch)."""
        return np.arange(len(self._first)).reshape(-1, *[1] * pair.ndim) == pair

    def _point(self, values: Array, robot: Array) -> Any:
        """Vector of one robot, (*batch), as a tuple."""
        chosen = np.arange(self._n).reshape(-1, *[1] * robot.ndim) == robot
        return tuple(jnp.sum(jnp.where(chosen[:, None], values, 0.0), axis=0))

    def _is_hidden(self, moving: MergeArrays, here: Array, pair: Array) -> Array:
        """Whether an obstacle prevents the merge of a pair, (*batch)."""
        if self._through or self._fields is None:
            return jnp.zeros(pair.shape, bool)
        world = self._fields.world(moving.obstacles, pair.ndim)
        first, second = jnp.asarray(self._first)[pair], jnp.asarray(self._second)[pair]
        one, other = self._point(here, first), self._point(here, second)
        way = tuple(b - a for a, b in zip(one, other, strict=True))
        return self._fields.shapes.hides(world, one, way)

    def _merge(
        self, moving: MergeArrays, here: Array, pair: Array, due: Array
    ) -> tuple[MergeArrays, Array]:
        """Move a pair to its midpoint and merge the second into the first.

        Also returns whether each robot belongs to the pair.
        """
        robots = np.arange(self._n).reshape(self._n, *[1] * pair.ndim)
        first, second = jnp.asarray(self._first)[pair], jnp.asarray(self._second)[pair]
        is_first, is_second = (robots == first) & due, (robots == second) & due
        merging = is_first | is_second
        middle = 0.5 * jnp.sum(jnp.where(merging[:, None], here, 0.0), axis=0)
        if self._fields is not None:  # the place of the lower index is collision-free
            world = self._fields.world(moving.obstacles, pair.ndim)
            is_clear = self._fields.shapes.is_clear(world, tuple(middle), 0.0)
            place = jnp.sum(jnp.where(is_first[:, None], here, 0.0), axis=0)
            middle = jnp.where(is_clear, middle, place)
        into = moving.merged_into
        return moving._replace(
            positions=jnp.where(merging[:, None], middle, moving.positions),
            weights=self._contracted(moving.weights, is_first, is_second),
            merged_into=jnp.where((into == second) & due, first.astype(into.dtype), into),
        ), merging

    def _contracted(self, weights: Array, is_first: Array, is_second: Array) -> Array:
        """a_ik ← max(a_ik, a_jk),  a_ki ← max(a_ki, a_kj),  a_ij, a_ji ← 0   (assumption 2)."""
        merging = is_first | is_second
        due = jnp.any(merging, axis=0)

        def heavier(rows: Array) -> Array:
            most = jnp.max(jnp.where(merging[:, None], rows, 0.0), axis=0)
            return jnp.where(merging, 0.0, most)

        row = heavier(weights)
        column = heavier(jnp.swapaxes(weights, 0, 1)) if self._one_way else row
        weights = jnp.where(is_first[:, None], row[None], weights)
        weights = jnp.where(is_first[None], column[:, None], weights)
        gone = is_second[:, None] | is_second[None]
        return jnp.where(gone & due, 0.0, weights)
