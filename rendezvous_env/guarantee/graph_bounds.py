"""By when all robots have met on graphs that are directed, switch, or depend on who is near
(theorems G, C4 and R; guarantees 10 and 12).

Functions of numbers, which broadcast; an infinite time says that nothing is promised.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .error_times import over_rate
from .size_bounds import shrinking, shrinking_to_leader

Array = NDArray[np.float64]


def gains_time(n: int, dim: int, initial_size: ArrayLike, gain: ArrayLike) -> Array:
    """T for any gains c_ij ≥ 0 with Σ_j c_ij ≥ c, whoever sees whom, s (theorem G).

        2-D   T ≤ L0/(2 c κ(n)),      3-D   T ≤ n w0/(2c),   w0 = L0/2π

    Args:
        n: number of robots, at least 2.
        dim: 2 or 3.
        initial_size: L0, (...), m.
        gain: c, (...), m/s.

    Returns:
        (...), s.
    """
    return np.asarray(np.asarray(initial_size) / shrinking(n, dim, gain))


def led_time(n: int, dim: int, initial_size: ArrayLike, gain: ArrayLike) -> Array:
    """The same where one robot, a leader, may rest and see nobody, s (theorem G).

        2-D   T ≤ L0/(2 c κ₁(n)),   κ₁(n) = (n−1) sin²(π/(2(n−1))),      3-D   T ≤ 2 (n−1) w0/c

    Args:
        n: number of robots, at least 2.
        dim: 2 or 3.
        initial_size: L0, (...), m.
        gain: c of all others, (...), m/s.

    Returns:
        (...), s.
    """
    return np.asarray(np.asarray(initial_size) / shrinking_to_leader(n, dim, gain))


def windows_time(
    n: int,
    initial_size: ArrayLike,
    *,
    least_gain: float,
    most_gain: float,
    window: float,
    least_duration: float,
    merge_radius: float,
) -> Array:
    """T in the plane where robots see somebody only now and then, s (theorem G, jointly connected).

        T ≤ T_w (n + L0/ΔL),   ΔL = (π/n)(c/3) s min(τ_d, r s/(4C)),   s = sin(π/(2n))

    In every window T_w each robot has an interval of τ_d or more with gains in [c, C]; all pairs
    merge.

    Args:
        n: number of robots, at least 2.
        initial_size: L0, (...), m.
        least_gain: c, m/s.
        most_gain: C, m/s.
        window: T_w, s.
        least_duration: τ_d, s.
        merge_radius: r, m.

    Returns:
        (...), s.
    """
    s = np.sin(np.pi / (2.0 * n))
    lasting = min(least_duration, merge_radius * s / (4.0 * most_gain))
    least_fall = np.pi / n * least_gain / 3.0 * s * lasting
    return np.asarray(window * (n + np.asarray(initial_size) / least_fall))


def cone_time(
    n: int, dim: int, initial_size: ArrayLike, least_degree: ArrayLike, min_alignment: ArrayLike
) -> Array:
    """T of law (4) with headings in the cone of what is seen, on any graph, s (C4).

        h_i ∈ cone{g_ij}, h·f ≥ ε‖f‖:   2-D  T ≤ n² L0/(16 ε d_min),   3-D  n² w0/(4 ε d_min)

    Args:
        n: number of robots, at least 2.
        dim: 2 or 3.
        initial_size: L0, (...), m.
        least_degree: d_min, the least Σ_j a_ij, (...), m/s.
        min_alignment: ε in (0, 1], (...), without unit.

    Returns:
        (...), s.
    """
    factor = 16.0 if dim == 2 else 8.0 * np.pi
    rate = factor * np.asarray(min_alignment) * np.asarray(least_degree)
    return np.asarray(n**2 * np.asarray(initial_size) / rate)


def sighted_lyapunov_bound(
    n: int,
    initial_lyapunov: ArrayLike,
    *,
    links: ArrayLike,
    weight: float,
    sight: float,
    merge_radius: float,
) -> Array:
    """The most that V can come to where links appear and go with sight, m²/s (theorem R).

        V_tot = V0 + 2aR [n(n−1)/2 − |E0| + (n−1)²] + (n−1) r a n(n−1)/2

    Args:
        n: number of robots.
        initial_lyapunov: V0, (...), m²/s.
        links: |E0|, how many there are at the start, (...).
        weight: a of every link, m/s.
        sight: R, m.
        merge_radius: r, m.

    Returns:
        (...), m²/s.
    """
    pairs = n * (n - 1) / 2.0
    appear = pairs - np.asarray(links) + (n - 1) ** 2
    merges = (n - 1) * merge_radius * weight * pairs
    return np.asarray(np.asarray(initial_lyapunov) + 2.0 * weight * sight * appear + merges)


def links_time(
    n: int,
    lyapunov_bound: ArrayLike,
    *,
    least_degree: float,
    step: float,
    share: float = 1.0,
    error: ArrayLike = 0.0,
    slowest: float | None = None,
) -> Array:
    """T under link-keeping with limited sight, s (theorem R c and d).

        v_i = λ min(d_i, v_max, r/(2τ)) sin(asin ‖q̂_i‖ − η)₊ q̂_i/‖q̂_i‖ + (1 − λ) P(wanted):
        T ≤ n V_tot/(4 λ d_min s (1 − 2nη/π)²) + (n−1) τ,       s = min(d_min, v_max, r/(2τ))

    Links of at most R − (n−1) r/2 connect the team at the start; inputs are held over τ. With a
    long step or a slow robot the law's part is shorter, lies in the same set, and V still falls by
    λ d s ‖q‖² or more.

    Args:
        n: number of robots, at least 2.
        lyapunov_bound: V_tot of ``sighted_lyapunov_bound``, (...), m²/s.
        least_degree: d_min, m/s.
        step: τ, s.
        share: λ in (0, 1], without unit.
        error: η, (...), rad.
        slowest: s, m/s; None is d_min, for τ ≤ r/(2D̄) and no limit of speed.

    Returns:
        (...), s; infinite from η = π/(2n) on.
    """
    left = np.maximum(1.0 - 2.0 * n * np.asarray(error) / np.pi, 0.0)
    speed = least_degree if slowest is None else slowest
    rate = 4.0 * share * least_degree * speed * left**2
    return over_rate(n * np.asarray(lyapunov_bound), rate) + (n - 1) * step
