"""What theorem G promises of the hull of a team, N of wrong bearings, and R of its links."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..experiment.scenario import Scenario
from . import error_bounds, even_bounds
from .bounds import lyapunov_bound, walled
from .gains import gain_range
from .graph_bounds import sighted_lyapunov_bound
from .kinds_of_links import PROXIMITY, kind_of_links, leaders
from .promise import Asked, Certificate
from .size_bounds import gain_bound
from .worst_starts import largest_lyapunov, largest_size


def of_law_on_any_graph(scenario: Scenario, without: Certificate, asked: Asked) -> Certificate:
    """Law (1) on directed and switching graphs, or on whom other robots do not hide: gains a_ij, in
    all a* or more (theorem G).
    """
    most = min(scenario.max_degree, scenario.speed_limit)
    if most * scenario.tau > scenario.merge_radius * (1 + 1e-12):
        words = (
            f"none for law (1) as it stands: in a step of {scenario.tau:.4g} s a robot may go "
            "beyond its neighbours; gains do not"
        )
        return replace(without, theorem=words)
    even = even_bounds.evenly_moved(scenario) and scenario.sensing.occlusion == "none"
    gain = scenario.bottleneck_weight
    return _of_hull(scenario, without, asked, gain, "law (1)", even=even)


def of_gains(scenario: Scenario, without: Certificate, asked: Asked) -> Certificate:
    """Any gains that are not negative and add up to ``min_gain`` or more (theorem G)."""
    least, most = gain_range(scenario, asked.min_gain, asked.max_gain)
    even = least == most <= scenario.speed_limit
    return _of_hull(
        scenario, without, asked, least, "every policy that weighs neighbours", even=even
    )


def _of_hull(
    scenario: Scenario, without: Certificate, asked: Asked, gain: float, who: str, *, even: bool
) -> Certificate:
    """Theorem G with gains of c or more, and N if all of them add up to c at any time."""
    if walled(scenario):
        words = (
            "none: obstacles can hold a robot back for ever (theory 6); nothing is proven of gains "
            "beside them"
        )
        return replace(without, theorem=words)
    led = len(leaders(scenario)[0]) < scenario.n_robots
    even = even and not led
    extent, error = largest_size(scenario), asked.error
    borne = even_bounds.even_error_borne(scenario, gain) if even else 0.0
    found = replace(without, bearing_error_borne=borne)
    held = math.inf
    if even:
        held = float(even_bounds.even_time_bound(scenario, extent, error, gain=gain))
    if error > 0 and math.isinf(held):
        why = (
            f"they are known to bear less than {borne:.4g} rad here"
            if even
            else "theorem N needs gains that add up to the same for all robots, all of whom see one"
        )
        return replace(found, theorem=f"none: bearings may err by {error:.4g} rad; {why}")
    if error > 0:
        words = f"theorem N: {who} meets in finite time although bearings err by {error:.4g} rad"
        return replace(found, guaranteed=True, theorem=words, time_bound=held, held_time_bound=held)
    known = f"; for inputs held over the step it is {held:.4g} s" if held < math.inf else ""
    words = (
        f"theorem G: {who} meets in finite time, and the hull never grows; this bound is proven in "
        f"continuous time{known}"
    )
    return replace(
        found,
        guaranteed=True,
        theorem=words,
        time_bound=float(gain_bound(scenario, extent, gain, led=led)),
        continuous_time=True,
        held_time_bound=held,
    )


def of_links(scenario: Scenario, without: Certificate, asked: Asked) -> Certificate:
    """Any motion, projected so that no link grows longer (theorem R c and d)."""
    if walled(scenario):
        words = "none: obstacles turn robots aside, and links beside them may grow longer"
        return replace(without, theorem=words)
    reach = scenario.sensing.range
    if not _starts_linked(scenario, reach):
        words = (
            "none: theorem R needs starts that links of at most range − (n − 1) r/2 connect; here "
            "others are given or may be drawn"
        )
        return replace(without, theorem=words)
    most, weight = _largest_sum(scenario, reach), _least_weight(scenario)
    borne = error_bounds.link_error_borne(scenario)
    bound = error_bounds.link_time_bound(scenario, most, weight, asked.share, asked.error)
    found = replace(without, bearing_error_borne=borne, lyapunov_bound=most)
    if reach is not None and kind_of_links(scenario.sensing_graph) != PROXIMITY:
        found = replace(found, lyapunov_bound=math.inf)  # V counts neighbours out of sight too
    if math.isinf(bound):
        words = (
            f"none: bearings may err by {asked.error:.4g} rad, and theorem R bears less than "
            f"π/(2n) = {borne:.4g} rad; no link grows longer even so"
        )
        return replace(found, theorem=words)
    words = (
        "theorem R: whatever is wanted, no link grows longer, and all robots meet in finite time"
    )
    return replace(found, guaranteed=True, theorem=words, time_bound=bound, held_time_bound=bound)


def _starts_linked(scenario: Scenario, reach: float | None) -> bool:
    """Whether every start is connected by links that no n − 1 merges make longer than the range."""
    graph, n = scenario.sensing_graph, scenario.n_robots
    if reach is None:
        return True
    longest = reach - (n - 1) * scenario.merge_radius / 2.0
    if scenario.start_positions is None:
        drawn = kind_of_links(graph) == PROXIMITY and scenario.require_connected
        return drawn or scenario.spawn_size * math.sqrt(scenario.dim) <= longest
    from scipy.sparse.csgraph import connected_components

    p = np.array(scenario.start_positions)
    near = np.linalg.norm(p[:, None] - p, axis=-1) <= longest
    return int(connected_components(near & (graph.base_weights(n) > 0))[0]) == 1


def _largest_sum(scenario: Scenario, reach: float | None) -> float:
    """V_tot, m²/s: V of the links there are, and of all that can come into sight or be merged in.

    V0⁺ without a limit of range; else as if all links were still to appear, each with the heaviest
    weight a, since V(0) is no more than 2aR for each.
    """
    if reach is None:
        return float(lyapunov_bound(scenario, largest_lyapunov(scenario)))
    n, graph = scenario.n_robots, scenario.sensing_graph
    heaviest = float(graph.links(n)[2].max()) * graph.weight_range[1]
    most = sighted_lyapunov_bound(
        n, 0.0, links=0, weight=heaviest, sight=reach, merge_radius=scenario.merge_radius
    )
    return float(most)


def _least_weight(scenario: Scenario) -> float:
    """d_min, m/s: no robot that sees someone has less; a* where all neighbours are seen."""
    graph = scenario.sensing_graph
    if scenario.sensing.range is None:
        return scenario.bottleneck_weight
    return float(graph.links(scenario.n_robots)[2].min()) * graph.weight_range[0]
