"""By when all robots have met, from the size L of their start (theorem G, E2)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..experiment.checks import floats, refuse
from ..experiment.scenario import Scenario
from .degrees import least_degrees

Array = NDArray[np.float64]


def kappa(n: ArrayLike) -> Array:
    """κ(n) = min{Σ sin²x_i : Σx_i = π, 0 ≤ x_i ≤ π/2} (guarantees, section 9).

        κ(n) = min( n sin²(π/n), 1 + (n − 1) sin²(π/(2(n − 1))) )

    Args:
        n: number of robots, (...), at least 2.

    Returns:
        (...), without unit.
    """
    m = np.asarray(n, dtype=np.float64)
    alike = m * np.sin(np.pi / m) ** 2
    one_flat = 1.0 + (m - 1.0) * np.sin(np.pi / (2.0 * (m - 1.0))) ** 2
    return np.asarray(np.minimum(alike, one_flat))


def shrinking(n: ArrayLike, dim: int, gain: ArrayLike, error: ArrayLike = 0.0) -> Array:
    """Least −L' of n robots that move with gains Σ_j c_ij ≥ c along their bearings, m/s.

        2-D:   2 c κ(n) sin(π/n − η)/sin(π/n)                           (theorem G; N for η > 0)
        3-D:   4π c [cos η/n − sin η √(1 − 2/n)]

    Args:
        n: robots that are left, (...), at least 2.
        dim: 2 or 3.
        gain: c, (...), m/s; with an error all Σ_j c_ij must equal it.
        error: η, (...), rad, the largest angle by which a bearing is wrong.

    Returns:
        (...); 0 where the error is too large for any promise.
    """
    m, c, eta = np.asarray(n, dtype=np.float64), np.asarray(gain), np.asarray(error)
    if dim == 2:
        share = np.sin(np.pi / m - eta) / np.sin(np.pi / m)
        rate = 2.0 * c * kappa(m) * share
    else:
        rate = 4.0 * np.pi * c * (np.cos(eta) / m - np.sin(eta) * np.sqrt(1.0 - 2.0 / m))
    return np.where(eta < np.pi / m, np.maximum(rate, 0.0), 0.0)


def shrinking_to_leader(n: ArrayLike, dim: int, gain: ArrayLike) -> Array:
    """Least −L' if one robot may rest and see nobody, the others as in ``shrinking``, m/s.

        2-D:   2 c κ₁(n),   κ₁(n) = (n − 1) sin²(π/(2(n − 1)));      3-D:   π c/(n − 1)

    Args:
        n: number of robots, (...), at least 2.
        dim: 2 or 3.
        gain: c, (...), m/s.

    Returns:
        (...).
    """
    others, c = np.asarray(n, dtype=np.float64) - 1.0, np.asarray(gain)
    if dim == 2:
        return np.asarray(2.0 * c * others * np.sin(np.pi / (2.0 * others)) ** 2)
    return np.asarray(np.pi * c / others)


def gain_bound(
    scenario: Scenario, initial_size: ArrayLike, gain: float, *, led: bool = False
) -> Array:
    """Time by which all have met with gains of at least c per robot, s (theorem G).

        T ≤ L0 / min_m shrinking(m, c),   c no more than v_max

    Proven for velocities that follow the bearings in continuous time.

    Args:
        scenario: gives n, the dimension and v_max.
        initial_size: L(0), (...), m.
        gain: c, m/s.
        led: whether one robot may rest and see nobody.

    Returns:
        (...), s.

    Raises:
        ValueError: if a size is not finite or negative.
    """
    left, c = np.arange(2, scenario.n_robots + 1), min(gain, scenario.speed_limit)
    rates = shrinking_to_leader if led else shrinking
    return checked_size(initial_size) / rates(left, scenario.dim, c).min()


def size_bound(scenario: Scenario, initial_size: ArrayLike) -> Array:
    """Time by which law (1) has brought all robots together, s (theorem G).

        2-D   T ≤ L0 / (2 min_m c_m κ(m)),      3-D   T ≤ max_m m w0 / (2 c_m),   w0 = L0/2π

    with c_m the least D_i that m robots can have, or v_max if that is less. Proven for velocities
    that follow the bearings in continuous time.

    Args:
        scenario: gives n, the dimension, the graph and v_max.
        initial_size: L(0), (...), m.

    Returns:
        (...), s.

    Raises:
        ValueError: if a size is not finite or negative.
    """
    gains = np.minimum(least_degrees(scenario), scenario.speed_limit)
    left = np.arange(2, scenario.n_robots + 1)
    slowest = shrinking(left, scenario.dim, gains).min()
    return checked_size(initial_size) / slowest


def pursuit_bound(scenario: Scenario, initial_size: ArrayLike, speed: float) -> Array:
    """Time by which pursuers with a turn limit have met, s (E2, guarantees 13).

        2-D   T ≤ L0/(2 c κ(n)) + nπ/(ω_max − 2c/r),      3-D   n w0/(2c) + the same

    Each robot pursues one that it sees until a merge: it turns towards it at ω_max, and drives at c
    only while it points at it. In continuous time, on any graph.

    Args:
        scenario: gives n, the dimension, r and ω_max.
        initial_size: L(0), (...), m.
        speed: c, m/s, positive and less than ω_max r/2.

    Returns:
        (...), s.

    Raises:
        ValueError: for a speed at which a target can run out of sight, or a size that is none.
    """
    n, fastest = scenario.n_robots, scenario.turn_limit * scenario.merge_radius / 2.0
    if not 0 < speed < fastest:
        refuse("speed", speed, f"positive and less than ω_max r/2 = {fastest:.6g} m/s")
    spare = scenario.turn_limit - 2.0 * speed / scenario.merge_radius
    driving = checked_size(initial_size) / shrinking(n, scenario.dim, speed)
    return np.asarray(driving + n * math.pi / spare)


def checked_size(initial_size: ArrayLike) -> Array:
    """L(0) as an array of numbers that a team can have: finite, L ≥ zero.

    Args:
        initial_size: L(0), (...), m.

    Returns:
        The same, float64.

    Raises:
        ValueError: if one is not finite or negative.
    """
    initial = floats("initial_size", initial_size)
    if not (np.isfinite(initial) & (initial >= 0)).all():
        refuse("initial_size", initial_size, "finite and at least 0 m")
    return initial
