"""The random streams of the engine (``physics.random_streams``) in words of 32 bits.

A word of 64 bits is a pair (high, low) of uint32, since uint64 needs ``jax_enable_x64``.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

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


def shifted(a: Word, bits: Any) -> Word:
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
    """``physics.random_streams.mix``.

    Its two rounds are a loop, whose result XLA does not compute anew wherever it is used.
    """
    shape = jnp.broadcast_shapes(jnp.shape(a[0]), jnp.shape(a[1]))
    a = jnp.broadcast_to(a[0], shape), jnp.broadcast_to(a[1], shape)

    def multiply(a: Word, factor: Any) -> tuple[Word, None]:
        bits, *other = factor
        return times(exclusive_or(a, shifted(a, bits)), (other[0], other[1])), None

    rounds = np.array([(30, *_halves(_FACTOR_1)), (27, *_halves(_FACTOR_2))], np.uint32)
    a, _ = jax.lax.scan(multiply, a, tuple(rounds.T))
    return exclusive_or(a, shifted(a, 31))


def _halves(value: int) -> tuple[int, int]:
    return value >> 32 & 0xFFFFFFFF, value & 0xFFFFFFFF


def stream_keys(seed: Word, episode: Any, *purposes: int) -> list[Word]:
    """``physics.random_streams.stream_key`` of a seed (a word), an episode and each purpose."""
    number = jnp.zeros_like(episode, jnp.uint32), episode.astype(jnp.uint32)
    key = mix(add(seed, word(_INCREMENT)))
    key = mix(exclusive_or(key, add(number, word(_INCREMENT))))
    halves = np.array([_halves(purpose + _INCREMENT) for purpose in purposes], np.uint32)
    high, low = halves.T.reshape(2, -1, *[1] * episode.ndim)
    keys = mix(exclusive_or(key, (high, low)))
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
    """Numbers (count, …) of streams from counters (…) on, sampled at once."""
    index = np.arange(count).reshape(-1, *[1] * jnp.ndim(first))
    return Numbers(uniform(key, first + index, dtype))
