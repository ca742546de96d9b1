"""Components, D̄ and a* of a matrix of weights (theory 3 and 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def components(weights: NDArray[np.float64]) -> list[list[int]]:
    """Connected components of a weight matrix, as lists of indices."""
    from scipy.sparse.csgraph import connected_components

    count, labels = connected_components(weights > 0, directed=False)
    return [np.flatnonzero(labels == label).tolist() for label in range(count)]


def max_degree(weights: NDArray[np.float64]) -> float:
    """D̄ of one connected weight matrix: the largest D_i that merging can produce (theory 4)."""
    if not np.any(weights > 0):
        return 0.0
    n, heaviest = len(weights), float(weights.max())
    neighbours = int((weights > 0).sum(axis=1).max())
    most = 2 if neighbours <= 2 else n - 1
    return min(most * heaviest, float(np.triu(weights).sum()))


def bottleneck_weight(weights: NDArray[np.float64]) -> float:
    """a* of a weight matrix: the least edge of a maximum spanning tree (of each component)."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    links = csr_array(np.where(weights > 0, -weights, 0.0))  # of dense ones SciPy drops small links
    tree = minimum_spanning_tree(links)
    return float(-tree.data.max()) if tree.nnz else 0.0
