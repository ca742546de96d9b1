"""Imperfect sensors over arrays: range, field of view, noise, bias, dropout and delay.

The equations are those of ``sensors.imperfections`` and ``sensors.chance``, the random words those
of ``engine.stages.apply_noise``. Arrays have the environment axis last; rows are float32.
"""

from dataclasses import asdict
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..engine.stages.apply_noise import DRAWS, highest_word
from ..graphs.edges import pair_index
from ..physics.random_streams import SENSING
from ..scenario.scenario import Scenario
from ..sensors import chance
from ..sensors.imperfections import Imperfections, imperfections_of, is_in_view, is_seen
from ..sensors.sensing import Sensing
from .arrays.array_form import Array, array_form, replaces
from .arrays.random_streams import Word, joined, mixed, stream_keys, wide, word_of

COVERED = ("range", "field_of_view", "noise", "bias", "dropout", "delay", "delay_time")
"""Fields of ``Sensing`` that the JAX form covers."""


@replaces(chance.cosine_and_sine)
def _cosine_and_sine(angle: Any, small: bool) -> Any:
    """As the kernel, which rounds by adding a large number; XLA removes that addition."""
    near_zero = array_form(chance._near_zero)
    if small:
        return near_zero(angle)
    count = jnp.round(angle * chance._QUARTERS)
    first, rest = chance._QUARTER
    cosine, sine = near_zero((angle - count * first) - count * rest)
    quarter = count.astype(jnp.int32)
    swapped = (quarter & 1) != 0
    c, s = jnp.where(swapped, sine, cosine), jnp.where(swapped, cosine, sine)
    negative_c, negative_s = ((quarter + 1) & 2) != 0, (quarter & 2) != 0
    return jnp.where(negative_c, -c, c), jnp.where(negative_s, -s, s)


def not_covered(sensing: Sensing) -> str:
    """Names and values of imperfections that are not covered, as text."""
    own, ideal = asdict(sensing), asdict(Sensing())
    found = [name for name in own if own[name] != ideal[name] and name not in COVERED]
    found += [name for name in sensing.per_robot if name in COVERED]
    return ", ".join(f"{name} = {own[name]}" for name in found)


class Keys(NamedTuple):
    """Keys of the sensing streams of environments, (*batch)."""

    episode: Word
    step: Word


class SensorModel:
    """Imperfections of the sensors of a scenario."""

    def __init__(self, scenario: Scenario) -> None:
        n = scenario.n_robots
        table = imperfections_of(scenario.sensing, n)
        assert table is not None
        self._errors = Imperfections(*table[0].tolist())  # of all robots
        self._dim, self._n = scenario.dim, n
        self._slots = scenario.observation_layout.obstacle_slots
        self._points = scenario.observation_layout.rows_per_obstacle
        pairs = [[pair_index(min(i, j), max(i, j), n) if i != j else 0 for j in range(n)]
                 for i in range(n)]  # fmt: skip
        self._couples = np.array(pairs, np.uint32)
        self._second = np.arange(n)[:, None] > np.arange(n)

    def keys(self, seed: Array, episode: Array, step: Array) -> Keys:
        """Keys of seeds (2, *batch), episodes and steps (*batch)."""
        (key,) = stream_keys((seed[0], seed[1]), episode, SENSING)
        with jax.enable_x64(True):  # ``chance.step_key``
            return Keys(key, mixed(joined(key) ^ (wide(step + 1) * chance._STEP)))

    def neighbours(self, rows: Array, offset: Any, frame: Any, keys: Keys) -> Array:
        """Rows (n, n, d, *batch) of all pairs, as the first of each pair observes them.

        Offsets in the global frame, m, are tuples of (n, n, *batch), frames of (n, 1, *batch).
        """
        errors = self._errors
        if np.isfinite(errors.reach) or errors.half_field < np.pi:
            seen = array_form(is_seen)(offset, frame, errors.reach, errors.half_field)
            rows = jnp.where(seen[:, :, None], rows, 0.0)
        shape = self._n, self._n, *[1] * (rows.ndim - 3)
        couple = jnp.asarray(self._couples.reshape(shape) * np.uint32(DRAWS))
        second = self._second.reshape(shape)
        if errors.dropout > 0.0:
            upper, lower = word_of(keys.step, couple + np.uint32(2))
            missed = jnp.where(second, lower, upper) <= highest_word(errors.dropout)
            rows = jnp.where(missed[:, :, None], 0.0, rows)
        return self._turned(rows, couple, second, keys)

    def obstacles(self, rows: Array, keys: Keys) -> Array:
        """Edge points (n, M, S, d, *batch) of obstacles, as the robots observe them."""
        if self._errors.half_field < np.pi:
            exact = rows.astype(jnp.result_type(float))
            parts = tuple(exact[:, :, :, k] for k in range(self._dim))
            in_view = array_form(is_in_view)(parts, self._errors.half_field)
            exists = jnp.any(rows != 0.0, axis=3)
            rows = jnp.where(jnp.any(in_view & exists, axis=2)[:, :, None, None], rows, 0.0)
        count = self._slots * self._points
        flat = rows.reshape(self._n, count, *rows.shape[3:])
        points = np.arange(self._n * count).reshape(self._n, count, *[1] * (flat.ndim - 3))
        first = self._n * (self._n - 1) // 2 + points // 2
        couple = jnp.asarray((first * DRAWS).astype(np.uint32))
        return self._turned(flat, couple, points % count % 2 == 1, keys).reshape(rows.shape)

    def _turned(self, rows: Array, couple: Any, second: Any, keys: Keys) -> Array:
        """Rows (n, N, d, *batch), rotated by bias and noise."""
        for deviation, key in ((self._errors.bias, keys.episode), (self._errors.noise, keys.step)):
            if deviation > 0.0:
                rows = self._rotated(rows, np.float32(deviation), couple, second, key)
        return rows

    def _rotated(
        self, rows: Array, deviation: np.float32, couple: Any, second: Any, key: Word
    ) -> Array:
        if self._dim == 2:  # one word for both of a couple
            upper, lower = word_of(key, couple)
            angle, other = jnp.where(second, lower, upper), upper
        else:
            angle, other = word_of(key, couple + jnp.where(second, jnp.uint32(1), jnp.uint32(0)))
        row = tuple(rows[:, :, k] for k in range(self._dim))
        small = bool(chance.is_small(deviation))
        turned = array_form(chance.turned_by_chance)(row, deviation, small, angle, other)
        return jnp.stack(turned, axis=2)


def delayed(past: Array, rows: Array, begins: Array, advances: Array) -> tuple[Array, Array]:
    """Store rows (n, rows, d, *batch), and return the memory and the rows that are due.

    ``past``, (delay + 1, n, rows, d, *batch), has the latest rows last. They are all equal at the
    first step, and replaced where an environment does not advance (*batch).
    """
    shifted = jnp.concatenate([past[1:], rows[None]])
    replaced = jnp.concatenate([past[:-1], rows[None]])
    kept = jnp.where(advances, shifted, replaced)
    kept = jnp.where(begins, jnp.broadcast_to(rows, past.shape), kept)
    return kept, kept[0]
