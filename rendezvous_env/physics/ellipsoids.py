"""Minima of convex functions by the ellipsoid method: ever smaller ellipsoids contain the minimum.

    E = {c + B u : ‖u‖ ≤ 1}

A subgradient g of f at c leaves out the half with gᵀ(x − c) > 0, and no value in E is below
f(c) − ‖Bᵀg‖ (Shor 1977). B is three columns, triples in m: BBᵀ itself would lose a side that is 10⁸
times shorter than another to rounding.
"""

import math

from ..compilation import inner_kernel
from .vectors import combine, dot, norm, scaled


@inner_kernel
def ball(radius):
    """Columns B = r I of a ball of radius r, m, as three triples."""
    return (radius, 0.0, 0.0), (0.0, radius, 0.0), (0.0, 0.0, radius)


@inner_kernel
def along(axes, g):
    """The product Bᵀg with a unit triple, m; its length is half the width of E along g."""
    return dot(axes[0], g), dot(axes[1], g), dot(axes[2], g)


@inner_kernel
def cut(centre, axes, g, share, dim):
    """Smallest ellipsoid (c, B), triples, m, around the remainder of a cut one, in 2-D or 3-D.

    With α = ``share``, 0 ≤ α < 1, of the half width ‖Bᵀg‖ along g, u = Bᵀg/‖Bᵀg‖, n = ``dim``:

        c ← c − (1 + nα)/(n + 1) B u
        B ← n √((1 − α²)/(n² − 1)) B (I − (1 − √(1 − 2(1 + nα)/((n + 1)(1 + α)))) u uᵀ)
    """
    u = along(axes, g)
    u = scaled(u, 1.0 / norm(u))
    b = combine(1.0, combine(u[0], axes[0], u[1], axes[1]), u[2], axes[2])
    ahead = (1.0 + dim * share) / (dim + 1.0)
    left = math.sqrt(max(1.0 - 2.0 * ahead / (1.0 + share), 0.0)) - 1.0
    grown = dim * math.sqrt((1.0 - share) * (1.0 + share) / (dim * dim - 1.0))
    smaller = (
        combine(grown, axes[0], grown * left * u[0], b),
        combine(grown, axes[1], grown * left * u[1], b),
        combine(grown, axes[2], grown * left * u[2], b),
    )
    return combine(1.0, centre, -ahead, b), smaller
