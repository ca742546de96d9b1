"""V, its rate, net bearings and alignment, of positions in the global frame.

Everything here sees positions: it is for analysis, never for a law.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import floats
from ..physics.potential import lyapunov_of_links, net_bearings_of_links

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
