"""Memory of robots in one array, passed to kernels as one argument."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Records:
    """Consecutive fields of each robot in one array.

    Copies and pickles are independent, since views are made on request.

    Args:
        robots: B and n.
        fields: shape of each field by name.

    Attributes:
        array: (B, n, total size), zeros at first.
    """

    def __init__(self, robots: tuple[int, int], fields: Mapping[str, tuple[int, ...]]) -> None:
        self._fields = dict(fields)
        self.array = np.zeros((*robots, sum(map(math.prod, fields.values()))))

    @property
    def views(self) -> dict[str, Array]:
        """View (B, n, ...) of each field by name; (B, n) for a field of one number."""
        views, start = {}, 0
        for name, shape in self._fields.items():
            size = math.prod(shape)
            view = self.array[..., start : start + size].reshape(*self.array.shape[:2], *shape)
            views[name] = view[..., 0] if size == 1 else view
            start += size
        return views
