"""V, its rate and net bearings from positions in the global frame, for analysis only."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import floats
from ..physics.potential import lyapunov_of_links, net_bearings_of_links

Array = NDArray[np.float64]


def lyapunov(positions: ArrayLike, weights: ArrayLike) -> Array:
    """V = Σ_i Σ_j a_ij ‖p_i − p_j‖ (paper, section III), (...), m²/s.

    Positions are (..., n, d), m, and symmetric weights (..., n, n), m/s.
    """
    return _of_teams(lambda p, a: lyapunov_of_links(p, _links(a)), "()", positions, weights)


def net_bearings(positions: ArrayLike, weights: ArrayLike) -> Array:
    """f_i = Σ_j a_ij g_ij in the global frame, (..., n, d), m/s; arguments as ``lyapunov``."""

    def of_team(p: Array, a: Array) -> Array:
        net_bearings_of_links(p, _links(a), out := np.empty(p.shape))
        return out

    return _of_teams(of_team, "(n,d)", positions, weights)


def lyapunov_rate(velocities: ArrayLike, net_bearing: ArrayLike) -> Array:
    """V̇ = −2 Σ_i f_iᵀ ṗ_i, (...), m²/s², which is −2 Σ (h_iᵀ f_i)² under law (4).

    Velocities and net bearings are (..., n, d), m/s, in the same frame.
    """
    return np.asarray(-2.0 * np.sum(np.multiply(velocities, net_bearing), axis=(-2, -1)))


def _links(weights: Array) -> tuple[Any, Any, Any]:
    first, second = np.nonzero(np.triu(weights > 0, 1))
    return first, second, weights[first, second]


def _of_teams(of_team: Any, result: str, positions: ArrayLike, weights: ArrayLike) -> Array:
    """Apply a function of one environment's positions and weights over leading axes."""
    p, a = floats("positions", positions), floats("weights", weights)
    if p.ndim < 2 or a.shape[-2:] != (p.shape[-2],) * 2:
        raise ValueError(
            f"positions {p.shape} and weights {a.shape} must be (..., n, d) and (..., n, n)"
        )
    over = np.vectorize(of_team, otypes=[np.float64], signature=f"(n,d),(n,n)->{result}")
    return np.asarray(over(np.ascontiguousarray(p), np.ascontiguousarray(a)))
