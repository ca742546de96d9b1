"""Memory of robots in one array, passed to kernels as one argument."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def make_records(
    robots: tuple[int, int], fields: Mapping[str, tuple[int, ...]]
) -> tuple[Array, dict[str, Array]]:
    """Zeros (B, n, size) for consecutive fields of these shapes, and a view of each.

    The view of a field of one number is (B, n).
    """
    sizes = [math.prod(shape) for shape in fields.values()]
    memory, views = np.zeros((*robots, sum(sizes))), {}
    for (name, shape), size, end in zip(fields.items(), sizes, np.cumsum(sizes), strict=True):
        view = memory[..., end - size : end].reshape(*robots, *shape)
        views[name] = view[..., 0] if size == 1 else view
    return memory, views
