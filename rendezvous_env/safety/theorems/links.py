"""Theorem R: connectivity maintenance with limited sensing range.

**Assumptions.** Visibility is mutual up to a range R, on an undirected or proximity graph. Single
integrators, bearing errors at most η, no walls. Links of length at most R − (n−1) r/2 connect the
initial positions (R − (n−1) r with obstacles that robots pass through); linked robots start at
least r apart.

    v_i = λ s_i sin(asin‖q̂_i‖ − η)₊ q̂_i/‖q̂_i‖ + (1−λ) P(wanted),      s_i = min(d_i, r/(2τ), v_max)

**Promise.** No visible link grows in a step without a merge. Links of initial length at most
R − (n−1) r/2 never grow by more than (n−1) r/2 (with obstacles: R − (n−1) r and (n−1) r). For
η < π/(2n)

    T ≤ n V_tot/(4 λ d s (1 − 2nη/π)²) + (n−1) τ,      s = min(d, r/2τ, v_max),
    V_tot = 2aR [n(n−1)/2 + (n−1)²] + (n−1) r a n(n−1)/2,

a the maximum and d the minimum weight; without a range V_tot = V0⁺, d = min_m c_m.
Proof: docs/proofs.md, R.
"""

import math

import numpy as np

from ...graphs.weights import components
from ...scenario.scenario import Scenario
from ..links import asymmetric_sight
from . import assumptions as given
from . import constants as known
from .theorem import Asked, Theorem, TheoremBounds, bounds_with_errors


def visibility_is_mutual(scenario: Scenario, asked: Asked) -> str:
    """Visibility within range is mutual."""
    reason = asymmetric_sight(scenario)
    return f"none: {reason}" if reason else ""


def neighbours_apart(scenario: Scenario, asked: Asked) -> str:
    """Linked robots start at least r apart."""
    if known.starts_apart(scenario):
        return ""
    return (
        "none: linked robots start closer than r: two of them merge at once while others move "
        "on, and theorem R is for links of r or more"
    )


def starts_linked(scenario: Scenario, asked: Asked) -> str:
    """Every initial graph is connected by links that stay within range after n − 1 merges."""
    if scenario.sensing.range is None:
        return ""
    n, graph = scenario.n_robots, scenario.sensing_graph
    longest = scenario.sensing.smallest("range") - merge_growth(scenario)
    if scenario.start_positions is not None:
        from scipy.sparse import coo_array

        p, (first, second, weights) = np.array(scenario.start_positions), graph.links(n)
        near = np.linalg.norm(p[first] - p[second], axis=-1) <= longest
        links = coo_array((weights[near], (first[near], second[near])), shape=(n, n))
        lasts = graph.fixed or known.kind_of_links(graph) == known.PROXIMITY
        linked = len(components(links)) == 1 if lasts else bool(near.all())  # any may be sampled
    else:
        # sampled initial conditions are connected for merges at midpoints
        near = known.kind_of_links(graph) == known.PROXIMITY
        linked = near and scenario.require_connected and not scenario.obstacles
        linked = linked or scenario.spawn_diagonal <= longest
    if linked:
        return ""
    return (
        "none: theorem R needs initial conditions connected by links of at most range − (n − 1) "
        "r/2, or range − (n − 1) r with obstacles; here others are given or may be sampled"
    )


def merge_growth(scenario: Scenario) -> float:
    """Growth of a link at merges, (n − 1) r/2, m (theorem R).

    Merges at midpoints lengthen a link by r/2; those at a robot's position, in obstacles, by r.
    """
    return (scenario.n_robots - 1) * scenario.merge_radius * (1.0 if scenario.obstacles else 0.5)


def bounds(scenario: Scenario, asked: Asked) -> TheoremBounds:
    """Bounds on the time, on V for permanent links, and on links."""
    n, radius = scenario.n_robots, scenario.merge_radius
    unlimited = scenario.sensing.range is None
    if unlimited:
        most = float(known.lyapunov_bound(scenario))
        degrees = known.min_degrees(scenario)
    else:
        heaviest, pairs = scenario.sensing_graph.extreme_weights(n)[1], n * (n - 1) / 2.0
        merges = radius * (2.0 if scenario.obstacles else 1.0)
        most = 2.0 * heaviest * scenario.sensing.smallest("range") * (pairs + (n - 1) ** 2)
        most += (n - 1) * merges * heaviest * pairs
        degrees = np.full(n - 1, known.lightest_link(scenario))
    speeds = np.minimum(degrees, min(scenario.min_speed_limit, radius / (2.0 * scenario.tau)))
    left = known.robots_left(scenario)
    sure = np.maximum(1.0 - 2.0 * left * asked.error / np.pi, 0.0)
    rates = 4.0 * asked.share * degrees * speeds * sure**2 / left
    counted = unlimited or known.kind_of_links(scenario.sensing_graph) == known.PROXIMITY
    time, tolerated = known.held_time(scenario, most, rates), math.pi / (2.0 * n)
    if lost := given.errors_outlasted(scenario, asked, tolerated):
        return TheoremBounds(lost, tolerated_bearing_error=tolerated)
    words = (
        "theorem R: for any desired velocities, no visible link grows between merges, and all "
        "robots meet in finite time"
    )
    even_so = "; no visible link grows between merges even so"
    kept = {"lyapunov": most if counted else math.inf, "link_growth": merge_growth(scenario)}
    return bounds_with_errors(asked, time, tolerated, words, "theorem R", even_so, **kept)


_SIGHT = visibility_is_mutual, given.no_obstacles, starts_linked, neighbours_apart
_TEAM = given.connected, given.velocity_inputs, given.bounded_errors, *given.IN_STEPS
_GRAPHS = given.on_graphs(known.UNDIRECTED, known.PROXIMITY)
THEOREMS = (Theorem("R", ("links",), (_GRAPHS, *_TEAM, *_SIGHT), bounds, every_step="links"),)
