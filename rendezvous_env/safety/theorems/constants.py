"""Constants of a scenario shared by theorems: graph, time step, worst initial condition."""

import itertools
import math
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...checks import floats, raise_invalid
from ...graphs import Graph
from ...physics.hull_perimeter import size
from ...scenario.scenario import Scenario
from ..lyapunov import lyapunov
from ..settings import has_one_weight, is_complete, levels_follow_v

Array = NDArray[np.float64]

UNDIRECTED, DIRECTED, SWITCHING, PROXIMITY = "undirected", "directed", "switching", "proximity"
"""Kinds of links: permanent and mutual, permanent and directed, switching, by distance."""
_of_the_last = lru_cache(maxsize=8)
"""Cache of the last scenario, since several theorems use the same constants."""


def kind_of_links(graph: Graph) -> str:
    """UNDIRECTED, DIRECTED, SWITCHING or PROXIMITY."""
    if graph.undirected or not graph.changes:
        return UNDIRECTED if graph.undirected else DIRECTED
    return PROXIMITY if graph.kind == "proximity" else SWITCHING


def leaders(scenario: Scenario) -> list[list[int]]:
    """Closed groups of robots, arrays of indices without unit, for the graph with most groups.

    With one group, some robot is reachable from all others at any time (theorem G).
    """
    graph: Any = scenario.sensing_graph
    kind = kind_of_links(graph)
    if kind in (UNDIRECTED, PROXIMITY):
        return graph.components(scenario.n_robots)
    moments = graph.graphs if kind == SWITCHING else (graph,)
    groups = [moment.closed_groups(scenario.n_robots) for moment in moments]
    return max(groups, key=lambda found: (len(found), -len(found[0])))


def led(scenario: Scenario) -> bool:
    """True if there is a stationary root: one closed group that is not the team (theorem G)."""
    return len(leaders(scenario)[0]) < scenario.n_robots


def lightest_link(scenario: Scenario) -> float:
    """Minimum edge weight, m/s; a merge keeps the larger of two (theory 5)."""
    return scenario.sensing_graph.extreme_weights(scenario.n_robots)[0]


def robots_left(scenario: Scenario) -> Array:
    """Numbers of active robots 2 ≤ m ≤ n, an array (n − 1,) without unit: the order of c_m."""
    return np.arange(2.0, scenario.n_robots + 1.0)


def min_degrees(scenario: Scenario) -> Array:
    """Minimum degrees c_m ≤ D_i = Σ_j a_ij, an array (n − 1,), m/s.

    Complete graphs and cycles keep their structure; otherwise one link of weight a* (theory 3).
    """
    links = min_neighbours(scenario)
    return np.maximum(links * lightest_link(scenario), scenario.bottleneck_weight)


def min_neighbours(scenario: Scenario) -> Array:
    """Minimum numbers of neighbours, an array (n − 1,), without unit.

    All robots on complete graphs, two on cycles.
    """
    sure = np.inf if is_complete(scenario) else 1.0 + _is_cycle(scenario)
    return np.minimum(robots_left(scenario) - 1.0, sure)


def max_neighbours(scenario: Scenario) -> int:
    """Maximum number of neighbours of a robot, merges included, without unit.

    k merged robots of a fixed graph were joined by at least k − 1 links, so the maximum is

        max_k min(n − k, d_1 + … + d_k − 2 (k − 1)),      d_1 ≥ d_2 ≥ … the numbers of neighbours
    """
    n, graph = scenario.n_robots, scenario.sensing_graph
    most = graph.most_neighbours(n)
    if not graph.fixed or graph.directed or is_complete(scenario):
        return most
    first, second, _ = graph.links(n)
    counts = -np.sort(-np.bincount(np.concatenate([first, second]), minlength=n))[:-1]
    merged = np.arange(1, n)
    return min(most, int(np.minimum(n - merged, np.cumsum(counts) - 2 * (merged - 1)).max()))


def max_degrees(scenario: Scenario) -> Array:
    """Maximum degrees min(D̄, (m − 1) max a_ij), an array (n − 1,), m/s (theory 3)."""
    heaviest = scenario.sensing_graph.extreme_weights(scenario.n_robots)[1]
    return np.minimum(scenario.max_degree, (robots_left(scenario) - 1.0) * heaviest)


def min_bearing_square(scenario: Scenario) -> float:
    """min_m 4 c_m²/m ≤ Σ‖f_i‖² at any time before rendezvous, (m/s)² (lemma 2)."""
    return float((4.0 * min_degrees(scenario) ** 2 / robots_left(scenario)).min())


def degrees_stay_equal(scenario: Scenario) -> bool:
    """True if all active robots have equal D_i: complete graphs and cycles of equal weights."""
    directed = scenario.sensing_graph.kind == "directed_cycle"
    even = directed or is_complete(scenario) or _is_cycle(scenario)
    return even and has_one_weight(scenario)


def merges_at_midpoints(scenario: Scenario) -> bool:
    """True if V/(m − 1) never increases at a merge (docs/proofs.md, A to C).

    Complete graphs of equal weights without obstacles and with separated initial positions.
    """
    even = is_complete(scenario) and has_one_weight(scenario)
    return even and not scenario.obstacles and starts_apart(scenario)


def _is_cycle(scenario: Scenario) -> bool:
    """True if every robot of a connected graph has two neighbours."""
    graph, n = scenario.sensing_graph, scenario.n_robots
    if not graph.fixed or graph.directed or graph.most_links(n) != n:
        return False
    first, second, _ = graph.links(n)
    return bool((np.bincount(np.concatenate([first, second]), minlength=n) == 2).all())


def long_step(scenario: Scenario) -> bool:
    """True if τ is longer than the certified r/(2D̄) (theory 4)."""
    return scenario.tau > scenario.certified_step * (1 + 1e-12)


def scale_bound(scenario: Scenario) -> float:
    """Minimum velocity scaling s_min = min(1, r/(2D̄τ), v_max/D̄), without unit."""
    held = scenario.merge_radius / (2.0 * scenario.max_degree * scenario.tau)
    return min(1.0, held, scenario.min_speed_limit / scenario.max_degree)


def merge_rise_allowance(scenario: Scenario) -> float:
    """Maximum total increase of V at merges, (n − 1) r W, m²/s, W = Σ a_ij over the edges."""
    total = scenario.sensing_graph.weight_sum(scenario.n_robots)
    return (scenario.n_robots - 1) * scenario.merge_radius * total


def lyapunov_bound(
    scenario: Scenario, initial_lyapunov: ArrayLike | None = None, *, reach: float | None = None
) -> Array:
    """V0⁺ = V(0) + (n − 1) r W, (...), m²/s: bound on V if it never increases between merges.

    See theory 5. V(0) is ``largest_lyapunov`` if None. The increase is doubled with obstacles. If
    linked robots start within r, two of them merge at once while others move by r/2 or ``reach``,
    m. This raises V by at most 4 W times that length, once.
    """
    rises = (2.0 if scenario.obstacles else 1.0) * merge_rise_allowance(scenario)
    most = largest_lyapunov(scenario) if initial_lyapunov is None else initial_lyapunov
    most = np.asarray(most, dtype=np.float64) + rises
    if starts_apart(scenario):
        return most
    total = scenario.sensing_graph.weight_sum(scenario.n_robots)
    return most + 4.0 * total * (scenario.merge_radius / 2.0 if reach is None else reach)


def tank_bounds(
    scenario: Scenario, budget: float, observes_merges: bool = True
) -> tuple[float, float | None]:
    """Bounds on V plus the stored energies of all tanks, m²/s (theorem D).

    Returns:
        V0⁺ + (n−1) r W + ΣB_i, a bound at any time, and b = (V(0) + ΣB_i)/(n−1) + (n−1) r a. While
        m robots are left, the sum is at most (m−1) b. b is None unless stored energies follow V:
        tanks that observe merges, on complete graphs of one weight.
    """
    n, reach, each = scenario.n_robots, scenario.speed_limit * scenario.tau, None
    most = float(lyapunov_bound(scenario, reach=reach)) + merge_rise_allowance(scenario)
    if observes_merges and levels_follow_v(scenario) and merges_at_midpoints(scenario):
        each = (largest_lyapunov(scenario) + n * budget) / (n - 1)
        each += (n - 1) * scenario.merge_radius * scenario.bottleneck_weight
    return most + n * budget, each


@_of_the_last
def largest_lyapunov(scenario: Scenario) -> float:
    """V(0) of given initial conditions, or 2 W × the spawn diagonal, m²/s (theory 4)."""
    n, graph = scenario.n_robots, scenario.sensing_graph
    if scenario.start_positions is not None:
        weights = graph.base_weights(n) * graph.weight_range[1]
        return float(lyapunov(np.array(scenario.start_positions), weights))
    return 2.0 * graph.weight_sum(n) * scenario.spawn_diagonal


@_of_the_last
def starts_apart(scenario: Scenario) -> bool:
    """True if linked robots start at least r apart, as all sampled ones do (theory 5)."""
    if scenario.start_positions is None:
        return True
    from scipy.spatial import cKDTree

    places, r = np.array(scenario.start_positions), scenario.merge_radius
    if not (near := cKDTree(places).query_pairs(r * (1 - 1e-9))):
        return True
    first, second, _ = scenario.sensing_graph.links(scenario.n_robots)
    linked = {*zip(first.tolist(), second.tolist(), strict=True)}
    return linked.isdisjoint(near | {(j, i) for i, j in near})


@_of_the_last
def largest_size(scenario: Scenario) -> float:
    """L(0) of a given initial condition, or the maximum over the spawn area, m (guarantees 9).

    The maximum has all robots at corners of the spawn area.
    """
    if scenario.start_positions is not None:
        return size(np.array(scenario.start_positions))
    edges, scale = scenario.spawn_edges, scenario.spawn_size
    if not isinstance(scale, tuple):
        return scale * _largest_size_in_box(scenario.n_robots, (1.0,) * scenario.dim)
    return _largest_size_in_box(scenario.n_robots, edges)


@cache
def _largest_size_in_box(n: int, edges: tuple[float, ...]) -> float:
    # L is convex in every p_i, and increases with the set of corners
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=len(edges)))) * edges
    sets = itertools.combinations(corners, min(n, len(corners)))
    return max(size(np.array(places)) for places in sets)


def hull_growth(scenario: Scenario) -> float:
    """Maximum growth of L, m, in steps that begin with linked robots closer than r (theorem D1).

    It happens once for a given initial condition, n − 1 times if links change.
    """
    grown = 2.0 * math.pi * (scenario.dim - 1) * scenario.merge_radius
    if kind_of_links(scenario.sensing_graph) in (SWITCHING, PROXIMITY):
        return (scenario.n_robots - 1) * grown
    return 0.0 if starts_apart(scenario) else grown


def checked(name: str, given: ArrayLike, unit: str) -> Array:
    """Validated V(0) ≥ 0, m²/s, or L(0) ≥ 0, m, as an array (...)."""
    initial = floats(name, given)
    if not (np.isfinite(initial) & (initial >= 0)).all():
        raise_invalid(name, given, f"finite and at least 0 {unit}")
    return initial


def over_rate(above: ArrayLike, rate: ArrayLike) -> Array:
    """above/rate, (...), s: time until a quantity vanishes; infinite for a rate ≤ 0 (theorem A)."""
    below = np.asarray(rate, dtype=np.float64)
    with np.errstate(divide="ignore", over="ignore"):
        return np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), np.inf)


def held_time(scenario: Scenario, most: ArrayLike, rates: ArrayLike) -> Array:
    """T ≤ most/min_m rate_m + (n − 1) τ, (...), s (theorems A, D, G).

    Time until a quantity vanishes that decreases at rates (n − 1,) in every step without a merge.
    ``most`` is its maximum, of V, m²/s, or of L, m.
    """
    return over_rate(most, np.min(rates)) + (scenario.n_robots - 1) * scenario.tau
