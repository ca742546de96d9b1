"""The actor of a trained network in NumPy: what it would choose, without its learning library."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .perception_layout import NEIGHBOUR_COLUMNS, OBSTACLE_COLUMNS, PerceptionLayout
from .policy_settings import PolicySettings

Array = NDArray[np.float32]
_AT_ONCE = 1024
"""Robots whose choices are computed together; the rows of more do not fit the processor's cache."""


class Chooser:
    """A network's likeliest choices, as ``networks.HeadingNetwork`` has them.

    Args:
        weights: of its state, by name; those of the critic are not needed.
        settings: that it was trained with.
        layout: of what it is shown; its numbers of slots need not be those of training.

    Raises:
        ValueError: naming an array that is missing, of another shape or not finite.
    """

    def __init__(
        self,
        weights: Mapping[str, NDArray[Any]],
        settings: PolicySettings,
        layout: PerceptionLayout,
    ) -> None:
        width, hidden = settings.set_width, settings.hidden
        rows = {"neighbour_net": NEIGHBOUR_COLUMNS, "obstacle_net": OBSTACLE_COLUMNS}
        self._layout = layout
        self._sets = [
            _layers(weights, f"features_extractor.{name}", (columns, width, width))
            for name, columns in rows.items()
        ]
        sizes = (4 * width + layout.context_columns, *hidden)
        self._policy = _layers(weights, "mlp_extractor.policy_net", sizes)
        last = sizes[-1], len(settings.angles)
        self._action = _layer(weights, "action_net", *last)

    def choose(self, shown: Array) -> NDArray[np.int64]:
        """The likeliest choices (N,) for what N robots are shown, (N, layout.size)."""
        choices = np.empty(len(shown), dtype=np.int64)
        for first in range(0, len(shown), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            choices[some] = self.preferences(shown[some]).argmax(axis=-1)
        return choices

    def preferences(self, shown: Array) -> Array:
        """Logarithms of the choices' chances up to a constant, (N, choices)."""
        seen = self._layout.split(shown)
        sets = zip(self._sets, (seen.neighbours, seen.obstacles), strict=True)
        pooled = [part for layers, rows in sets for part in _pooled(layers, rows)]
        features = np.concatenate([*pooled, seen.context], axis=-1)
        weight, bias = self._action
        return _through(self._policy, features) @ weight.T + bias


Layer = tuple[Array, Array]


def _layers(weights: Mapping[str, NDArray[Any]], name: str, sizes: tuple[int, ...]) -> list[Layer]:
    """Linear layers with a ReLU behind each, which takes a number of its own."""
    pairs = enumerate(pairwise(sizes))
    return [_layer(weights, f"{name}.{2 * k}", *pair) for k, pair in pairs]


def _layer(weights: Mapping[str, NDArray[Any]], name: str, inputs: int, outputs: int) -> Layer:
    shapes = {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}
    for key, shape in shapes.items():
        if key not in weights:
            raise ValueError(f"weights have no {key!r}")
        if weights[key].shape != shape:
            raise ValueError(f"size mismatch: {key} is {weights[key].shape}; it must be {shape}")
        if not np.isfinite(weights[key]).all():
            raise ValueError(f"{key} must be finite")
    weight, bias = (np.asarray(weights[key], dtype=np.float32) for key in shapes)
    return weight, bias


def _through(layers: list[Layer], values: Array) -> Array:
    for weight, bias in layers:
        values = np.maximum(values @ weight.T + bias, np.float32(0.0))
    return values


def _pooled(layers: list[Layer], rows: Array) -> tuple[Array, Array]:
    """Mean and largest feature over the rows that are present, (N, width) each."""
    present = rows.any(axis=-1)
    count = present.sum(axis=-1)
    features = _through(layers, rows[present])
    mean = np.zeros((len(rows), features.shape[-1]), dtype=np.float32)
    largest = np.zeros_like(mean)
    if len(features):
        some = count > 0
        firsts = (np.cumsum(count) - count)[some]
        mean[some] = np.add.reduceat(features, firsts) / count[some, np.newaxis]
        largest[some] = np.maximum.reduceat(features, firsts)
    return mean, largest
