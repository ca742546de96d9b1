"""Actor of a trained network in NumPy, without a learning library."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .feature_kernels import NEIGHBOUR_COLUMNS, OBSTACLE_COLUMNS
from .features import FeatureLayout
from .policy_settings import PolicySettings

Array = NDArray[np.float32]
Weights = Mapping[str, NDArray[Any]]
Layer = tuple[Array, Array]
"""Weight (outputs, inputs) and bias (outputs,)."""
_AT_ONCE = 1024
"""Number of robots processed together; more rows exceed the processor's cache."""


class Network(ABC):
    """Base class of networks with a preference for each choice."""

    def choose(self, shown: Array, hidden: Array | None = None) -> NDArray[np.int64]:
        """Greedy choices (N,) for features (N, layout.size).

        ``hidden``, (N, units), is the recurrent state, updated in place; None without one.
        """
        choices = np.empty(len(shown), dtype=np.int64)
        for first in range(0, len(shown), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            known = None if hidden is None else hidden[some]
            choices[some] = self.preferences(shown[some], known).argmax(axis=-1)
        return choices

    @abstractmethod
    def preferences(self, shown: Array, hidden: Array | None = None) -> Array:
        """Logits of the choices, (N, choices); arguments as ``choose``."""


class NumpyActor(Network):
    """``train.learn.networks.HeadingNetwork`` with these weights, without its critic.

    The number of slots may differ from that in training. A ValueError names an array that is
    missing or does not fit.
    """

    def __init__(self, weights: Weights, settings: PolicySettings, layout: FeatureLayout) -> None:
        width, hidden = settings.set_width, settings.hidden
        rows = {"neighbour_net": NEIGHBOUR_COLUMNS, "obstacle_net": OBSTACLE_COLUMNS}
        self._layout = layout
        self.sets = [
            linear_layers(weights, f"features_extractor.{name}", (columns, width, width))
            for name, columns in rows.items()
        ]
        features = 4 * width + layout.context_columns
        units = self._units = settings.units
        self.memory = RecurrentUnit(weights, features, units) if units else None
        sizes = (units + features, *hidden)
        self.layers = linear_layers(weights, "mlp_extractor.policy_net", sizes)
        last = sizes[-1], settings.choices
        self.last = linear_layer(weights, "action_net.weight", "action_net.bias", *last)

    def preferences(self, shown: Array, hidden: Array | None = None) -> Array:
        """As ``Network.preferences``."""
        seen = self._layout.split(shown)
        sets = zip(self.sets, (seen.neighbours, seen.obstacles), strict=True)
        pooled = [part for layers, rows in sets for part in _pooled(layers, rows)]
        features = np.concatenate([*pooled, seen.context], axis=-1)
        if self.memory is not None:
            if hidden is None:
                hidden = np.zeros((len(shown), self._units), dtype=np.float32)
            hidden[...] = self.memory.next(features, hidden)
            features = np.concatenate([hidden, features], axis=-1)
        weight, bias = self.last
        return through(self.layers, features) @ weight.T + bias


def _pooled(layers: list[Layer], rows: Array) -> tuple[Array, Array]:
    """Mean and maximum of features over the rows that are present, (N, width) each."""
    present = rows.any(axis=-1)
    count = present.sum(axis=-1)
    features = through(layers, rows[present])
    mean = np.zeros((len(rows), features.shape[-1]), dtype=np.float32)
    largest = np.zeros_like(mean)
    if len(features):
        some = count > 0
        firsts = (np.cumsum(count) - count)[some]
        mean[some] = np.add.reduceat(features, firsts) / count[some, np.newaxis]
        largest[some] = np.maximum.reduceat(features, firsts)
    return mean, largest


def linear_layers(weights: Weights, name: str, sizes: tuple[int, ...]) -> list[Layer]:
    """Consecutive linear layers, each followed by a ReLU."""
    return [
        linear_layer(weights, f"{name}.{2 * k}.weight", f"{name}.{2 * k}.bias", *pair)
        for k, pair in enumerate(pairwise(sizes))
    ]


def linear_layer(weights: Weights, weight: str, bias: str, inputs: int, outputs: int) -> Layer:
    """Layer with arrays of these names; a ValueError names one that is missing or does not fit."""
    shapes = {weight: (outputs, inputs), bias: (outputs,)}
    for key, shape in shapes.items():
        if key not in weights:
            raise ValueError(f"weights have no {key!r}")
        if weights[key].shape != shape:
            raise ValueError(f"size mismatch: {key} is {weights[key].shape}; it must be {shape}")
        if not np.isfinite(weights[key]).all():
            raise ValueError(f"{key} must be finite")
    first, second = (np.asarray(weights[key], dtype=np.float32) for key in shapes)
    return first, second


def through(layers: list[Layer], values: Array) -> Array:
    """Output of the layers for values (..., inputs)."""
    for weight, bias in layers:
        values = np.maximum(values @ weight.T + bias, np.float32(0.0))
    return values


class RecurrentUnit:
    """Recurrent unit, as ``torch.nn.GRUCell`` (Cho et al. 2014).

        r = σ(W_r x + U_r h),   z = σ(W_z x + U_z h),   m = tanh(W_m x + r ⊙ (U_m h))
        h ← (1 − z) ⊙ m + z ⊙ h

    Each W and U has a bias.
    """

    def __init__(self, weights: Weights, inputs: int, units: int) -> None:
        names = [("memory.weight_ih", "memory.bias_ih"), ("memory.weight_hh", "memory.bias_hh")]
        self.seen = linear_layer(weights, *names[0], inputs, 3 * units)
        self.kept = linear_layer(weights, *names[1], units, 3 * units)

    def next(self, features: Array, hidden: Array) -> Array:
        """Hidden state, (N, units), after features (N, inputs)."""
        (weight_x, bias_x), (weight_h, bias_h) = self.seen, self.kept
        r_x, z_x, m_x = np.split(features @ weight_x.T + bias_x, 3, axis=-1)
        r_h, z_h, m_h = np.split(hidden @ weight_h.T + bias_h, 3, axis=-1)
        r, z = _sigmoid(r_x + r_h), _sigmoid(z_x + z_h)
        m = np.tanh(m_x + r * m_h)
        return m + z * (hidden - m)


def _sigmoid(x: Array) -> Array:
    """1/(1 + e^−x), computed from tanh, which cannot overflow."""
    half = np.float32(0.5)
    return half * (np.tanh(half * x) + np.float32(1.0))
