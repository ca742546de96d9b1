"""Linear layers of a trained network in NumPy, taken out of its weights."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Layer = tuple[Array, Array]
"""Weight (outputs, inputs) and bias (outputs,)."""


def linear_layers(
    weights: Mapping[str, NDArray[Any]], name: str, sizes: tuple[int, ...]
) -> list[Layer]:
    """Linear layers with a ReLU behind each, which takes a number of its own.

    Raises:
        ValueError: see ``linear_layer``.
    """
    names = (f"{name}.{2 * k}" for k in range(len(sizes) - 1))
    return [
        linear_layer(weights, f"{layer}.weight", f"{layer}.bias", *pair)
        for layer, pair in zip(names, pairwise(sizes), strict=True)
    ]


def linear_layer(
    weights: Mapping[str, NDArray[Any]], weight: str, bias: str, inputs: int, outputs: int
) -> Layer:
    """The layer whose arrays have these names.

    Raises:
        ValueError: naming an array that is missing, of another shape or not finite.
    """
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
    """What the layers make of values (..., inputs)."""
    for weight, bias in layers:
        values = np.maximum(values @ weight.T + bias, np.float32(0.0))
    return values
