"""The random streams of the engine (``physics.random_streams``) in words of 32 bits.

A word of 64 bits is a pair (high, low) of uint32, since uint64 needs ``jax_enable_x64``.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

Array = jax.Array
Word = tuple[Any, Any]


def word(value: int) -> Word:
    """Convert an integer of at most 64 bits to a word."""
    high, low = _halves(value)
    return jnp.uint32(high), jnp.uint32(low)


_INCREMENT = 0x9E3779B97F4A7C15
_FACTOR_1, _FACTOR_2 = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def add(a: Word, b: Word) -> Word:
    """A + b modulo 2⁶⁴."""
    low = a[1] + b[1]
    return a[0] + b[0] + (low < a[1]).astype(jnp.uint32), low


def exclusive_or(a: Word, b: Word) -> Word:
    """A ⊕ b."""
    return a[0] ^ b[0], a[1] ^ b[1]


def shifted(a: Word, bits: int) -> Word:
    """A ≫ bits, 0 < bits < 32."""
    return a[0] >> bits, (a[1] >> bits) | (a[0] << (32 - bits))


def times(a: Word, b: Word) -> Word:
    """A b modulo 2⁶⁴."""
    high, low = _wide_product(a[1], b[1])
    return high + a[0] * b[1] + a[1] * b[0], low


def _wide_product(a: Any, b: Any) -> Word:
    """The product of two uint32, by their halves."""
    mask = jnp.uint32(0xFFFF)
    a1, a0, b1, b0 = a >> 16, a & mask, b >> 16, b & mask
    least, mixed = a0 * b0, a1 * b0
    middle = (least >> 16) + (mixed & mask) + a0 * b1  # less than 2³²
    carry = (middle < a0 * b1).astype(jnp.uint32) << 16
    return a1 * b1 + (mixed >> 16) + (middle >> 16) + carry, a * b


def mix(a: Word) -> Word:
    """``physics.random_streams.mix``."""
    a = times(exclusive_or(a, shifted(a, 30)), word(_FACTOR_1))
    a = times(exclusive_or(a, shifted(a, 27)), word(_FACTOR_2))
    return exclusive_or(a, shifted(a, 31))


def _halves(value: int) -> tuple[int, int]:
    return value >> 32 & 0xFFFFFFFF, value & 0xFFFFFFFF


def stream_keys(seed: Word, episode: Any, *purposes: int) -> list[Word]:
    """``physics.random_streams.stream_key`` of a seed (a word), an episode and each purpose.

    A loop mixes, since XLA does not repeat it wherever a key is used.
    """
    number = add(
        (jnp.zeros_like(episode, jnp.uint32), episode.astype(jnp.uint32)), word(_INCREMENT)
    )
    halves = np.array([_halves(purpose + _INCREMENT) for purpose in purposes], np.uint32)
    last = halves.T.reshape(2, -1, *[1] * episode.ndim)
    shape = (len(purposes), *episode.shape)

    def spread(values: Any) -> Array:
        return jnp.broadcast_to(values, shape)

    def stir(key: Word, value: Any) -> tuple[Word, None]:
        return mix(exclusive_or(key, value)), None

    begun = add(seed, word(_INCREMENT))
    values = [jnp.stack([spread(0 * part), spread(part), spread(end)])
              for part, end in zip(number, last, strict=True)]  # fmt: skip
    keys, _ = jax.lax.scan(stir, (spread(begun[0]), spread(begun[1])), tuple(values))
    return [(keys[0][k], keys[1][k]) for k in range(len(purposes))]


def word_of(key: Word, counter: Any) -> Word:
    """``physics.random_streams.word_of``."""
    count = jnp.asarray(counter).astype(jnp.uint32) + jnp.uint32(1)
    return mix(add(key, times((jnp.zeros_like(count), count), word(_INCREMENT))))


def uniform(key: Word, counter: Any, dtype: Any) -> Any:
    """``physics.random_streams.uniform``: exact in float64, rounded in float32."""
    high, low = word_of(key, counter)
    return high.astype(dtype) * 2.0**-32 + (low >> 11).astype(dtype) * 2.0**-53


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
