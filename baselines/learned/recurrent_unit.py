"""The memory of a trained network in NumPy: a gated recurrent unit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .linear_layers import Array, linear_layer


class RecurrentUnit:
    """What a robot remembers, as ``torch.nn.GRUCell`` has it (Cho et al. 2014).

        r = σ(W_r x + U_r h),   z = σ(W_z x + U_z h),   m = tanh(W_m x + r ⊙ (U_m h))
        h ← (1 − z) ⊙ m + z ⊙ h

    each W and U with its bias.

    Args:
        weights: of a network's state, by name; those of ``memory`` are read.
        inputs: numbers in x.
        units: numbers in h.

    Raises:
        ValueError: naming an array that is missing, of another shape or not finite.
    """

    def __init__(self, weights: Mapping[str, NDArray[Any]], inputs: int, units: int) -> None:
        self.units = units
        names = [("memory.weight_ih", "memory.bias_ih"), ("memory.weight_hh", "memory.bias_hh")]
        self._seen = linear_layer(weights, *names[0], inputs, 3 * units)
        self._kept = linear_layer(weights, *names[1], units, 3 * units)

    def nothing(self, robots: int) -> Array:
        """What so many robots remember at first, (N, units): zeros."""
        return np.zeros((robots, self.units), dtype=np.float32)

    def next(self, features: Array, hidden: Array) -> Array:
        """What is remembered, (N, units), after features (N, inputs)."""
        (weight_x, bias_x), (weight_h, bias_h) = self._seen, self._kept
        r_x, z_x, m_x = np.split(features @ weight_x.T + bias_x, 3, axis=-1)
        r_h, z_h, m_h = np.split(hidden @ weight_h.T + bias_h, 3, axis=-1)
        r, z = _sigmoid(r_x + r_h), _sigmoid(z_x + z_h)
        m = np.tanh(m_x + r * m_h)
        return m + z * (hidden - m)


def _sigmoid(x: Array) -> Array:
    """1/(1 + e^−x), by the tangent, which cannot overflow."""
    half = np.float32(0.5)
    return half * (np.tanh(half * x) + np.float32(1.0))
