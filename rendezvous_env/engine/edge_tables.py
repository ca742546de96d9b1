"""Links of B environments for NumPy: allocation, matrices, and storage conversion."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..graphs.edges import ARCS, DENSE, LISTED, Changes, Links
from ..graphs.proximity import ProximityGraph
from ..scenario.scenario import Scenario
from .memory_layout import MemoryLayout, aligned

LinkList = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]
"""Links of an environment: robots (E,), (E,), weights (E,), m/s.

For arcs, the first robot observes the second."""


def empty_links(place: MemoryLayout) -> Links:
    """Links before the first reset: weights 0 for all pairs, or an empty list."""
    n, batch = place.scenario.n_robots, place.batch
    if place.one_way:
        none = np.zeros((1, 0), np.int64)
        return Links(ARCS, none, none, np.zeros((batch, n * n, 1)))
    if place.sparse:
        first, second = (np.zeros((batch, place.n_links), np.int64) for _ in range(2))
        return Links(LISTED, first, second, np.zeros((batch, place.n_links, 1)))
    first, second = (pairs.astype(np.int64)[None] for pairs in np.triu_indices(n, 1))
    return Links(DENSE, first, second, aligned(place.blocks, place.n_links, place.lanes))


def changes_of(scenario: Scenario) -> Changes | None:
    """Time dependence of a scenario's arcs; None if only merges change them."""
    graph, sensing, n = scenario.sensing_graph, scenario.sensing, scenario.n_robots
    if not graph.changes:
        return None
    listed = getattr(graph, "graphs", (graph,))
    return Changes(
        bases=np.array([one.base_weights(n) for one in listed]),
        lows=np.array([one.weight_range[0] for one in listed]),
        highs=np.array([one.weight_range[1] for one in listed]),
        dwell=float(getattr(graph, "dwell", math.inf)),
        at_random=getattr(graph, "order", "cyclic") == "random",
        by_sight=isinstance(graph, ProximityGraph),
        reach=sensing.smallest("range"),
        half_field=0.5 * sensing.smallest("field_of_view"),
    )


def state_arrays(links: Links, n: int) -> dict[str, NDArray[Any]]:
    """Link arrays that belong to the state, with names and shapes of ``State``."""
    if links.form == DENSE:
        return {"weights": links.weights}
    if links.form == ARCS:
        return {"weights": links.weights.reshape(-1, n, n)}
    return {"first": links.first, "second": links.second, "weights": links.weights[..., 0]}


def matrices(links: Links, batch: int, n: int) -> NDArray[np.float64]:
    """Weights a_ij, (B, n, n), m/s."""
    if links.form == ARCS:
        return links.weights.reshape(batch, n, n).copy()
    weights = np.zeros((batch, n, n))
    if links.form == LISTED:
        kept = links.weights[..., 0]
        b, e = np.nonzero(kept > 0)
        first, second = links.first[b, e], links.second[b, e]
        weights[b, first, second] = weights[b, second, first] = kept[b, e]
    else:
        pairs = np.moveaxis(links.weights, -1, 1).reshape(-1, links.weights.shape[1])[:batch]
        weights[:, links.first[0], links.second[0]] = pairs
        weights[:, links.second[0], links.first[0]] = pairs
    return weights


def as_kept(links: Links, listed: Iterable[LinkList], n: int) -> dict[str, NDArray[Any]]:
    """Convert lists of links to the form of ``state_arrays``.

    The number of links is limited by the allocation. Each array has an axis for the lists.
    """
    listed = list(listed)
    if links.form == LISTED:
        names = zip(("first", "second", "weights"), (np.int64, np.int64, np.float64), strict=True)
        kept = {k: np.zeros((len(listed), links.first.shape[1]), kind) for k, kind in names}
        for k, one in enumerate(listed):
            for array, values in zip(kept.values(), one, strict=True):
                array[k, : len(values)] = values
        return kept
    weights = np.zeros((len(listed), n, n))
    for matrix, (first, second, weight) in zip(weights, listed, strict=True):
        matrix[first, second] = weight
    if links.form == ARCS:
        return {"weights": weights}
    return {"weights": weights[:, links.first[0], links.second[0]]}
