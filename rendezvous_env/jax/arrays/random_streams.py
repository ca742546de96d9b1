"""The random streams of the engine, ``physics.random_streams``, over arrays.

Keys and words of 64 bits are pairs (upper, lower) of uint32. They are joined to uint64 only within
these functions, since ``jax_enable_x64`` may be off.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...physics import random_streams as streams

Array = jax.Array
Word = tuple[Any, Any]

_HALF, _INCREMENT = np.uint64(32), streams._INCREMENT
_mix = getattr(streams.mix, "py_func", streams.mix)  # operators only


def word(value: int) -> Word:
    """Convert an integer of at most 64 bits to a pair."""
    return jnp.uint32(value >> 32 & 0xFFFFFFFF), jnp.uint32(value & 0xFFFFFFFF)


def joined(word: Word) -> Array:
    """Convert a pair of uint32 to uint64; call it under ``jax.enable_x64``."""
    return (wide(word[0]) << _HALF) | wide(word[1])


def wide(count: Any) -> Array:
    """Convert integers to uint64; call it under ``jax.enable_x64``."""
    return jnp.asarray(count).astype(jnp.uint32).astype(jnp.uint64)


def mixed(word: Array) -> Word:
    """``physics.random_streams.mix`` of uint64, as a pair; call it under ``jax.enable_x64``."""
    word = _mix(word)
    return (word >> _HALF).astype(jnp.uint32), word.astype(jnp.uint32)


def stream_keys(seed: Word, episode: Any, *purposes: int) -> list[Word]:
    """``physics.random_streams.stream_key`` of a seed, an episode and each purpose."""
    with jax.enable_x64(True):
        key = _mix(joined(seed) + _INCREMENT)
        key = _mix(key ^ (wide(episode) + _INCREMENT))
        return [mixed(key ^ (np.uint64(purpose) + _INCREMENT)) for purpose in purposes]


def word_of(key: Word, counter: Any) -> Word:
    """``physics.random_streams.word_of``."""
    with jax.enable_x64(True):
        return mixed(joined(key) + (wide(counter) + np.uint64(1)) * _INCREMENT)


def uniform(key: Word, counter: Any, dtype: Any) -> Any:
    """``physics.random_streams.uniform``: exact in float64, rounded in float32."""
    upper, lower = word_of(key, counter)
    return upper.astype(dtype) * 2.0**-32 + (lower >> 11).astype(dtype) * 2.0**-53


class Numbers(NamedTuple):
    """Numbers of streams, for kernels in place of a key; counters are their indices."""

    values: Any  # (N, …)


def numbers(key: Word, first: Any, count: int, dtype: Any) -> Numbers:
    """Numbers (count, …) of streams from counters (…) on, sampled at once.

    A loop samples many, since XLA does not repeat it wherever a number is used.
    """
    if count > _MOST_AT_ONCE:
        sample = lambda k: uniform(key, first + k, dtype)  # noqa: E731
        return Numbers(jax.lax.map(sample, jnp.arange(count)))
    index = np.arange(count).reshape(-1, *[1] * jnp.ndim(first))
    return Numbers(uniform(key, first + index, dtype))


_MOST_AT_ONCE = 4
