"""Obstacles of each episode: given ones, and random fields sampled as ``obstacles.fields`` does.

Arrays have the environment axis last.
"""

from itertools import combinations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...obstacles.disc import BALL
from ...obstacles.fields import _TRIES_PER_OBSTACLE, Field, FieldRules, ObstacleField
from ...obstacles.obstacle_set import _GAP, _OVERLAP, pack, world_of
from ...obstacles.polygon import POLYGON
from ...obstacles.shape import ABSENT, AHEAD, BOUND, CONTACT_DEPTH, DETAILS, MIDDLE, SKIN
from ...obstacles.walls import _NUMBERS, _TRIES, BOX, _draw_layout
from ...scenario.scenario import Scenario
from ..arrays.array_form import Array, array_form, norm_of
from ..arrays.loops import while_busy
from ..arrays.random_streams import Word, numbers, uniform
from ..arrays.selection import divided
from .shapes import COARSE, EXACT, Shapes, World

MAX_SPHERES = 16
"""Spheres of a random field in 3-D: skins depend on all triples of them."""


class Fields:
    """Obstacles of a scenario: their shapes, and the worlds of episodes."""

    def __init__(self, scenario: Scenario, dtype: Any) -> None:
        self._scenario, self._dtype, dim = scenario, dtype, scenario.dim
        self._tolerances = EXACT if dtype == jnp.float64 else COARSE
        slots, given = scenario.observation_layout.obstacle_slots, scenario.obstacles
        self.fixed: World | None = None
        """Obstacles that are equal in all episodes, with axes of length 1 for the batch."""
        field = given if isinstance(given, Field) else None
        self._rules: Any = None if field is None else field.rules
        if isinstance(given, Field):
            boxes = not isinstance(given, ObstacleField)
            kinds = np.full(slots, POLYGON if boxes else BALL)
            corners, has_skins = np.full(slots, 4 if boxes else 0), not boxes and slots > 1
        else:
            world = world_of(pack(given, slots), dim=dim)
            kinds, corners, has_skins = world.kinds, world.corners, bool(world.skins.any())
            self.fixed = World(
                jnp.asarray(kinds != ABSENT)[:, None],
                jnp.asarray(world.shapes, dtype)[..., None],
                jnp.asarray(world.skins * self._skin / SKIN, dtype)[:, None],
            )
            kinds = np.where(kinds == ABSENT, BALL, kinds)
        self.shapes = Shapes(kinds, corners, dim, self._tolerances, has_skins)

    @property
    def keep_out(self) -> float:
        """Distance of sampled initial positions to surfaces, m."""
        return 0.0 if self._rules is None else float(self._rules.keep_out)

    @property
    def _skin(self) -> float:
        return SKIN * self._tolerances.depth / CONTACT_DEPTH

    def world(self, state: World | None, ndim: int) -> World:
        """Obstacles of environments, from those of the state, with ``ndim`` batch axes."""
        world = state
        if self.fixed is not None:
            world = jax.tree.map(lambda one: one if ndim else one[..., 0], self.fixed)
        assert world is not None
        return self.shapes.with_edges(world)

    def draw(self, key: Word, batch: tuple[int, ...], starts: Any) -> World:
        """Sample obstacles from streams (*batch), clear of initial positions (n, d, *batch).

        Absent obstacles where there is no room, and NaN as the shape of the first.
        """
        if isinstance(self._rules, FieldRules):
            world = self._draw_balls(key, starts, batch)
            return world._replace(skins=self._skins(world))
        return self._draw_walls(key, starts, batch)

    def _draw_balls(self, key: Word, starts: Any, batch: tuple[int, ...]) -> World:
        """``fields.draw_field``: one disc or sphere after another, with rejection."""
        rules, d, slots = self._rules, self._scenario.dim, self.shapes.count
        (least, most), (low, high) = rules.counts, rules.radius
        count = least + (uniform(key, 0, self._dtype) * (most - least + 1)).astype(jnp.int32)
        indices = np.arange(slots).reshape(-1, *[1] * len(batch))

        def sampled(counter: Array) -> Array:
            return numbers(key, counter, 1 + d, self._dtype).values

        def draw(now: Any) -> Any:
            shapes, m, counter, tries, (share, *places), busy = now
            radius = low + (high - low) * share
            place = [rules.region * (one - 0.5) for one in places]
            row = jnp.stack([radius, *place, *[jnp.zeros_like(radius)] * (3 - d)])
            fits = busy & self._fits(row, shapes, indices < m, starts)
            shapes = jnp.where(((indices == m) & fits)[:, None], row, shapes)
            tries = jnp.where(fits, 0, tries + busy)
            counter, m = counter + (1 + d) * busy, m + fits
            busy = (m < count) & (tries < _TRIES_PER_OBSTACLE)
            return shapes, m, counter, tries, sampled(counter), busy

        shapes = jnp.zeros((slots, DETAILS - AHEAD, *batch), self._dtype)
        zero = jnp.zeros(batch, jnp.int32)
        begun = shapes, zero, zero + 1, zero, sampled(zero + 1), count > 0
        shapes, m, *_ = while_busy(draw, begun)
        none = jnp.zeros((slots, *batch), self._dtype)
        return World(jnp.asarray(indices) < m, _failed(shapes, m < count), none)

    def _fits(self, row: Array, shapes: Array, earlier: Any, starts: Any) -> Array:
        """``fields._fits`` for a ball with this row (4, *batch)."""
        fits, d = jnp.bool_(True), self._scenario.dim
        if starts is not None:
            offset = tuple(starts[:, k] - row[MIDDLE + k] for k in range(d))
            near = norm_of(offset) - row[BOUND] < self._rules.keep_out
            fits &= ~jnp.any(near, axis=0)
        if not self._rules.overlap:
            offset = tuple(shapes[:, MIDDLE + k] - row[MIDDLE + k] for k in range(d))
            near = norm_of(offset) - shapes[:, BOUND] < row[BOUND]
            fits &= ~jnp.any(near & earlier, axis=0)
        return fits

    def _draw_walls(self, key: Word, starts: Any, batch: tuple[int, ...]) -> World:
        """``walls.draw_walls``: layouts until one is clear of given positions."""
        slots = self.shapes.count
        none = jnp.zeros((slots, *batch), self._dtype)
        columns = np.arange(OWN_AND_BOX).reshape(-1, *[1] * len(batch))

        def world_of_trial(trial: Any) -> World:
            made = _Canvas()
            drawn = numbers(key, trial * _NUMBERS, _NUMBERS, self._dtype)
            array_form(_draw_layout)(drawn, 0, self._rules, made)
            walls = [jnp.zeros((OWN_AND_BOX, *batch), self._dtype)] * slots
            for (m, k), value in made.shapes.items():  # selections, which XLA compiles at once
                walls[m] = jnp.where(columns == k, value, walls[m])
            return World(none == 0.0, jnp.stack(walls), none)

        zero = jnp.zeros(batch, jnp.int32)
        if starts is None:
            return world_of_trial(zero)

        def is_clear(world: World) -> Array:
            clear, known = jnp.ones(batch, bool), self.shapes.with_edges(world)
            for start in starts:
                clear &= self.shapes.is_clear(known, tuple(start), self._rules.keep_out)
            return clear

        def retry(now: Any) -> Any:
            trial, world, busy = now
            trial = trial + busy
            world = world_of_trial(trial)
            return trial, world, ~is_clear(world) & (trial < _TRIES)

        first = world_of_trial(zero)
        trial, world, _ = while_busy(retry, (zero, first, ~is_clear(first)))
        return world._replace(shapes=_failed(world.shapes, trial >= _TRIES))

    def _skins(self, world: World) -> Array:
        """``obstacle_set.close_seams`` of balls, (M, *batch), m."""
        count, dim = self.shapes.count, self._scenario.dim
        skins = jnp.zeros_like(world.skins)
        gap, overlap = (self._tolerances.depth / CONTACT_DEPTH * x for x in (_GAP, _OVERLAP))
        if count < 2:
            return skins
        for size in range(2, min(dim, count) + 1):
            groups = np.array(list(combinations(range(count), size)))
            rows = world.shapes[groups]  # (G, size, width, *batch)
            centres = [tuple(rows[:, k, MIDDLE + axis] for axis in range(3)) for k in range(size)]
            radii = [rows[:, k, BOUND] for k in range(size)]
            depth = _least_depth(list(zip(centres, radii, strict=True)))
            meet = (depth > -overlap) & (depth < gap) & jnp.all(world.present[groups], axis=1)
            member = np.any(groups[..., None] == np.arange(count), axis=1)
            member = member.reshape(*member.shape, *[1] * (meet.ndim - 1))
            skins = jnp.where(jnp.any(meet[:, None] & member, axis=0), self._skin, skins)
        return skins


OWN_AND_BOX = DETAILS - AHEAD + BOX


class _Entries(dict[Any, Any]):
    """Assigned entries of an array."""


class _Canvas:
    """World into which a kernel writes boxes."""

    def __init__(self) -> None:
        self.kinds, self.corners, self.shapes = _Entries(), _Entries(), _Entries()


def _failed(shapes: Array, fails: Array) -> Array:
    """Shapes, NaN where an episode has no room for them."""
    return jnp.where(fails, jnp.nan, shapes)


def _least_depth(balls: Any) -> Array:
    """min_x max_m d_m(x) of two or three balls, m, d_m the signed distances.

    The minimum is at a point between two centres, or where the distances to three are equal.
    """
    candidates = [_between(*pair) for pair in combinations(balls, 2)]
    if len(balls) == 3:
        candidates += _equally_near(*balls)
    depths = [_highest(point, balls) for point in candidates]
    return jnp.min(jnp.stack(depths), axis=0)


def _highest(point: Any, balls: Any) -> Array:
    distances = [
        norm_of(tuple(p - c for p, c in zip(point, centre, strict=True))) - radius
        for centre, radius in balls
    ]
    highest = jnp.max(jnp.stack(distances), axis=0)
    return jnp.where(jnp.isnan(highest), jnp.inf, highest)


def _between(one: Any, other: Any) -> Any:
    """``obstacle_set._among`` of two balls."""
    (a, radius), (b, its_radius) = one, other
    offset = tuple(y - x for x, y in zip(a, b, strict=True))
    distance = norm_of(offset)
    share = jnp.clip(divided(0.5 * (distance + radius - its_radius), distance), 0.0, 1.0)
    return tuple(x + share * w for x, w in zip(a, offset, strict=True))


def _equally_near(*balls: Any) -> list[Any]:
    """Points of the plane of three centres c_k with ‖x − c_k‖ = R_k + ρ for all k (Apollonius).

    From differences of squares x = p + q ρ, relative to c_0; ‖x‖ = R_0 + ρ is quadratic in ρ.
    """
    (origin, r0), (b, r1), (c, r2) = balls
    first = tuple(x - o for x, o in zip(b, origin, strict=True))
    second = tuple(x - o for x, o in zip(c, origin, strict=True))
    length = norm_of(first)
    e = tuple(divided(x, length) for x in first)
    along = sum(x * y for x, y in zip(second, e, strict=True))
    across = tuple(x - along * y for x, y in zip(second, e, strict=True))
    height = norm_of(across)
    w = tuple(divided(x, height) for x in across)
    p1 = divided(length * length + r0 * r0 - r1 * r1, 2.0 * length)
    q1 = divided(r0 - r1, length)
    right = along * along + height * height + r0 * r0 - r2 * r2
    p2 = divided(0.5 * right - along * p1, height)
    q2 = divided(r0 - r2 - along * q1, height)
    square, half = q1 * q1 + q2 * q2 - 1.0, p1 * q1 + p2 * q2 - r0
    constant = p1 * p1 + p2 * p2 - r0 * r0
    root = jnp.sqrt(jnp.maximum(half * half - square * constant, 0.0))
    sign = jnp.where(half >= 0.0, 1.0, -1.0)
    stable = -(half + sign * root)
    depths = divided(constant, stable), divided(stable, square)
    return [
        tuple(o + (p1 + q1 * rho) * x + (p2 + q2 * rho) * y
              for o, x, y in zip(origin, e, w, strict=True))
        for rho in depths
    ]  # fmt: skip
