"""The numbers of a scenario that theorems share: of its graph, its first step, its worst start."""

import itertools
import math
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...checks import floats, refuse
from ...graphs import Graph
from ...physics.hull_perimeter import size
from ...scenario.scenario import Scenario
from ..lyapunov import lyapunov
from ..settings import has_one_weight, is_complete, levels_follow_v

Array = NDArray[np.float64]

UNDIRECTED, DIRECTED, SWITCHING, PROXIMITY = "undirected", "directed", "switching", "proximity"
"""Links that last but for merges, mutual or one-way; that take turns; that end with distance."""
_of_the_last = lru_cache(maxsize=8)
"""Several theorems ask the same of a scenario, one after the other."""


def kind_of_links(graph: Graph) -> str:
    """UNDIRECTED, DIRECTED, SWITCHING or PROXIMITY."""
    if graph.undirected or not graph.changes:
        return UNDIRECTED if graph.undirected else DIRECTED
    return PROXIMITY if graph.kind == "proximity" else SWITCHING


def leaders(scenario: Scenario) -> list[list[int]]:
    """Groups of robots that see nobody outside, arrays of indices without unit, in the graph of the
    moment that has most. One group: some robot can be reached from all at any time (theorem G).
    """
    graph: Any = scenario.sensing_graph
    kind = kind_of_links(graph)
    if kind in (UNDIRECTED, PROXIMITY):
        return graph.components(scenario.n_robots)
    moments = graph.graphs if kind == SWITCHING else (graph,)
    groups = [moment.closed_groups(scenario.n_robots) for moment in moments]
    return max(groups, key=lambda found: (len(found), -len(found[0])))


def led(scenario: Scenario) -> bool:
    """Whether a robot may rest and see nobody: one group of leaders, and not all (theorem G)."""
    return len(leaders(scenario)[0]) < scenario.n_robots


def lightest_link(scenario: Scenario) -> float:
    """The least weight of a link, a number, m/s; a merge keeps the heavier of two (theory 5)."""
    return scenario.sensing_graph.extreme_weights(scenario.n_robots)[0]


def robots_left(scenario: Scenario) -> Array:
    """Robots left, an array (n − 1,) without unit, 2 ≤ m ≤ n: c_m and D̄_m stand in its order."""
    return np.arange(2.0, scenario.n_robots + 1.0)


def least_degrees(scenario: Scenario) -> Array:
    """c_m, the least D_i = Σ_j a_ij that a robot can have, an array (n − 1,), m/s: a complete graph
    stays complete and a cycle a cycle; elsewhere one link is sure, of at least a* (theory 3).
    """
    others = robots_left(scenario) - 1.0
    sure = np.inf if is_complete(scenario) else 1.0 + _is_cycle(scenario)
    links = np.minimum(others, sure)
    return np.maximum(links * lightest_link(scenario), scenario.bottleneck_weight)


def most_neighbours(scenario: Scenario) -> int:
    """How many neighbours a robot can come to have, at most: k robots of a fixed graph that have
    merged were joined by k − 1 links or more, which no neighbour is left of.

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


def most_degrees(scenario: Scenario) -> Array:
    """The most that D_i can be: min(D̄, (m − 1) max a_ij), an array (n − 1,), m/s (theory 3)."""
    heaviest = scenario.sensing_graph.extreme_weights(scenario.n_robots)[1]
    return np.minimum(scenario.max_degree, (robots_left(scenario) - 1.0) * heaviest)


def least_bearing_square(scenario: Scenario) -> float:
    """min_m 4 c_m²/m ≤ Σ‖f_i‖² at any time before all have met, a number, (m/s)² (lemma 2)."""
    return float((4.0 * least_degrees(scenario) ** 2 / robots_left(scenario)).min())


def degrees_stay_equal(scenario: Scenario) -> bool:
    """Whether all robots left always have one D_i: complete graphs, cycles, of one weight."""
    directed = scenario.sensing_graph.kind == "directed_cycle"
    even = directed or is_complete(scenario) or _is_cycle(scenario)
    return even and has_one_weight(scenario)


def merges_at_midpoints(scenario: Scenario) -> bool:
    """Whether V/(m − 1) never rises at a merge: complete graphs of one weight, no obstacles, starts
    apart (docs/proofs.md, A to C).
    """
    even = is_complete(scenario) and has_one_weight(scenario)
    return even and not scenario.obstacles and starts_apart(scenario)


def _is_cycle(scenario: Scenario) -> bool:
    """Whether everyone has two neighbours; the graph is taken to be connected."""
    graph, n = scenario.sensing_graph, scenario.n_robots
    if not graph.fixed or graph.directed or graph.most_links(n) != n:
        return False
    first, second, _ = graph.links(n)
    return bool((np.bincount(np.concatenate([first, second]), minlength=n) == 2).all())


def long_step(scenario: Scenario) -> bool:
    """Whether τ is longer than the certified r/(2D̄) (theory 4)."""
    return scenario.tau > scenario.certified_step * (1 + 1e-12)


def scale_bound(scenario: Scenario) -> float:
    """s_min = min(1, r/(2D̄τ), v_max/D̄), a number without unit, by which robots slow down."""
    held = scenario.merge_radius / (2.0 * scenario.max_degree * scenario.tau)
    return min(1.0, held, scenario.speed_limit / scenario.max_degree)


def merge_rise_allowance(scenario: Scenario) -> float:
    """(n − 1) r W, a number, m²/s, W = Σ a_ij over the edges: merges raise V by no more."""
    total = scenario.sensing_graph.weight_sum(scenario.n_robots)
    return (scenario.n_robots - 1) * scenario.merge_radius * total


def lyapunov_bound(
    scenario: Scenario, initial_lyapunov: ArrayLike | None = None, *, reach: float | None = None
) -> Array:
    """V0⁺ = V(0) + (n − 1) r W, (...), m²/s: the most that V can be if it never rises between
    merges (theory 5), V(0) ``largest_lyapunov`` if None; twice the rise at obstacles.

    Where linked robots start within r of each other, two of them merge at once while others walk
    on, by r/2 or ``reach``, m: V rises by 4 W of it at most, once.
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
    """A pair: the most that V with all tanks can be, V0⁺ + (n−1) r W + ΣB_i, m²/s; and where levels
    follow V, as those of tanks that observe merges do on complete graphs of one weight, what it is
    m − 1 times of at most while m are left, (V(0) + ΣB_i)/(n−1) + (n−1) r a; else None (theorem D).
    """
    n, reach, each = scenario.n_robots, scenario.speed_limit * scenario.tau, None
    most = float(lyapunov_bound(scenario, reach=reach)) + merge_rise_allowance(scenario)
    if observes_merges and levels_follow_v(scenario) and merges_at_midpoints(scenario):
        each = (largest_lyapunov(scenario) + n * budget) / (n - 1)
        each += (n - 1) * scenario.merge_radius * scenario.bottleneck_weight
    return most + n * budget, each


@_of_the_last
def largest_lyapunov(scenario: Scenario) -> float:
    """V(0) of the given start, or V ≤ 2 W s √d for a spawn area of side s, a number, m²/s."""
    n, graph = scenario.n_robots, scenario.sensing_graph
    if scenario.start_positions is not None:
        weights = graph.base_weights(n) * graph.weight_range[1]
        return float(lyapunov(np.array(scenario.start_positions), weights))
    return 2.0 * graph.weight_sum(n) * scenario.spawn_size * math.sqrt(scenario.dim)


@_of_the_last
def starts_apart(scenario: Scenario) -> bool:
    """Whether linked robots start r or more apart, as all that are drawn do (theory 5)."""
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
    """L(0) of the given start, or of the worst one in the spawn area, a number, m (guarantees,
    section 9): L = s L(unit cube), s the side of the spawn area, with all robots at corners.
    """
    if scenario.start_positions is not None:
        return size(np.array(scenario.start_positions))
    return scenario.spawn_size * _largest_size_in_unit_cube(scenario.n_robots, scenario.dim)


@cache
def _largest_size_in_unit_cube(n: int, dim: int) -> float:
    # L is convex in every p_i, and no set of corners is larger than the sets that hold it
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=dim)))
    sets = itertools.combinations(corners, min(n, len(corners)))
    return max(size(np.array(places)) for places in sets)


def hull_growth(scenario: Scenario) -> float:
    """What L can grow by, a number, m, in steps that begin with linked robots closer than r: by r
    all round, once for a given start, n − 1 times where links change (theorem D1).
    """
    grown = 2.0 * math.pi * (scenario.dim - 1) * scenario.merge_radius
    if kind_of_links(scenario.sensing_graph) in (SWITCHING, PROXIMITY):
        return (scenario.n_robots - 1) * grown
    return 0.0 if starts_apart(scenario) else grown


def checked(name: str, given: ArrayLike, unit: str) -> Array:
    """V(0) ≥ 0, m²/s, or L(0) ≥ 0, m, as an array (...) of numbers; others in a ValueError."""
    initial = floats(name, given)
    if not (np.isfinite(initial) & (initial >= 0)).all():
        refuse(name, given, f"finite and at least 0 {unit}")
    return initial


def over_rate(above: ArrayLike, rate: ArrayLike) -> Array:
    """above/rate, (...), s: when something has vanished; infinite for a rate ≤ 0 (theorem A)."""
    below = np.asarray(rate, dtype=np.float64)
    with np.errstate(divide="ignore", over="ignore"):
        return np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), np.inf)


def held_time(scenario: Scenario, most: ArrayLike, rates: ArrayLike) -> Array:
    """T ≤ most/min_m rate_m + (n − 1) τ, (...), s: what falls by a rate (n − 1,) in every step
    without a merge has vanished (theorems A, D, G). ``most`` is of V, m²/s, or of L, m.
    """
    return over_rate(most, np.min(rates)) + (scenario.n_robots - 1) * scenario.tau
