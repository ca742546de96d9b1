"""Links of B teams as NumPy sees them: room for them, matrices, and the forms in which they are
kept and given.
"""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..graphs.edges import Changes, DenseEdges, DirectedEdges, EdgeList, Links
from ..graphs.proximity import ProximityGraph
from ..scenario.scenario import Scenario
from .memory_layout import MemoryLayout

LinkList = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]
"""Links of a team: robots (E,), (E,), weights (E,), m/s; of arcs who sees, and who is seen."""


def empty_links(
    place: MemoryLayout, seeds: NDArray[np.uint64], episodes: NDArray[np.int64]
) -> Links:
    """Links that no reset has touched yet: those of all pairs weigh 0, a list has none. Seeds and
    episodes, (B,), are those from which arcs that change are drawn.
    """
    n, size = place.scenario.n_robots, (place.batch, place.n_links)
    if place.one_way:
        changes = _changes_of(place.scenario, seeds, episodes)
        return DirectedEdges(np.zeros((place.batch, n, n)), changes)
    if place.sparse:
        return EdgeList(np.zeros(size, np.int64), np.zeros(size, np.int64), np.zeros(size))
    first, second = (pairs.astype(np.int64) for pairs in np.triu_indices(n, 1))
    return DenseEdges(first, second, np.zeros((place.blocks, place.n_links, place.lanes)))


def _changes_of(
    scenario: Scenario, seeds: NDArray[np.uint64], episodes: NDArray[np.int64]
) -> Changes | None:
    """How the arcs of a scenario follow the moment; None where only merges change them."""
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
        reach=math.inf if sensing.range is None else sensing.range,
        half_field=0.5 * sensing.field_of_view,
        seeds=seeds,
        episodes=episodes,
    )


def matrices(links: Links, batch: int, n: int) -> NDArray[np.float64]:
    """a_ij, (B, n, n), m/s."""
    if isinstance(links, DirectedEdges):
        return links.weights.copy()
    weights = np.zeros((batch, n, n))
    if isinstance(links, EdgeList):
        team, e = np.nonzero(links.weights > 0)
        first, second = links.first[team, e], links.second[team, e]
        weights[team, first, second] = weights[team, second, first] = links.weights[team, e]
    else:
        pairs = np.moveaxis(links.weights, -1, 1).reshape(-1, links.weights.shape[1])[:batch]
        weights[:, links.first, links.second] = pairs
        weights[:, links.second, links.first] = pairs
    return weights


def as_kept(links: Links, listed: Iterable[LinkList], n: int) -> dict[str, NDArray[Any]]:
    """Lists of links, at most as many as there is room for, in the form in which links of this kind
    are kept; each array with an axis for the lists.
    """
    listed = list(listed)
    if isinstance(links, EdgeList):
        kept = {k: np.zeros((len(listed), a.shape[1]), a.dtype) for k, a in links._asdict().items()}
        for k, one in enumerate(listed):
            for array, values in zip(kept.values(), one, strict=True):
                array[k, : len(values)] = values
        return kept
    weights = np.zeros((len(listed), n, n))
    for matrix, (first, second, weight) in zip(weights, listed, strict=True):
        matrix[first, second] = weight
    if isinstance(links, DirectedEdges):
        return {"weights": weights}
    return {"weights": weights[:, links.first, links.second]}
