"""By when all robots have met although bearings are wrong, noisy or late (guarantees, 11).

Functions of numbers, which broadcast; an infinite time says that nothing is promised.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .bearing_errors import error_chord
from .size_bounds import shrinking

Array = NDArray[np.float64]


def largest_error(n: ArrayLike, dim: int) -> Array:
    """η below which theorem N promises a rendezvous, rad.

        2-D   η < π/n (sharp),        3-D   tan η < 1/√(n(n − 2)), sufficient

    Args:
        n: number of robots, (...), at least 2.
        dim: 2 or 3.

    Returns:
        (...), rad.
    """
    m = np.asarray(n, dtype=np.float64)
    if dim == 2:
        return np.asarray(np.pi / m)
    return np.arctan2(1.0, np.sqrt(m * (m - 2.0)))


def held_error(gain: ArrayLike, duration: ArrayLike, merge_radius: float) -> Array:
    """The error of a bearing that is held, or late, for a while (theorem N, one budget), rad.

        η = asin(2 c (τ + delay)/r)

    It adds to the errors of the sensor and of the direction of the motion.

    Args:
        gain: c, no robot is faster, (...), m/s.
        duration: τ + delay, (...), s.
        merge_radius: r, m.

    Returns:
        (...), rad; π where a neighbour can be passed meanwhile.
    """
    sine = 2.0 * np.asarray(gain) * np.asarray(duration) / merge_radius
    return np.where(sine < 1.0, np.arcsin(np.minimum(sine, 1.0)), np.pi)


def longest_held_step(n: ArrayLike, gain: ArrayLike, merge_radius: float, share: float) -> Array:
    """The step in which held inputs use up a share β of the errors that theorem N forgives, s.

        τ = (r/2c) sin(β π/n)

    Args:
        n: number of robots, (...), at least 2.
        gain: c, (...), m/s.
        merge_radius: r, m.
        share: β in (0, 1).

    Returns:
        (...), s.
    """
    m = np.asarray(n, dtype=np.float64)
    return np.asarray(merge_radius / (2.0 * np.asarray(gain)) * np.sin(share * np.pi / m))


def wrong_bearings_time(
    n: int, dim: int, initial_size: ArrayLike, gain: ArrayLike, error: ArrayLike
) -> Array:
    """T where all Σ_j c_ij are equal and every bearing is off by η at most, s (theorem N).

        2-D   T ≤ L0 sin(π/n)/(2 c κ(n) sin(π/n − η)),
        3-D   T ≤ w0/(2c [cos η/n − sin η √(1 − 2/n)]),   w0 = L0/2π

    On any directed graph that may switch, in continuous time.

    Args:
        n: number of robots, at least 2.
        dim: 2 or 3.
        initial_size: L0, (...), m.
        gain: c, (...), m/s.
        error: η, (...), rad.

    Returns:
        (...), s.
    """
    rate = shrinking(n, dim, gain, error)
    with np.errstate(divide="ignore"):
        return np.asarray(np.asarray(initial_size) / rate)


def most_wrong(degree: ArrayLike, error: float) -> Array:
    """The most by which a net bearing can be wrong, e_i = 2 sin(η/2) D_i (theorem N1), m/s.

    Args:
        degree: D_i = Σ_j a_ij, (...), m/s.
        error: η, a number, rad: no bearing is off by more.

    Returns:
        (...), m/s.
    """
    return np.asarray(error_chord(error) * np.asarray(degree))


def error_share(n: int, max_degree: ArrayLike, bottleneck_weight: ArrayLike, error: float) -> Array:
    """ρ = n D̄ sin(η/2)/a*, what errors take from Σ‖f_i‖ ≥ 2 a* (theorem N1).

    Args:
        n: number of robots.
        max_degree: D̄, (...), m/s.
        bottleneck_weight: a*, (...), m/s.
        error: η, a number, rad.

    Returns:
        (...), without unit.
    """
    return n * most_wrong(max_degree, error) / (2.0 * np.asarray(bottleneck_weight))


def wrong_law_1_time(
    n: int,
    lyapunov_bound: ArrayLike,
    *,
    max_degree: float,
    bottleneck_weight: float,
    error: float,
    step: float,
) -> Array:
    """T of law (1) with bearings that are off by η at most, s (theorem N1).

        T ≤ n (V0⁺ + (n−1) τ Σ e_i²)/(4 a*² (1 − ρ²)) + (n−1) τ,   ρ < 1,   e_i = 2 sin(η/2) D̄

    On an undirected graph, with inputs held over τ ≤ r/(2D̄). Between merges V rises by no more
    than τ Σ e_i² in a step.

    Args:
        n: number of robots.
        lyapunov_bound: V0⁺ = V(0) + (n−1) r W, (...), m²/s.
        max_degree: D̄, m/s.
        bottleneck_weight: a*, m/s.
        error: η, a number, rad.
        step: τ, s.

    Returns:
        (...), s.
    """
    rho = error_share(n, max_degree, bottleneck_weight, error)
    lost = (n - 1) * step * n * most_wrong(max_degree, error) ** 2
    rate = 4.0 * bottleneck_weight**2 * (1.0 - rho**2)
    return _by(n * (np.asarray(lyapunov_bound) + lost), rate) + (n - 1) * step


def certified_share(min_alignment: ArrayLike, rho: ArrayLike, dead_zone: float = 0.5) -> Array:
    """Share q = ε (2 − β) − 2 (1 + ε) ρ: Σ_i (h·f̂_i − e_i)₊ ≥ q a* (theorem N1').

    Args:
        min_alignment: ε, (...), without unit.
        rho: ρ of ``error_share``, (...), without unit.
        dead_zone: β, the dead zone δ in units of a*/n.

    Returns:
        (...), without unit; nothing is promised unless it is positive.
    """
    epsilon = np.asarray(min_alignment)
    return np.asarray(epsilon * (2.0 - dead_zone) - 2.0 * (1.0 + epsilon) * np.asarray(rho))


def wrong_certified_time(
    n: int,
    lyapunov_bound: ArrayLike,
    *,
    bottleneck_weight: float,
    share: ArrayLike,
    step: float,
    slowest: float = 1.0,
) -> Array:
    """T of any policy whose heading is certified against what it sees, s (theorem N1').

        v_i = max(0, h·f̂_i − e_i) h,      T ≤ n V0⁺/(a*² q² s) + (n−1) τ

    With inputs held over τ, each robot slowed down by a factor of at least s. The same for an
    energy tank that pays for errors (theorem D), with V0⁺ + (n−1) r W + ΣB_i in place of V0⁺.

    Args:
        n: number of robots.
        lyapunov_bound: V0⁺, (...), m²/s.
        bottleneck_weight: a*, m/s.
        share: q of ``certified_share``, (...), without unit.
        step: τ, s.
        slowest: s in (0, 1], without unit: min(1, r/(2D̄τ), v_max/D̄).

    Returns:
        (...), s.
    """
    q = np.maximum(np.asarray(share), 0.0)
    return _by(n * np.asarray(lyapunov_bound), (bottleneck_weight * q) ** 2 * slowest) + (
        (n - 1) * step
    )


def noisy_mean_time(
    n: int,
    lyapunov_bound: ArrayLike,
    *,
    max_degree: float,
    bottleneck_weight: float,
    mean_cosine: ArrayLike,
    square_weights: ArrayLike,
    merge_radius: float,
    step: float,
) -> Array:
    """The most that E[T] of law (1) can be with independent, isotropic noise, s.

        E[T] ≤ n (V0⁺ + n (n−1) r θ D̄)/(4 a*² [γ (2 − θγ) − θν]),    θ = 2 D̄ τ/r < 2γ/(γ² + ν),
        ν = n (1 − γ²) Σ a_ij²/(4 a*²)

    On an undirected graph. Any unbiased noise is beaten by a short enough step.

    Args:
        n: number of robots.
        lyapunov_bound: V0⁺, (...), m²/s.
        max_degree: D̄, m/s.
        bottleneck_weight: a*, m/s.
        mean_cosine: γ = E cos ξ of the angle ξ by which a bearing is off, (...), without unit.
        square_weights: Σ_i Σ_j a_ij², each link in both directions, (...), m²/s².
        merge_radius: r, m.
        step: τ, s.

    Returns:
        (...), s.
    """
    gamma, theta = np.asarray(mean_cosine), 2.0 * max_degree * step / merge_radius
    cut_short = n * (n - 1) * merge_radius * theta * max_degree
    nu = n * (1.0 - gamma**2) * np.asarray(square_weights) / (4.0 * bottleneck_weight**2)
    share = gamma * (2.0 - theta * gamma) - theta * nu
    return _by(n * (np.asarray(lyapunov_bound) + cut_short), 4.0 * bottleneck_weight**2 * share)


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
    return _by(
        n * np.asarray(lyapunov_bound),
        4.0 * np.asarray(bottleneck_weight) ** 2 * np.asarray(slowest),
    )


def _by(above: Array, rate: ArrayLike) -> Array:
    """Above over a rate; infinite for a rate that is not positive."""
    below = np.asarray(rate, dtype=np.float64)
    with np.errstate(divide="ignore", over="ignore"):
        return np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), np.inf)
