"""The actor of a trained network in NumPy: what it would choose, without its learning library."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .linear_layers import Array, Layer, linear_layer, linear_layers, through
from .perception_layout import NEIGHBOUR_COLUMNS, OBSTACLE_COLUMNS, PerceptionLayout
from .policy_settings import PolicySettings
from .recurrent_unit import RecurrentUnit

_AT_ONCE = 1024
"""Robots whose choices are computed together; the rows of more do not fit the processor's cache."""


class Network(ABC):
    """A network that prefers some choices to others."""

    def choose(self, shown: Array, hidden: Array | None = None) -> NDArray[np.int64]:
        """The likeliest choices (N,) of N robots.

        Args:
            shown: what they are shown, (N, layout.size).
            hidden: what they remember, (N, units); it moves on in place. None is nothing.
        """
        choices = np.empty(len(shown), dtype=np.int64)
        for first in range(0, len(shown), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            known = None if hidden is None else hidden[some]
            choices[some] = self.preferences(shown[some], known).argmax(axis=-1)
        return choices

    @abstractmethod
    def preferences(self, shown: Array, hidden: Array | None = None) -> Array:
        """Logarithms of the choices' chances up to a constant, (N, choices); as ``choose``."""


class Chooser(Network):
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
            linear_layers(weights, f"features_extractor.{name}", (columns, width, width))
            for name, columns in rows.items()
        ]
        features = 4 * width + layout.context_columns
        units = settings.units
        self._memory = RecurrentUnit(weights, features, units) if units else None
        sizes = (units + features, *hidden)
        self._policy = linear_layers(weights, "mlp_extractor.policy_net", sizes)
        last = sizes[-1], len(settings.angles)
        self._action = linear_layer(weights, "action_net.weight", "action_net.bias", *last)

    def preferences(self, shown: Array, hidden: Array | None = None) -> Array:
        """As ``Network.preferences``."""
        seen = self._layout.split(shown)
        sets = zip(self._sets, (seen.neighbours, seen.obstacles), strict=True)
        pooled = [part for layers, rows in sets for part in _pooled(layers, rows)]
        features = np.concatenate([*pooled, seen.context], axis=-1)
        if self._memory is not None:
            hidden = self._memory.nothing(len(shown)) if hidden is None else hidden
            hidden[...] = self._memory.next(features, hidden)
            features = np.concatenate([hidden, features], axis=-1)
        weight, bias = self._action
        return through(self._policy, features) @ weight.T + bias


def _pooled(layers: list[Layer], rows: Array) -> tuple[Array, Array]:
    """Mean and largest feature over the rows that are present, (N, width) each."""
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
