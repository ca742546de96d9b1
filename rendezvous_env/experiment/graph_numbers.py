"""Components, D̄ and a* of a matrix of weights (theory 3 and 4), and what directed ones have
instead.
"""

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


def closed_groups(weights: NDArray[np.float64]) -> list[list[int]]:
    """Groups of robots who see nobody outside and cannot be divided so: the strongly connected
    components that no arc leaves.

    One alone means that some robot is led to from all: it is globally reachable (guarantees,
    section 10).
    """
    from scipy.sparse.csgraph import connected_components

    count, labels = connected_components(weights > 0, directed=True, connection="strong")
    sees, seen = np.nonzero(weights > 0)
    left = set(labels[sees][labels[sees] != labels[seen]].tolist())
    return [np.flatnonzero(labels == label).tolist() for label in range(count) if label not in left]


def max_out_degree(weights: NDArray[np.float64]) -> float:
    """D̄ of one matrix of arcs: the largest D_i = Σ_j a_ij that merging along them can produce.

    Who sees one robot at most never comes to see two: it merges with it, or with one who sees it.
    """
    if not np.any(weights > 0):
        return 0.0
    most = 1 if (weights > 0).sum(axis=1).max() <= 1 else len(weights) - 1
    return min(most * float(weights.max()), float(weights.sum()))


def least_weight(weights: NDArray[np.float64]) -> float:
    """The least weight of an arc, which no D_i of a robot that sees someone falls below."""
    return float(weights[weights > 0].min(initial=np.inf)) if np.any(weights > 0) else 0.0
