"""Times of teams that no scenario of the environment asks for, as functions of numbers.

**C4.** Law (4) with headings in the cone of what is seen, h_i ∈ cone{g_ij} and h·f ≥ ε‖f‖, on any
graph on which all see somebody: the hull is nested, T ≤ n² L0/(16 ε d_min), in 3-D n² w0/(4 ε
d_min), d_min the least Σ_j a_ij. (Law (4) without the cone lets teams on switching graphs grow
without end for ε < 0.277.)

**Windows**, in the plane, all pairs merge. If in every window of time T_w *each robot* has an
interval of τ_d or more in which it sees somebody, with gains in [c, C] — joint connectivity alone
is not enough —

    T ≤ T_w (n + L0/ΔL),      ΔL = (π/n)(c/3) s min(τ_d, r s/(4C)),      s = sin(π/(2n)).

**Proof.** docs/proofs.md, C4 and windows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.safety.theorems.constants import over_rate
from rendezvous_env.safety.theorems.gains import shrinking, shrinking_to_leader

Array = NDArray[np.float64]


def gains_time(n: int, dim: int, initial_size: ArrayLike, gain: ArrayLike) -> Array:
    """T for any gains c_ij ≥ 0 with Σ_j c_ij ≥ c, whoever sees whom, in continuous time, s.

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
    """The same where one robot, a leader, may rest and see nobody, s; arguments as there."""
    return np.asarray(np.asarray(initial_size) / shrinking_to_leader(n, dim, gain))


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
    """T under link-keeping with limited sight, inputs held over τ, s.

    With a long step or a slow robot the law's part is shorter, lies in the same set, and V still
    falls by λ d s ‖q‖² or more.

    Args:
        n: number of robots, at least 2.
        lyapunov_bound: V_tot of ``sighted_lyapunov_bound``, (...), m²/s.
        least_degree: d, m/s.
        step: τ, s.
        share: λ in (0, 1], without unit.
        error: η, (...), rad.
        slowest: s, m/s; None is d, for τ ≤ r/(2D̄) and no limit of speed.

    Returns:
        (...), s; infinite from η = π/(2n) on.
    """
    left = np.maximum(1.0 - 2.0 * n * np.asarray(error) / np.pi, 0.0)
    speed = least_degree if slowest is None else slowest
    rate = 4.0 * share * least_degree * speed * left**2
    return over_rate(n * np.asarray(lyapunov_bound), rate) + (n - 1) * step


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
    """T in the plane where each robot sees somebody in every window of time, s.

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
    """T of law (4) with headings in the cone of what is seen, s (C4).

    Args:
        n: number of robots, at least 2.
        dim: 2 or 3.
        initial_size: L0, (...), m.
        least_degree: d_min, (...), m/s.
        min_alignment: ε in (0, 1], (...), without unit.

    Returns:
        (...), s.
    """
    factor = 16.0 if dim == 2 else 8.0 * np.pi
    rate = factor * np.asarray(min_alignment) * np.asarray(least_degree)
    return np.asarray(n**2 * np.asarray(initial_size) / rate)
