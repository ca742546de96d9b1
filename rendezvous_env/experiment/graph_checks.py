"""What makes edges, matrices and ranges of weights fit to be a sensing graph's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .checks import is_whole, real, refuse, shown
from .limits import LARGEST, SMALLEST


def as_range(weight: Any) -> tuple[float, float]:
    """The lowest and highest of a range of weights, from one number or two, m/s.

    Raises:
        ValueError: for what is no range within the limits.
    """
    pair = tuple(weight) if isinstance(weight, list | tuple) else (weight, weight)
    if len(pair) != 2 or not SMALLEST <= real(pair[0]) <= real(pair[1]) <= LARGEST:
        raise ValueError(
            f"graph: weight_range {shown(pair)} must be finite, 0 < low <= high, from "
            f"{SMALLEST:g} to {LARGEST:g} m/s"
        )
    return real(pair[0]), real(pair[1])


def listed_edges(edges: Any) -> tuple[Any, ...]:
    """Edges that were given as any sequence.

    Raises:
        ValueError: for what is none.
    """
    if not isinstance(edges, Iterable) or isinstance(edges, str | bytes):
        refuse("graph: edges", edges, "a sequence of (i, j) or (i, j, weight)")
    return tuple(edges)


def as_edge(edge: Any) -> tuple[int, int, float]:
    """One edge, its weight 1 m/s if it is not given; whole numbers may come as floats.

    Raises:
        ValueError: for what is no edge, or a weight out of the limits.
    """
    row = edge.tolist() if isinstance(edge, np.ndarray) else edge
    if not isinstance(row, Sequence) or isinstance(row, str | bytes) or len(row) not in (2, 3):
        refuse("graph: an edge", edge, "(i, j) or (i, j, weight) with indices of robots")
    i, j, weight = (*row, 1.0)[:3]
    if not all(is_whole(k) or real(k).is_integer() for k in (i, j)):
        refuse("graph: an edge", edge, "(i, j) or (i, j, weight) with whole indices of robots")
    if not SMALLEST <= real(weight) <= LARGEST:
        raise ValueError(
            f"graph: edge ({int(i)}, {int(j)}) has weight {shown(weight)}; it must be positive and "
            f"finite, from {SMALLEST:g} to {LARGEST:g} m/s"
        )
    return int(i), int(j), real(weight)


def ordered_edges(edges: Any, n: int) -> tuple[tuple[int, int, float], ...]:
    """Edges (i, j, a_ij) with i < j, sorted.

    Raises:
        ValueError: for a loop, a repeated edge or an index out of range.
    """
    listed = map(as_edge, listed_edges(edges))
    return _sorted_once([(min(i, j), max(i, j), i, j, weight) for i, j, weight in listed], n)


def ordered_arcs(arcs: Any, n: int) -> tuple[tuple[int, int, float], ...]:
    """Arcs (i, j, a_ij), robot i sees robot j, sorted.

    Raises:
        ValueError: for a loop, a repeated arc or an index out of range.
    """
    listed = map(as_edge, listed_edges(arcs))
    return _sorted_once([(i, j, i, j, weight) for i, j, weight in listed], n)


def _sorted_once(
    named: list[tuple[int, int, int, int, float]], n: int
) -> tuple[tuple[int, int, float], ...]:
    """Edges by the pair that names them; each is also given as it was written."""
    ordered: dict[tuple[int, int], float] = {}
    for low, high, i, j, weight in named:
        if i == j or (low, high) in ordered or not (0 <= low < n and 0 <= high < n):
            raise ValueError(
                f"graph: edge ({i}, {j}) must join two different robots of 0..{n - 1}, once"
            )
        ordered[low, high] = weight
    return tuple((i, j, weight) for (i, j), weight in sorted(ordered.items()))


def check_weights(
    weights: NDArray[np.float64],
    n: int | None = None,
    field: str = "graph",
    *,
    directed: bool = False,
) -> None:
    """Refuse a matrix that is no set of sensing weights.

    Args:
        weights: to be (n, n), symmetric, non-negative, finite, zero on the diagonal.
        n: number of robots, if known.
        field: what the message calls the matrix.
        directed: whether it need not be symmetric.

    Raises:
        ValueError: naming the shape or the first entry that is wrong.
    """
    size = n if n is not None else (weights.shape[0] if weights.ndim else 0)
    if weights.shape != (size, size):
        raise ValueError(
            f"{field}: weights have shape {weights.shape}; they must be ({size}, {size})"
        )
    reasons = (
        (~np.isfinite(weights), "must be finite"),
        (weights < 0, "must not be negative"),
        (
            (weights != 0) & ((weights < SMALLEST) | (weights > LARGEST)),
            f"must be 0, or from {SMALLEST:g} to {LARGEST:g} m/s",
        ),
        (np.diag(np.diag(weights) != 0), "must be 0: no robot is its own neighbour"),
        (
            (weights != weights.T) & (not directed),
            "must equal its mirror image: the graph is undirected (a_ij = a_ji); graphs.directed "
            "takes others",
        ),
    )
    for wrong, reason in reasons:
        if np.any(wrong):
            i, j = (int(k) for k in np.argwhere(wrong)[0])
            raise ValueError(f"{field}: weight a[{i}, {j}] = {weights[i, j]} {reason}")
