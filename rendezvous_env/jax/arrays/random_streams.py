"""The random streams of the engine (``physics.random_streams``) in words of 32 bits.

A word of 64 bits is a pair (high, low) of uint32, since uint64 needs ``jax_enable_x64``.
"""

from typing import Any

import jax.numpy as jnp

Word = tuple[Any, Any]


def word(value: int) -> Word:
    """Convert an integer of at most 64 bits to a word."""
    return jnp.uint32(value >> 32 & 0xFFFFFFFF), jnp.uint32(value & 0xFFFFFFFF)


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


def stream_key(seed: Word, episode: Any, purpose: int) -> Word:
    """``physics.random_streams.stream_key`` of a seed (a word), an episode and a purpose."""
    number = jnp.zeros_like(episode, jnp.uint32), episode.astype(jnp.uint32)
    key = mix(add(seed, word(_INCREMENT)))
    key = mix(exclusive_or(key, add(number, word(_INCREMENT))))
    return mix(exclusive_or(key, word(purpose + _INCREMENT)))


def word_of(key: Word, counter: Any) -> Word:
    """``physics.random_streams.word_of``."""
    count = jnp.asarray(counter).astype(jnp.uint32) + jnp.uint32(1)
    return mix(add(key, times((jnp.zeros_like(count), count), word(_INCREMENT))))


def uniform(key: Word, counter: Any, dtype: Any) -> Any:
    """``physics.random_streams.uniform``: exact in float64, rounded in float32."""
    high, low = word_of(key, counter)
    return high.astype(dtype) * 2.0**-32 + (low >> 11).astype(dtype) * 2.0**-53
