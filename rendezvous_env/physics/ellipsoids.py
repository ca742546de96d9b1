"""Least values of convex functions: a minimum is shut in by ellipsoids, each smaller than the last.

    E = {x : (x − c)ᵀ P⁻¹ (x − c) ≤ 1},   P = [p₀ p₁ p₂; p₁ p₃ p₄; p₂ p₄ p₅]

A subgradient g of f at c leaves out the half with gᵀ(x − c) > 0, and no value in E is below
f(c) − √(gᵀPg) (Shor 1977).
"""

import math

from ..compilation import inner_kernel
from .vectors import combine, dot


@inner_kernel
def ball(radius):
    """P of a ball of a radius, m: r² I, six numbers in m²."""
    square = radius * radius
    return square, 0.0, 0.0, square, 0.0, square


@inner_kernel
def times(matrix, g):
    """The product P g of a symmetric matrix and a triple."""
    return (
        matrix[0] * g[0] + matrix[1] * g[1] + matrix[2] * g[2],
        matrix[1] * g[0] + matrix[3] * g[1] + matrix[4] * g[2],
        matrix[2] * g[0] + matrix[4] * g[1] + matrix[5] * g[2],
    )


@inner_kernel
def half_width(matrix, g):
    """Half the width of an ellipsoid along a unit triple, √(gᵀPg), m; 0 where rounding ends it."""
    return math.sqrt(max(dot(g, times(matrix, g)), 0.0))


@inner_kernel
def cut(centre, matrix, g, share, dim):
    """The least ellipsoid about what a cut leaves of another, c and P, in 2 or 3 dimensions.

    With α = ``share``, 0 ≤ α < 1, of the half width √(gᵀPg) along g, b = P g/√(gᵀPg), n = ``dim``:

        c ← c − (1 + nα)/(n + 1) b
        P ← n²(1 − α²)/(n² − 1) (P − 2(1 + nα)/((n + 1)(1 + α)) b bᵀ)
    """
    b = times(matrix, g)
    inverse = 1.0 / half_width(matrix, g)
    x, y, z = b[0] * inverse, b[1] * inverse, b[2] * inverse
    ahead = (1.0 + dim * share) / (dim + 1.0)
    grown = dim * dim * (1.0 - share * share) / (dim * dim - 1.0)
    less = 2.0 * ahead / (1.0 + share)
    smaller = (
        grown * (matrix[0] - less * x * x),
        grown * (matrix[1] - less * x * y),
        grown * (matrix[2] - less * x * z),
        grown * (matrix[3] - less * y * y),
        grown * (matrix[4] - less * y * z),
        grown * (matrix[5] - less * z * z),
    )
    return combine(1.0, centre, -ahead, (x, y, z)), smaller
