"""By when all robots have met although bearings are noisy or late (guarantees, 11).

Functions of numbers, which broadcast; an infinite time says that nothing is promised.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .error_times import over_rate

Array = NDArray[np.float64]


def mean_cosine(noise: ArrayLike) -> Array:
    """γ = E cos ξ = exp(−σ²/2) of a normally distributed angle ξ.

    Args:
        noise: σ, (...), rad.

    Returns:
        (...), without unit.
    """
    return np.asarray(np.exp(-0.5 * np.asarray(noise) ** 2))


def scatter(
    n: int, cosine: ArrayLike, square_weights: ArrayLike, bottleneck_weight: ArrayLike
) -> Array:
    """ν = n (1 − γ²) Σ a_ij²/(4 a*²), what noise adds to ‖f‖² as a share of 4 a*²/n.

    Args:
        n: number of robots.
        cosine: γ of ``mean_cosine``, (...), without unit.
        square_weights: Σ_i Σ_j a_ij², each link in both directions, (...), m²/s².
        bottleneck_weight: a*, (...), m/s.

    Returns:
        (...), without unit.
    """
    spread = n * (1.0 - np.asarray(cosine) ** 2) * np.asarray(square_weights)
    return np.asarray(spread / (4.0 * np.asarray(bottleneck_weight) ** 2))


def noisy_mean_time(
    n: int,
    lyapunov_bound: ArrayLike,
    *,
    max_degree: float,
    bottleneck_weight: float,
    cosine: ArrayLike,
    square_weights: ArrayLike,
    merge_radius: float,
    step: float,
) -> Array:
    """The most that E[T] of law (1) can be with independent, isotropic noise, s.

        E[T] ≤ n (V0⁺ + n (n−1) r θ D̄)/(4 a*² [γ (2 − θγ) − θν]),    θ = 2 D̄ τ/r < 2γ/(γ² + ν),

    ν is ``scatter``'s. On an undirected graph. Any unbiased noise is beaten by a short enough step.

    Args:
        n: number of robots.
        lyapunov_bound: V0⁺, (...), m²/s.
        max_degree: D̄, m/s.
        bottleneck_weight: a*, m/s.
        cosine: γ = E cos ξ of the angle ξ by which a bearing is off, (...), without unit.
        square_weights: Σ_i Σ_j a_ij², each link in both directions, (...), m²/s².
        merge_radius: r, m.
        step: τ, s.

    Returns:
        (...), s.
    """
    gamma, theta = np.asarray(cosine), 2.0 * max_degree * step / merge_radius
    cut_short = n * (n - 1) * merge_radius * theta * max_degree
    nu = scatter(n, gamma, square_weights, bottleneck_weight)
    share = gamma * (2.0 - theta * gamma) - theta * nu
    above = n * (np.asarray(lyapunov_bound) + cut_short)
    return over_rate(above, 4.0 * bottleneck_weight**2 * share)


def largest_age(max_degree: float, merge_radius: float, *, law_4: bool = False) -> float:
    """The age that bearings may have, a number, s (E1).

        law (1): r/(2D̄),        law (4): r/(2√3 D̄)

    Args:
        max_degree: D̄, m/s.
        merge_radius: r, m.
        law_4: whether robots move along headings.

    Returns:
        Δ, s.
    """
    return merge_radius / (2.0 * max_degree) / (np.sqrt(3.0) if law_4 else 1.0)


def stale_time(
    n: int, lyapunov_bound: ArrayLike, *, bottleneck_weight: ArrayLike, slowest: ArrayLike = 1.0
) -> Array:
    """T of law (1) with bearings of any age up to r/(2D̄), pair by pair, s (E1).

        T ≤ n V0⁺/(4 s a*²);      law (4), up to r/(2√3 D̄):  T ≤ n V0⁺/(ε² a*²), s = ε²/4

    Bearings of a robot that has just merged are fresh; the margin of law (4) is not faded.

    Args:
        n: number of robots.
        lyapunov_bound: V0⁺, (...), m²/s.
        bottleneck_weight: a*, (...), m/s.
        slowest: s in (0, 1], (...): a robot moves at s_i(t) f̂_i, s ≤ s_i ≤ 1.

    Returns:
        (...), s.
    """
    return over_rate(
        n * np.asarray(lyapunov_bound),
        4.0 * np.asarray(bottleneck_weight) ** 2 * np.asarray(slowest),
    )
