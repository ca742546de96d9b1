"""Validation of settings shared by filters: minimum alignment ε, bearing errors η, vectors."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import floats, number, raise_invalid, to_float
from ..scenario.scenario import Scenario
from ..sensors.sensing import Sensing

SMALLEST_MARGIN = 1e-6
"""Smallest valid ε and λ: time bounds grow with 1/ε² and 1/λ, and rounding dominates."""
TANK_MARGIN = 0.05
"""Default ε of tanks."""
MAX_TURN_RATE = 3.0
"""Default maximum turn rate of headings and body axes under certified headings, rad/s."""


def check_share(name: str, value: Any) -> float:
    """Validate ε or λ, a number without unit, 10⁻⁶ ≤ ε ≤ 1 (theorems B and R c)."""
    if not SMALLEST_MARGIN <= (share := to_float(value)) <= 1:
        raise_invalid(name, value, f"in (0, 1], and at least {SMALLEST_MARGIN:g}")
    return share


def check_margin(min_alignment: Any) -> float:
    """Validate ε, a number without unit, 10⁻⁶ ≤ ε < 1 (theorems C and D)."""
    if not SMALLEST_MARGIN <= (margin := to_float(min_alignment)) < 1:
        raise_invalid(
            "min_alignment", min_alignment, f"at least {SMALLEST_MARGIN:g} and less than 1"
        )
    return margin


def check_gate_constants(min_alignment: float, dead_zone: float) -> None:
    """Validate the numbers ε and δ, 0 < δ < ∞, m/s (theorem C)."""
    check_margin(min_alignment)
    if not 0 < to_float(dead_zone) < math.inf:
        raise_invalid("dead_zone", dead_zone, "positive and finite (m/s)")


def check_vectors(
    name: str, value: ArrayLike, like: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Validate finite vectors (..., d), any unit, d = 2 or 3, in the shape of ``like``; float64."""
    vectors = floats(name, value)
    if like is not None and vectors.shape != like.shape:
        raise ValueError(f"{name} has shape {vectors.shape}; net_bearing has {like.shape}")
    if vectors.shape[-1:] not in ((2,), (3,)):
        raise ValueError(f"{name} has shape {vectors.shape}; it must be (..., 2) or (..., 3)")
    if not np.isfinite(vectors).all():
        wrong = vectors[~np.isfinite(vectors).all(axis=-1)][0]
        raise_invalid(name, wrong.tolist(), "finite")
    return np.ascontiguousarray(vectors)


def check_bearing_error(bearing_error: Any) -> float:
    """Validate η, a number, rad, 0 ≤ η ≤ π/2 (theorems N1' and R d)."""
    return number("bearing_error", bearing_error, 0.0, math.pi / 2.0, "rad")


def bounded_error(sensing: Sensing, dim: int) -> float:
    """Maximum bearing error of a team's sensors, a number, rad; unbounded for noise and bias.

    η = error + π/sectors ≤ π;   in 3-D √((π/S)² + e²) for the sectors, e the most in elevation
    """
    count = max(len(sensing.list_given(name) or [0]) for name in ("error", "sectors"))
    errors, sectors = (sensing.each(name, count).tolist() for name in ("error", "sectors"))
    return max(_largest_error(*own, dim) for own in zip(errors, sectors, strict=True))


def _largest_error(error: float, sectors: float, dim: int) -> float:
    """``bounded_error`` of one robot; 0 sectors are exact."""
    if sectors == 0.0:
        return error
    rounded = math.pi / sectors
    if dim == 3:
        highest = math.floor(sectors / 4.0 + 1e-9) * 2.0 * rounded
        rounded = math.hypot(rounded, max(rounded, math.pi / 2.0 - highest))
    return min(error + rounded, math.pi)


def error_chord(bearing_error: float) -> float:
    """2 sin(η/2), a number without unit: f_i is wrong by e_i = 2 sin(η/2) D_i (theorem N1)."""
    return 2.0 * math.sin(0.5 * bearing_error)


def is_complete(scenario: Scenario) -> bool:
    """True if every robot is always linked to every other (theory 2)."""
    graph, n = scenario.sensing_graph, scenario.n_robots
    return graph.fixed and not graph.directed and graph.most_links(n) == n * (n - 1) // 2


def has_one_weight(scenario: Scenario) -> bool:
    """True if all links have the same weight, in m/s."""
    least, largest = scenario.sensing_graph.extreme_weights(scenario.n_robots)
    return bool(least == largest)


def levels_follow_v(scenario: Scenario) -> bool:
    """True if stored energy follows V at merges (theorem D).

    This holds for single integrators on complete graphs of equal weights without obstacles.
    """
    sensing = scenario.sensing
    sees_all = sensing == Sensing(error=sensing.error, sectors=sensing.sectors)
    free = scenario.model.bounded and not scenario.obstacles
    return sees_all and free and is_complete(scenario) and has_one_weight(scenario)
