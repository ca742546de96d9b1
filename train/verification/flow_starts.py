"""Where the teams of the free integrator start, and who is linked to whom."""

from __future__ import annotations

import numpy as np

from .cases import BATCH
from .flow_sights import unit
from .free_flow import Array, Teams

SIZES = (2, 3, 5, 7)
_EXTENT = 2.0
"""Of the starts, m."""
_RADII = (0.15, 0.3)
"""r, m."""


def draw_teams(
    random: np.random.Generator,
    batch: int,
    dims: tuple[int, ...] = (2, 3),
    *,
    linked: bool = False,
    radii: tuple[float, float] = _RADII,
) -> Teams:
    """Teams in a square or a cube, on a regular polygon or on a line; sizes take turns.

    Args:
        random: draws them.
        batch: number of the batch.
        dims: dimensions to choose from.
        linked: whether they have a graph, undirected and connected; otherwise all pairs dock.
        radii: range of r, m.
    """
    n, dim = SIZES[batch % len(SIZES)], int(random.choice(dims))
    places = random.uniform(-_EXTENT / 2, _EXTENT / 2, (BATCH, n, dim))
    kind = random.random(BATCH)
    places[kind < 0.25] = _polygons(random, int(np.sum(kind < 0.25)), n, dim)
    on_a_line = kind > 0.9
    along = unit(random.normal(size=(BATCH, 1, dim)))
    places[on_a_line] = (places[..., :1] * along)[on_a_line]
    return Teams(places, random.uniform(*radii), draw_weights(random, n) if linked else None)


def draw_polygons(random: np.random.Generator, batch: int) -> Teams:
    """Regular polygons of 3 to 8 robots."""
    return Teams(_polygons(random, BATCH, 3 + batch % 6, 2), 0.1)


def _polygons(random: np.random.Generator, count: int, n: int, dim: int) -> Array:
    """Regular polygons in order, in any plane."""
    angle = 2 * np.pi * np.arange(n) / n + random.uniform(0, 2 * np.pi, (count, 1))
    flat = np.zeros((count, n, dim))
    flat[..., 0], flat[..., 1] = np.cos(angle), np.sin(angle)
    axes, _ = np.linalg.qr(random.normal(size=(count, dim, dim)))
    return np.asarray(_EXTENT / 2 * flat @ axes)


def draw_weights(random: np.random.Generator, n: int) -> Array:
    """Weights of BATCH connected undirected graphs, (B, n, n), m/s: trees and some links more."""
    low, high = random.uniform(0.5, 1.0), random.uniform(1.0, 2.0)
    weights = np.zeros((BATCH, n, n))
    for matrix in weights:
        links = random.random((n, n)) < random.choice([0.0, 0.3, 1.0])
        order = random.permutation(n)
        for k in range(1, n):
            links[order[k], order[random.integers(k)]] = True
        drawn = np.triu((links | links.T) * random.uniform(low, high, (n, n)), 1)
        matrix[...] = drawn + drawn.T
    return weights
