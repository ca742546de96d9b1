"""Features of learned policies over arrays, as ``learned.feature_kernels`` computes them.

Arrays are (..., n) for robots, with vectors as pairs of such arrays.
"""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp

from rendezvous_env.jax.arrays.array_form import array_form
from rendezvous_env.safety.heading import scale_of_step
from rendezvous_env.safety.turning import Robot

from ..learned import feature_kernels as kernels
from ..learned.feature_kernels import _turn, _turn_rate
from ..learned.features import FeatureLayout
from .arrays import Array, divided, length_of, parts_of, where
from .filters import account_of
from .merged_intervals import MergedInterval, direction_of, merged_interval
from .policy import Rows

Pair = tuple[Array, ...]
_angle, _rate = array_form(_turn), array_form(_turn_rate)


class Walls(NamedTuple):
    """Memory about the current wall, arrays (..., n), see ``feature_kernels.WALLS``."""

    since: Array
    clear: Array
    level: Array
    turned: Array
    wound: Array
    towards: Array  # (..., n, 2)
    heading: Array  # (..., n, 2)
    averages: Array  # (..., n, 2, 2)


class FeatureMemory(NamedTuple):
    """Memory between decisions, see ``feature_kernels.MEMORY``."""

    edges: Array  # (..., n, M, 2, 2)
    time: Array  # (..., n), s
    towards: Array  # (..., n, 2)
    averages: Array  # (..., n, 4, 2)
    walls: Walls


class RecentMotion(NamedTuple):
    """Motion of a robot before a decision."""

    headings: Array  # (..., n, 2), carried; zero where undefined
    velocities: Array | None  # (..., n, 2), m/s; None is that of law (4)
    levels: Array | None  # (..., n), A/(r D̄)
    angles: Array  # (..., n), the last choices, rad


def no_memory(robots: tuple[int, ...], slots: int) -> FeatureMemory:
    """Memory of robots (..., n) before their first decision."""

    def zeros(*shape: int) -> Array:
        return jnp.zeros((*robots, *shape), jnp.result_type(float))

    numbers = zeros(), zeros(), zeros(), zeros(), zeros()
    walls = Walls(*numbers, zeros(2), zeros(2), zeros(2, 2))
    return FeatureMemory(zeros(slots, 2, 2), zeros(), zeros(2), zeros(4, 2), walls)


def features(
    seen: Rows,
    motion: RecentMotion,
    memory: FeatureMemory,
    elapsed: float,
    robot: Robot,
    layout: FeatureLayout,
) -> tuple[Array, FeatureMemory]:
    """Features (..., n, layout.size) of robots, and memory; robots without neighbours keep theirs.

    ``elapsed`` is the time since the last decision, s.
    """
    weights = length_of(seen.neighbours)
    count, f = jnp.sum(weights > 0.0, axis=-1), parts_of(jnp.sum(seen.neighbours, axis=-2))
    account, u = account_of(f, jnp.sum(weights, axis=-1), robot), direction_of(f)
    velocity = motion.velocities
    if velocity is None:
        along = jnp.sum(motion.headings * jnp.stack(f, axis=-1), axis=-1)
        scale = array_form(scale_of_step)(account.degree, robot.merge_radius, robot.gate.duration)
        speed = jnp.clip(along * scale, -robot.speed_limit, robot.speed_limit)
        velocity = motion.headings * speed[..., None]
    neighbours = _neighbours(seen.neighbours, weights, u)
    obstacles, edges = _obstacles(seen.obstacles, memory.edges, u, elapsed)
    moving, memory_after = _motion(memory, u, motion.headings, velocity, elapsed)
    joined = merged_interval(u, seen.obstacles)
    summary = divided(account.strength, account.degree), jnp.minimum(account.strength, 2.0)
    context = [*summary, divided(jnp.ones_like(weights[..., 0]), count), *moving]
    context += _joined(joined)
    walls = memory.walls
    if layout.tank_columns > 0:
        assert motion.levels is not None
        level = jnp.log1p(motion.levels)
        context.append(level)
        if layout.tank_columns > kernels.LEVEL_COLUMNS:
            blocked = joined.closed | (joined.high >= joined.low)
            sure = tuple(jnp.where(account.strength > 0.0, part, 0.0) for part in u)
            now = jnp.stack(sure, axis=-1), motion.headings, velocity
            walls = _updated(walls, now, elapsed, blocked, level)
            context += _shown(walls, sure, motion.angles)
    flat = neighbours.reshape(*count.shape, -1), obstacles.reshape(*count.shape, -1)
    shown = jnp.concatenate([*flat, jnp.stack(context, axis=-1)], axis=-1)
    after = memory_after._replace(edges=edges, walls=walls)
    return jnp.where((count > 0)[..., None], shown, 0.0), where(count > 0, after, memory)


def _along(vector: Pair, u: Pair) -> Pair:
    """A pair in the frame with x along a unit pair."""
    x, y = vector
    return x * u[0] + y * u[1], y * u[0] - x * u[1]


def _neighbours(rows: Array, weights: Array, u: Pair) -> Array:
    towards = tuple(part[..., None] for part in u)
    bearing = parts_of(rows * divided(jnp.ones_like(weights), weights)[..., None])
    return jnp.stack([*_along(bearing, towards), weights], axis=-1)


def _obstacles(rows: Array, before: Array, u: Pair, elapsed: float) -> tuple[Array, Array]:
    """Features of obstacles, (..., n, M, 6), and their edges, to be stored."""
    towards = tuple(part[..., None] for part in u)
    seen, known = (jnp.any(edges[..., 0, :] != 0.0, axis=-1) for edges in (rows, before))
    edges = [parts_of(rows[..., s, :]) for s in range(2)]
    last = [parts_of(before[..., s, :]) for s in range(2)]
    rates = [jnp.where(known, _rate(a, b, elapsed), 0.0) for a, b in zip(last, edges, strict=True)]
    shown = jnp.stack([*_along(edges[0], towards), *_along(edges[1], towards), *rates], axis=-1)
    return jnp.where(seen[..., None], shown, 0.0), jnp.where(seen[..., None, None], rows, 0.0)


def _motion(
    memory: FeatureMemory, u: Pair, headings: Array, velocity: Array, elapsed: float
) -> tuple[list[Array], FeatureMemory]:
    first = jnp.all(memory.towards == 0.0, axis=-1)
    now, decay = jnp.stack(u, axis=-1), (kernels._SHORT, kernels._LONG)
    averages = []
    for k in range(4):
        kept, value = math.exp(-elapsed / decay[k % 2]), velocity if k < 2 else now
        begun = jnp.zeros_like(value) if k < 2 else value
        before = jnp.where(first[..., None], begun, memory.averages[..., k, :])
        averages.append(kept * before + (1.0 - kept) * value)
    time = jnp.where(first, memory.time, memory.time + elapsed)
    rate = jnp.where(first, 0.0, _rate(parts_of(memory.towards), u, elapsed))
    shown = [time / 60.0, jnp.exp(-time / kernels._FRESH)]
    for average in averages:
        shown += _along(parts_of(average), u)
    shown += [rate, *_along(parts_of(headings), u)]
    return shown, memory._replace(time=time, towards=now, averages=jnp.stack(averages, axis=-2))


def _joined(joined: MergedInterval) -> list[Array]:
    """Merged interval in the direction of f."""
    closed = joined.closed
    some = ~closed & (joined.high >= joined.low)
    edges = joined.high, joined.low, joined.gap_above, joined.gap_below
    flags = [part.astype(joined.low.dtype) for part in (closed, some)]
    return [*flags, *(jnp.where(some, part, 0.0) for part in edges)]


def _updated(walls: Walls, now: Any, elapsed: float, blocked: Array, level: Array) -> Walls:
    """``feature_kernels._update_wall``; ``now`` is the direction of f, heading and velocity."""
    towards, heading, velocity = now
    clear = jnp.where(blocked, 0.0, walls.clear + elapsed)
    still = (walls.since > 0.0) & (clear <= kernels._LEFT)
    turned = walls.turned + _angle(parts_of(walls.towards), parts_of(towards))
    wound = walls.wound + _angle(parts_of(walls.heading), parts_of(heading))
    known = jnp.any(walls.towards != 0.0, axis=-1)[..., None]
    kept = math.exp(-elapsed / kernels._LONG_AT_WALLS)
    moved = jnp.where(known, walls.averages[..., 0, :], 0.0)
    along = jnp.where(known, walls.averages[..., 1, :], towards)
    averages = [kept * moved + (1.0 - kept) * velocity, kept * along + (1.0 - kept) * towards]
    return Walls(
        since=jnp.where(still, walls.since + elapsed, jnp.where(blocked, elapsed, 0.0)),
        clear=clear,
        level=jnp.where(still, walls.level, jnp.where(blocked, level, 0.0)),
        turned=jnp.where(still, turned, 0.0),
        wound=jnp.where(still, wound, 0.0),
        towards=towards,
        heading=heading,
        averages=jnp.stack(averages, axis=-2),
    )


def _shown(walls: Walls, u: Any, angles: Array) -> list[Array]:
    """``feature_kernels._show_wall``."""
    at_wall = walls.since > 0.0
    shown = [at_wall.astype(u[0].dtype), walls.level, walls.since / kernels._SLOW]
    shown += [jnp.where(at_wall, jnp.exp(-walls.since / kernels._FRESH), 0.0)]
    shown += [walls.turned / math.pi, walls.wound / math.pi, jnp.cos(angles), jnp.sin(angles)]
    for k in range(2):
        shown += _along(parts_of(walls.averages[..., k, :]), u)
    return shown
