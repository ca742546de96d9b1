"""Counter-based random numbers, so that an episode is independent of batch and thread.

A stream has a key derived from (seed, episode, purpose); its k-th number is a function of the key
and k. The mixing function is that of SplitMix64 (Steele, Lea and Flood, 2014).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..compilation import compiled, inner_kernel, kernel

(
    START, FRAMES, OBSTACLES, GRAPH, SENSING, ACTUATION, SWITCHING, TRAFFIC, ACTIVATION, EVENTS,
) = range(10)  # fmt: skip
"""Purposes of streams; separate streams are independent."""

_INCREMENT = np.uint64(0x9E3779B97F4A7C15)
_FACTOR_1 = np.uint64(0xBF58476D1CE4E5B9)
_FACTOR_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_30, _SHIFT_27, _SHIFT_31, _SHIFT_11 = (np.uint64(shift) for shift in (30, 27, 31, 11))
_TO_UNIT_INTERVAL = 2.0**-53


@kernel
def mix(word):
    """Scramble 64 bits: the finaliser of SplitMix64, a bijection of uint64, without unit.

    z ← (z ⊕ z≫30) · c₁,   z ← (z ⊕ z≫27) · c₂,   z ← z ⊕ z≫31
    """
    word = (word ^ (word >> _SHIFT_30)) * _FACTOR_1
    word = (word ^ (word >> _SHIFT_27)) * _FACTOR_2
    return word ^ (word >> _SHIFT_31)


@kernel
def stream_key(seed, episode, purpose):
    """Key of the stream for one purpose (START … EVENTS) in one episode of a seed, uint64.

    mix(mix(mix(seed + γ) ⊕ (episode + γ)) ⊕ (purpose + γ)), without unit; γ is the increment of
    SplitMix64.
    """
    key = mix(np.uint64(seed) + _INCREMENT)
    key = mix(key ^ (np.uint64(episode) + _INCREMENT))
    return mix(key ^ (np.uint64(purpose) + _INCREMENT))


@inner_kernel
def word_of(key, counter):
    """Word of a stream at an index k, from 0 on: mix(key + (k + 1) γ), uint64, without unit."""
    return mix(key + np.uint64(counter + 1) * _INCREMENT)


@inner_kernel(inline="code")
def later_key(key, count):
    """Key of a stream without its first words, a number without unit.

    Its word k is word k + count of the stream.
    """
    return key + np.uint64(count) * _INCREMENT


@kernel
def uniform(key, counter):
    """Number of a stream at an index, without unit, uniform in [0, 1): 2⁻⁵³ · ⌊word/2¹¹⌋."""
    return np.float64(word_of(key, counter) >> _SHIFT_11) * _TO_UNIT_INTERVAL


@kernel
def draw_rotation(key, first_counter, axes):
    """Uniformly distributed rotation R, row by row, 4 or 9 numbers without unit.

    Uses at most three numbers u of a stream: an angle 2πu in the plane, a uniform unit quaternion
    in 3-D (Shoemake, 1992). ``axes`` are (0, 1) or (0, 1, 2).
    """
    turn = 2.0 * math.pi * uniform(key, first_counter)
    if len(axes) == 2:
        c, s = math.cos(turn), math.sin(turn)
        return c, -s, s, c
    other_turn = 2.0 * math.pi * uniform(key, first_counter + 1)
    share = uniform(key, first_counter + 2)
    small, large = math.sqrt(1.0 - share), math.sqrt(share)
    x, y = small * math.sin(turn), small * math.cos(turn)
    z, w = large * math.sin(other_turn), large * math.cos(other_turn)
    return (
        1 - 2 * (y * y + z * z),
        2 * (x * y - z * w),
        2 * (x * z + y * w),
        2 * (x * y + z * w),
        1 - 2 * (x * x + z * z),
        2 * (y * z - x * w),
        2 * (x * z - y * w),
        2 * (y * z + x * w),
        1 - 2 * (x * x + y * y),
    )


def ignore_overflow(run: Callable[..., Any]) -> Callable[..., Any]:
    """Suppress NumPy's overflow warnings of 64-bit products in plain Python, without unit."""
    return run if compiled() else np.errstate(over="ignore")(run)
