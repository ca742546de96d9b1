"""Edge lists and weight matrices: parsing, validation, and their quantities (theory 3, 4)."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import check_shape, is_int, raise_invalid, short_repr, to_float
from ..limits import LARGEST, SMALLEST
from .reading import as_matrix, is_networkx, networkx_edges, rows_of, weight_of

_ROUNDING = 1e-6  # relative difference of a_ij and a_ji, for float32 matrices


class Edges:
    """Sorted edges (i, j, a_ij), m/s: three arrays (E,) that act as a tuple of triples."""

    def __init__(self, first: NDArray[Any], second: NDArray[Any], weight: NDArray[Any]) -> None:
        n = 1 + max(first.max(initial=0), second.max(initial=0))
        place = first * n + second
        if not (place[1:] > place[:-1]).all():
            order = np.argsort(place, kind="stable")
            first, second, weight = first[order], second[order], weight[order]
        self.first, self.second = first.astype(np.int64), second.astype(np.int64)
        self.weight = weight.astype(np.float64)

    def __len__(self) -> int:
        return len(self.first)

    def __iter__(self) -> Iterator[tuple[int, int, float]]:
        return zip(*(column.tolist() for column in self._columns()), strict=True)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Edges):
            return tuple(self) == other
        return all(map(np.array_equal, self._columns(), other._columns()))

    def __hash__(self) -> int:
        return hash(tuple(column.tobytes() for column in self._columns()))

    def __repr__(self) -> str:
        return repr(tuple(self))

    def _columns(self) -> tuple[NDArray[Any], ...]:
        return self.first, self.second, self.weight


def read_edges(edges: Any) -> tuple[tuple[int, int, float], ...]:
    """Parse given edges: (i, j), of weight 1 m/s, or (i, j, weight).

    The weight is a number, or the attributes of a networkx edge.
    """
    if is_networkx(edges):
        return tuple(map(_as_edge, networkx_edges(edges)))
    scalar = isinstance(edges, np.ndarray) and edges.ndim == 0  # claims to be iterable
    if isinstance(edges, str | bytes) or not isinstance(edges, Iterable) or scalar:
        raise_invalid("graph: edges", edges, "a sequence of (i, j) or (i, j, weight)")
    return tuple(map(_as_edge, rows_of(edges)))


def _as_edge(edge: Any) -> tuple[int, int, float]:
    """Parse one edge; indices may be integral floats."""
    row = edge.tolist() if isinstance(edge, np.ndarray) else edge
    if not isinstance(row, Sequence) or isinstance(row, str | bytes) or len(row) not in (2, 3):
        raise_invalid("graph: an edge", edge, "(i, j) or (i, j, weight) with indices of robots")
    i, j, weight = (*row, None)[:3]
    weight = weight_of(weight)
    if not all(is_int(k) or to_float(k).is_integer() for k in (i, j)):
        raise_invalid(
            "graph: an edge", edge, "(i, j) or (i, j, weight) with whole indices of robots"
        )
    if not SMALLEST <= to_float(weight) <= LARGEST:
        raise ValueError(
            f"graph: edge ({int(i)}, {int(j)}) has weight {short_repr(weight)}; it must be "
            "positive and "
            f"finite, from {SMALLEST:g} to {LARGEST:g} m/s"
        )
    return int(i), int(j), to_float(weight)


def checked_edges(edges: Any, n: int, *, directed: bool) -> Edges:
    """Validated edges of a graph of n robots, with i < j if undirected.

    Raises:
        ValueError: for a loop or a repeated edge.
    """
    if isinstance(edges, Edges):
        first, second, weight = edges.first, edges.second, edges.weight
    else:
        for i, j, _ in edges:  # too large for an array
            if not (0 <= i < n and 0 <= j < n):
                _refuse_edge(i, j, n)
        table = np.array(edges, dtype=np.float64).reshape(-1, 3)
        first, second = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
        weight = table[:, 2]
    low, high = np.minimum(first, second), np.maximum(first, second)
    start, end = (first, second) if directed else (low, high)
    wrong, place = (first == second) | (low < 0) | (high >= n), start * n + end
    if not (place[1:] > place[:-1]).all():
        _, once = np.unique(place, return_index=True)
        wrong |= ~np.isin(np.arange(len(first)), once)
    if wrong.any():
        place = int(np.argmax(wrong))
        _refuse_edge(int(first[place]), int(second[place]), n)
    return Edges(start, end, weight)


def _refuse_edge(i: int, j: int, n: int) -> None:
    raise ValueError(f"graph: edge ({i}, {j}) must join two different robots of 0..{n - 1}, once")


def weighted_links(
    weights: Any, n: int | None = None, field: str = "graph", *, directed: bool = False
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Links of an (n, n) matrix of weights, an array or sparse: robots (E,), (E,), a_ij (E,), m/s.

    Undirected links have i < j, and the mean of a_ij and a_ji if they differ by rounding.

    Raises:
        ValueError: naming the first entry that is not finite, negative, out of the limits, on the
            diagonal or, unless ``directed``, not symmetric; or for another shape.
    """
    matrix = as_matrix(field, weights)
    size = n if n is not None else max((2, *matrix.shape[:1]))
    check_shape(f"{field}: weights", matrix, (size, size), axes="(n, n)")
    first, second = matrix.nonzero()
    found, mirrored = (np.ravel(matrix[at]) for at in ((first, second), (second, first)))
    uneven = np.zeros(len(found), bool)
    if not directed:
        with np.errstate(invalid="ignore"):  # for infinite weights
            uneven = np.abs(found - mirrored) > _ROUNDING * np.maximum(found, mirrored)
    reasons = (
        (~np.isfinite(found), "must be finite"),
        (found < 0, "must not be negative"),
        (
            (found < SMALLEST) | (found > LARGEST),
            f"must be 0, or from {SMALLEST:g} to {LARGEST:g} m/s",
        ),
        (first == second, "must be 0: no robot is its own neighbour"),
        (
            uneven,
            "must equal its mirror image: the graph is undirected (a_ij = a_ji); graphs.directed "
            "takes others",
        ),
    )
    for wrong, reason in reasons:
        if wrong.any():
            i, j = int(first[wrong][0]), int(second[wrong][0])
            raise ValueError(f"{field}: weight a[{i}, {j}] = {matrix[i, j]} {reason}")
    if directed:
        return first.astype(np.int64), second.astype(np.int64), found
    upper = first < second
    mean = 0.5 * (found[upper] + mirrored[upper])
    return first[upper].astype(np.int64), second[upper].astype(np.int64), mean


# Weights are an (n, n) array or sparse matrix of SciPy; the work is proportional to the edges.


def sparse(weights: Any) -> Any:
    """Weights as a sparse matrix without explicit zeros."""
    from scipy.sparse import csr_array, issparse

    if issparse(weights):
        return weights
    # SciPy drops small weights of dense matrices
    return csr_array(np.where(weights > 0, weights, 0.0))


def components(weights: Any) -> list[list[int]]:
    """Connected components of a weight matrix, as lists of indices."""
    from scipy.sparse.csgraph import connected_components

    return _groups(*connected_components(sparse(weights), directed=False))


def _groups(count: int, labels: NDArray[Any]) -> list[list[int]]:
    ordered = np.argsort(labels, kind="stable")
    ends = np.cumsum(np.bincount(labels, minlength=count))[:-1]
    return [group.tolist() for group in np.split(ordered, ends)]


def max_degree(weights: Any, *, directed: bool = False) -> float:
    """D̄: the maximum D_i = Σ_j a_ij that merging can produce (theory 4), m/s.

    On paths and cycles no robot gets more than two neighbours, and if every robot observes at most
    one other, this remains so. Other components can become a star.
    """
    from scipy.sparse.csgraph import connected_components

    matrix = sparse(weights)
    if not matrix.nnz:
        return 0.0
    count, labels = connected_components(matrix, directed=False)
    few = 1 if directed else 2
    most_seen, heaviest = np.zeros(count, np.int64), np.zeros(count)
    np.maximum.at(most_seen, labels, np.diff(matrix.indptr))
    np.maximum.at(heaviest, labels, matrix.max(axis=1).toarray().ravel())
    total = np.bincount(labels, matrix.sum(axis=1)) * (1.0 if directed else 0.5)
    most = np.where(most_seen <= few, few, np.bincount(labels) - 1)
    return float(np.minimum(most * heaviest, total).max())


def bottleneck_weight(weights: Any) -> float:
    """a* of a weight matrix: the minimum edge of a maximum spanning tree (of each component)."""
    from scipy.sparse.csgraph import minimum_spanning_tree

    tree = minimum_spanning_tree(-sparse(weights))
    return float(-tree.data.max()) if tree.nnz else 0.0


def closed_groups(weights: Any) -> list[list[int]]:
    """Strongly connected components without outgoing edges.

    If there is only one, its robots are globally reachable (guarantees, section 10).
    """
    from scipy.sparse.csgraph import connected_components

    matrix = sparse(weights)
    count, labels = connected_components(matrix, directed=True, connection="strong")
    sees, seen = matrix.nonzero()
    left = set(labels[sees][labels[sees] != labels[seen]].tolist())
    groups = _groups(count, labels)
    return [groups[label] for label in range(count) if label not in left]
