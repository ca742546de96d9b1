"""How the links of B teams are kept: as pairs in lanes, as lists, or as matrices of arcs.

Stages choose by these types while they are compiled, so that the step of one kind has nothing of
the others in it.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import chosen_by_type


class DenseEdges(NamedTuple):
    """Links as a weight for each pair i < j of robots, 0 where there is none."""

    first: NDArray[np.int64]
    """(pairs,), i of every pair, for all teams."""
    second: NDArray[np.int64]
    """(pairs,), j."""
    weights: NDArray[np.float64]
    """(blocks, pairs, L), a_ij, m/s."""


class EdgeList(NamedTuple):
    """Links as a list for each team; only where a block holds one team."""

    first: NDArray[np.int64]
    """(B, E), the lower robot of each link, sorted."""
    second: NDArray[np.int64]
    """(B, E), the other robot."""
    weights: NDArray[np.float64]
    """(B, E), a_ij, m/s; 0 behind the last one."""


class Changes(NamedTuple):
    """How arcs follow the moment: a list of graphs that take turns, and what is in sight."""

    bases: NDArray[np.float64]
    """(G, n, n), a_ij of each graph before drawing, m/s."""
    lows: NDArray[np.float64]
    """(G,), each arc's weight is multiplied by a number from ``lows`` to ``highs``, drawn for every
    pair and episode."""
    highs: NDArray[np.float64]
    """(G,)."""
    dwell: float
    """How long a graph holds, s; inf for ever."""
    at_random: bool
    """Whether the next graph is drawn from the list rather than the next in it."""
    by_sight: bool
    """Whether arcs are there only to whom a robot sees."""
    reach: float
    """Range of sight, m."""
    half_field: float
    """Half the field of view, rad."""
    seeds: NDArray[np.uint64]
    """(B,), of the teams."""
    episodes: NDArray[np.int64]
    """(B,), their numbers."""


class DirectedEdges(NamedTuple):
    """Links that can be one-way, as a matrix for each team; only where a block holds one team.

    What takes links as pairs gets those that a_ij or a_ji joins, with the mean of the two: then
    V = 2 Σ ā_ij ‖p_i − p_j‖ over pairs is Σ_i Σ_j a_ij ‖p_i − p_j‖.
    """

    weights: NDArray[np.float64]
    """(B, n, n), a_ij, what robot i gives to robot j that it sees, m/s."""
    changes: Changes | None
    """None where only merges change them."""


Links = DenseEdges | EdgeList | DirectedEdges


def arcs_of(links: Any, team: int) -> Any:
    """DirectedEdges of one team, whose weights are (n, n); None of links that go both ways."""
    return DirectedEdges(links.weights[team], None) if isinstance(links, DirectedEdges) else None


@chosen_by_type(arcs_of)
def _compiled_arcs_of(links, team):
    if links.instance_class is DirectedEdges:
        return lambda links, team: DirectedEdges(links.weights[team], None)
    return lambda links, team: None
