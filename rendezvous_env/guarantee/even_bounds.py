"""By when all have met whose gains add up to the same, bearings wrong or held (theorem N)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..experiment.scenario import Scenario
from .degrees import degrees_stay_equal, least_degrees
from .error_times import held_error, largest_error, wrong_bearings_time
from .size_bounds import checked_size

Array = NDArray[np.float64]


def even_time_bound(
    scenario: Scenario, initial_size: ArrayLike, error: float, *, gain: float | None = None
) -> Array:
    """Theorem N's T for inputs held over the step τ, s.

        η_m = η + asin(2 c_m τ/r),      T ≤ L0 / min_m shrinking(m, c_m, η_m) + (n − 1) τ

    A held bearing is a bearing with an error. Two robots whose bearings are right are never wrong
    about each other: they move on one line.

    Args:
        scenario: gives n, the dimension, r, τ and the graph.
        initial_size: L(0), (...), m.
        error: η, a number, rad.
        gain: c, m/s; None takes the degrees of law (1), which must stay equal.

    Returns:
        (...), s; infinite where an η_m is too large.
    """
    left, gains, late_by = _held(scenario, gain)
    if error == 0.0:
        late_by = np.where(left == 2, 0.0, late_by)
    initial = np.asarray(initial_size)[..., np.newaxis]
    times = wrong_bearings_time(left, scenario.dim, initial, gains, error + late_by)
    return np.asarray(times.max(axis=-1) + (scenario.n_robots - 1) * scenario.tau)


def even_error_borne(scenario: Scenario, gain: float | None = None) -> float:
    """The η that robots bear whose gains add up to the same, inputs held (theorem N).

        π/n − asin(2cτ/r);      in space atan(1/√(n(n − 2))) − asin(2cτ/r)

    Args:
        scenario: gives n, the dimension, r and τ.
        gain: c, m/s; None takes the degrees of law (1).

    Returns:
        A number, rad, at least 0.
    """
    left, _, late_by = _held(scenario, gain)
    return max(0.0, float((largest_error(left, scenario.dim) - late_by).min()))


def evenly_moved(scenario: Scenario) -> bool:
    """Whether law (1) gives all robots the same gains at any time, and nobody is slowed down."""
    fast = scenario.speed_limit >= least_degrees(scenario).max(initial=0.0)
    return degrees_stay_equal(scenario) and bool(fast)


def held_size_bound(scenario: Scenario, initial_size: ArrayLike) -> Array:
    """Time by which law (1) has brought all together, inputs held over the step, s (theorem N).

    Args:
        scenario: gives n, the dimension, the graph, r, τ and v_max.
        initial_size: L(0), (...), m.

    Returns:
        (...), s; infinite where nothing is proven, as where the robots are not ``evenly_moved``.

    Raises:
        ValueError: if a size is not finite or negative.
    """
    initial = checked_size(initial_size)
    if not evenly_moved(scenario):
        return np.full(initial.shape, np.inf)
    return even_time_bound(scenario, initial, 0.0)


def _held(scenario: Scenario, gain: float | None) -> tuple[Array, Array, Array]:
    """For m = 2 … n robots that are left: m, c_m in m/s, and asin(2 c_m τ/r) in rad."""
    left = np.arange(2.0, scenario.n_robots + 1.0)
    gains = least_degrees(scenario) if gain is None else np.full(len(left), gain)
    return left, gains, held_error(gains, scenario.tau, scenario.merge_radius)
