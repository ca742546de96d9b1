"""V and L of the given start of a scenario, or the most that they can be in its spawn area."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np

from ..equations.size import size
from ..experiment.scenario import Scenario
from .lyapunov import lyapunov


def largest_lyapunov(scenario: Scenario) -> float:
    """V(0) of the given start, or an upper bound over all starts that can be drawn.

        V ≤ 2 W s √d,   s the side of the spawn area

    Args:
        scenario: gives the start, or s, d and the largest W = Σ a_ij over the edges.

    Returns:
        A number, m²/s.
    """
    n, graph = scenario.n_robots, scenario.sensing_graph
    if scenario.start_positions is not None:
        weights = graph.base_weights(n) * graph.weight_range[1]
        return float(lyapunov(np.array(scenario.start_positions), weights))
    return 2.0 * graph.weight_sum(n) * scenario.spawn_size * math.sqrt(scenario.dim)


def largest_size(scenario: Scenario) -> float:
    """L(0) of the given start, or of the worst one in the spawn area (guarantees, section 9).

    L = s L(unit cube), s the side of the spawn area, with all robots at corners.

    Args:
        scenario: gives the start, or n, d and s.

    Returns:
        A number, m.
    """
    if scenario.start_positions is not None:
        return size(np.array(scenario.start_positions))
    return scenario.spawn_size * _largest_size_in_unit_cube(scenario.n_robots, scenario.dim)


@cache
def _largest_size_in_unit_cube(n: int, dim: int) -> float:
    """L is convex in every p_i, so it is largest with all robots at corners, and no set of corners
    is larger than the sets that hold it.
    """
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=dim)))
    sets = itertools.combinations(corners, min(n, len(corners)))
    return max(size(np.array(places)) for places in sets)
