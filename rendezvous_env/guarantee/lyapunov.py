"""V, its rate, net bearings and alignment, of positions in the global frame.

Everything here sees positions: it is for analysis, never for a law.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..equations.potential import lyapunov_of_links, net_bearings_of_links
from ..experiment.checks import floats

Array = NDArray[np.float64]


def lyapunov(positions: ArrayLike, weights: ArrayLike) -> Array:
    """V = Σ_i Σ_j a_ij ‖p_i − p_j‖ (paper, section III), for any leading axes.

    Args:
        positions: (..., n, d), m.
        weights: (..., n, n), m/s; leading axes broadcast.

    Returns:
        (...), m²/s.
    """
    p, a = _teams(positions, weights)
    leading = p.shape[:-2]
    teams = zip(p.reshape(-1, *p.shape[-2:]), a.reshape(-1, *a.shape[-2:]), strict=True)
    values = [lyapunov_of_links(team, _links(team_weights)) for team, team_weights in teams]
    return np.array(values).reshape(leading)


def net_bearings(positions: ArrayLike, weights: ArrayLike) -> Array:
    """f_i = Σ_j a_ij g_ij of every robot in the global frame.

    Args:
        positions: (..., n, d), m; neighbours do not coincide.
        weights: (..., n, n), m/s; leading axes broadcast.

    Returns:
        (..., n, d), m/s.
    """
    p, a = _teams(positions, weights)
    out = np.empty(p.shape)
    flat = (array.reshape(-1, *array.shape[-2:]) for array in (p, a, out))
    for team, team_weights, f in zip(*flat, strict=True):
        net_bearings_of_links(team, _links(team_weights), f)
    return out


def lyapunov_rate(velocities: ArrayLike, net_bearing: ArrayLike) -> Array:
    """V̇ = −2 Σ_i f_iᵀ ṗ_i, which is −2 Σ (h_iᵀ f_i)² under law (4).

    Args:
        velocities: ṗ_i, (..., n, d), m/s.
        net_bearing: f_i, (..., n, d), m/s, in the same frame.

    Returns:
        (...), m²/s².
    """
    return np.asarray(
        -2.0 * np.sum(np.asarray(velocities) * np.asarray(net_bearing), axis=(-2, -1))
    )


def alignment(net_bearing: ArrayLike, headings: ArrayLike) -> Array:
    """Alignment |h_iᵀ f_i| / ‖f_i‖ of unit headings with the net bearing; NaN where f_i = 0.

    Args:
        net_bearing: f_i, (..., d), m/s.
        headings: h_i, (..., d), unit vectors in the same frame.

    Returns:
        (...), in [0, 1].
    """
    f, h = np.asarray(net_bearing, dtype=np.float64), np.asarray(headings, dtype=np.float64)
    length = np.linalg.norm(f, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.abs(np.sum(f * h, axis=-1)) / length)


<<<<<<< HEAD
def merge_rise_allowance(scenario: Scenario) -> float:
    """(n − 1) r W, m²/s: no sequence of merges can raise V by more (theory 3 and 5)."""
    n, total = scenario.n_robots, scenario.sensing_graph.weight_sum(scenario.n_robots)
    return (n - 1) * scenario.merge_radius * total


def time_bound(
    scenario: Scenario, initial_lyapunov: ArrayLike, *, min_alignment: float = 1.0
) -> Array:
    """Time by which all robots have met, s (theorems A and C with the factors of theory 4).

        A, law (1):              T ≤ n V0⁺ / (8 a*²)
        C, certified heading:    T ≤ n V0⁺ / (2 ε² a*²),      V0⁺ = V(0) + (n − 1) r W

    times 2·max(1, 2D̄τ/r) for the held inputs and max(1, D̄/v_max) for the speed limit.

    Args:
        scenario: gives n, r, W, a*, D̄, τ and v_max.
        initial_lyapunov: V(0), (...), m²/s.
        min_alignment: 1 for law (1), the margin ε < 1 for a certified heading.

    Returns:
        (...), s; infinite where nothing is guaranteed.

    Raises:
        ValueError: if ``min_alignment`` is not in (0, 1].
    """
    if not 0 < real(min_alignment) <= 1:
        raise ValueError(f"min_alignment is {shown(min_alignment)}; it must be in (0, 1]")
    _check_scenario(scenario)
    initial = floats("initial_lyapunov", initial_lyapunov)
    if not (np.isfinite(initial) & (initial >= 0)).all():
        refuse("initial_lyapunov", initial_lyapunov, "finite and at least 0 m²/s")
    if not covered(scenario):
        return np.full(initial.shape, np.inf)
    n, a = scenario.n_robots, scenario.bottleneck_weight
    divisor = 8.0 if min_alignment == 1 else 2.0 * min_alignment**2
    held = 2.0 * max(1.0, 2.0 * scenario.max_degree * scenario.tau / scenario.merge_radius)
    limited = max(1.0, scenario.max_degree / scenario.speed_limit)
    bound = n * (initial + merge_rise_allowance(scenario)) / (divisor * a**2)
    return np.asarray(bound * held * limited)


def covered(scenario: Scenario) -> bool:
    """Whether theorems A and C bound the time: connected, robots whose action is their velocity,
    nothing in the way.
    """
    in_the_way = bool(scenario.obstacles) and scenario.obstacle_contact != "ignore"
    return _connected(scenario) and scenario.model.bounded and not in_the_way


def smallest_enclosing_ball(points: ArrayLike) -> tuple[Array, float]:
    """Centre (d,) and radius of the smallest ball that holds all points (N, d), N ≥ 1.

    Welzl's algorithm with move-to-front, on at most d + 1 points at a time.

    Raises:
        ValueError: if there is no point or one is not finite.
    """
    p = floats("points", points)
    if p.ndim != 2 or p.size == 0 or not (np.abs(p) <= LARGEST).all():
        raise ValueError(
            f"points have shape {p.shape}; they must be finite, within {LARGEST:g} m, and (N, d) "
            "with N >= 1"
        )
    centre, square = _enclose(p, len(p), [])
    return centre, math.sqrt(square)


def rendezvous_time_lower_bound(scenario: Scenario, positions: ArrayLike) -> float:
    """No policy meets sooner: T ≥ (R − (n − 1) r/2)/v_max, s; (n − 1) r with obstacles (theory 3).

    Args:
        scenario: gives n, r and v_max.
        positions: start, (n, d), m.
    """
    _, radius = smallest_enclosing_ball(positions)
    share = 1.0 if scenario.obstacles else 0.5
    reach = (scenario.n_robots - 1) * scenario.merge_radius * share
    return max(0.0, radius - reach) / scenario.speed_limit


@dataclass(frozen=True)
class Certificate:
    """What is guaranteed for a scenario, and why or why not."""

    margin: float
    """ε: the least alignment |hᵀf|/‖f‖ that the guarantee builds on; 1 for law (1)."""
    dead_zone: float
    """δ = a*/(2n), m/s."""
    certified_step: float
    """r/(2D̄), s."""
    bottleneck_weight: float
    """a*, m/s."""
    time_bound: float
    """Time in s by which all robots have met from any start in the spawn area; inf without a
    bound."""
    guaranteed: bool
    """Whether rendezvous is guaranteed."""
    theorem: str
    """Which theorem covers the scenario, or why none does."""


def certificate(scenario: Scenario, min_alignment: float = 1.0) -> Certificate:
    """What is guaranteed for a scenario under law (1), or under certified headings.

    Args:
        scenario: the experiment.
        min_alignment: 1 for the paper's own laws, ε in (0, 1) for certified headings of that
            margin.

    Raises:
        ValueError: if ``min_alignment`` is not in (0, 1].
    """
    _check_scenario(scenario)
    bound = float(time_bound(scenario, _largest_lyapunov(scenario), min_alignment=min_alignment))
    guaranteed, theorem = _which_theorem(scenario, min_alignment)
    return Certificate(
        margin=min_alignment,
        dead_zone=scenario.dead_zone,
        certified_step=scenario.certified_step,
        bottleneck_weight=scenario.bottleneck_weight,
        time_bound=bound if guaranteed else math.inf,
        guaranteed=guaranteed,
        theorem=theorem,
    )


def _which_theorem(scenario: Scenario, min_alignment: float) -> tuple[bool, str]:
    long_step = scenario.tau > scenario.certified_step * (1 + 1e-12)
    if not _connected(scenario):
        return (
            False,
            "none: the graph is not connected, one robot per component remains (theorem 1)",
        )
    model = scenario.model
    if not model.bounded and model.theorem is None:
        return False, (
            f"none: no theorem covers {model.name} robots, whose action ({model.action}) is not "
            "their velocity; V may rise at any time"
        )
    if scenario.obstacles and scenario.obstacle_contact != "ignore":
        return False, (
            "none: obstacles can hold a robot back for ever (theory 6); with certified headings "
            "V still never rises between merges in a step without a contact"
        )
    if not model.bounded:
        return (
            True,
            f"{model.theorem} in continuous time (for free turn rates: the gate); no time bound",
        )
    if long_step and min_alignment == 1:
        return False, (
            f"none for law (1) as it stands: the step {scenario.tau:.4g} s is longer than the "
            f"certified {scenario.certified_step:.4g} s; certified headings scale the velocity "
            "and are covered"
        )
    if min_alignment == 1:
        return True, "theorems 1 and A: law (1) meets in finite time"
    scaled = " with velocities scaled to the long step" if long_step else ""
    return (
        True,
        f"theorems 2 and C: every policy under certified headings meets in finite time{scaled}",
    )


def _check_scenario(scenario: Any) -> None:
    if not isinstance(scenario, Scenario):
        refuse("scenario", scenario, "a Scenario; scenarios.resolve() takes names and files")


def _connected(scenario: Scenario) -> bool:
    return len(scenario.sensing_graph.components(scenario.n_robots)) == 1


def _largest_lyapunov(scenario: Scenario) -> float:
    """V(0) of the given start, or an upper bound over all starts that can be drawn."""
    n, graph = scenario.n_robots, scenario.sensing_graph
    if scenario.start_positions is not None:
        weights = graph.base_weights(n) * graph.weight_range[1]
        return float(lyapunov(np.array(scenario.start_positions), weights))
    return 2.0 * graph.weight_sum(n) * scenario.spawn_size * math.sqrt(scenario.dim)


=======
>>>>>>> main
def _links(weights: Array) -> tuple[Any, Any, Any]:
    """The links of a symmetric matrix of weights, in the order of their robots."""
    first, second = np.nonzero(np.triu(weights > 0, 1))
    return first, second, weights[first, second]


def _teams(positions: ArrayLike, weights: ArrayLike) -> tuple[Array, Array]:
    p, a = floats("positions", positions), floats("weights", weights)
    if p.ndim < 2 or a.shape[-2:] != (p.shape[-2],) * 2:
        raise ValueError(
            f"positions {p.shape} and weights {a.shape} must be (..., n, d) and (..., n, n)"
        )
    leading = np.broadcast_shapes(p.shape[:-2], a.shape[:-2])
    return (
        np.ascontiguousarray(np.broadcast_to(p, leading + p.shape[-2:])),
        np.ascontiguousarray(np.broadcast_to(a, leading + a.shape[-2:])),
    )
