"""Adversarial teams in continuous time: initial positions, graphs and weights.

The graphs are directed and switch.
"""

from __future__ import annotations

import numpy as np
from continuous_time import Array, Batch, Bearings, Mask, outward

from train.verify.claims import BATCH
from train.verify.monitors import unit

_EXACT = 1e6
_SHARPNESS = (0.0, 3.0, 30.0, _EXACT, _EXACT)
_REDRAWN = (0.0, 0.02, 0.3)
"""Probability per call that a team changes its preferences: fixed, switching, always new."""


class Attention:
    """Weights of each robot's neighbours, as a softmax of scores.

    Scores are one of: distance outward (which makes the hull shrink slowest), distance, proximity,
    preference, or random. Preferences form cycles (pursuit in order), pairs (never connected at
    once), or neither, and change at random times.

    Args:
        teams: the environments.
        random: random number generator.
    """

    def __init__(self, teams: Batch, random: np.random.Generator) -> None:
        count, n = teams.active.shape
        self._random, self._shape = random, (count, n, n)
        kinds = random.integers(5, size=(count, n, 1))
        alike = random.random(count) < 0.5
        kinds[alike] = kinds[alike, :1]
        self._kinds = kinds
        self._sharpness = random.choice(_SHARPNESS, size=(count, 1, 1))
        self._redrawn = random.choice(_REDRAWN, size=count)
        later = (np.arange(n)[None] - np.arange(n)[:, None]) % n
        self._liking = np.broadcast_to(-later / n, self._shape).copy()
        cyclic = random.random(count) < 0.5
        in_order = cyclic & alike
        self._kinds[in_order], self._sharpness[in_order], self._redrawn[in_order] = 3, _EXACT, 0.0
        self._redraw(~cyclic)

    def _redraw(self, which: Mask) -> None:
        for team in np.flatnonzero(which):
            n = self._shape[1]
            liking = self._random.random((n, n))
            if self._random.random() < 0.5:
                order = self._random.permutation(n)
                first, second = order[: n // 2], order[n // 2 : 2 * (n // 2)]
                liking[first, second] = liking[second, first] = 2.0
            self._liking[team] = liking

    def __call__(self, teams: Batch, sights: Bearings) -> Array:
        """Weights (B, n, n), at least 0; each row with a visible neighbour sums to 1."""
        self._redraw(self._random.random(self._shape[0]) < self._redrawn)
        far = np.where(sights.present, sights.distances, 0.0)
        away = np.sum(outward(teams, sights)[:, :, None] * sights.bearings, axis=-1)
        scores = (away, far, -far, self._liking, self._random.random(self._shape))
        score = np.where(sights.present, np.choose(self._kinds, scores), -np.inf)
        best = score.max(axis=-1, keepdims=True, initial=-_EXACT)
        behind = np.subtract(score, best, out=np.zeros_like(best + score), where=sights.present)
        shares = np.exp(self._sharpness * behind)
        shares *= sights.present
        total = shares.sum(axis=-1, keepdims=True)
        return np.asarray(shares / np.where(total > 0, total, 1.0))


SIZES = (2, 3, 5, 7)
_EXTENT = 2.0
"""Extent of the initial positions, m."""
_RADII = (0.15, 0.3)
"""Merge radii r, m."""


def draw_teams(
    random: np.random.Generator,
    batch: int,
    dims: tuple[int, ...] = (2, 3),
    *,
    linked: bool = False,
    radii: tuple[float, float] = _RADII,
) -> Batch:
    """Sample teams in a square or a cube, on a regular polygon or on a line.

    The number of robots alternates between batches.

    Args:
        random: random number generator.
        batch: index of the batch.
        dims: dimensions to choose from.
        linked: whether only linked pairs of an undirected, connected graph can merge; else all can.
        radii: range of r, m.
    """
    n, dim = SIZES[batch % len(SIZES)], int(random.choice(dims))
    places = random.uniform(-_EXTENT / 2, _EXTENT / 2, (BATCH, n, dim))
    kind = random.random(BATCH)
    places[kind < 0.25] = _polygons(random, int(np.sum(kind < 0.25)), n, dim)
    on_a_line = kind > 0.9
    along = unit(random.normal(size=(BATCH, 1, dim)))
    places[on_a_line] = (places[..., :1] * along)[on_a_line]
    return Batch(places, random.uniform(*radii), draw_weights(random, n) if linked else None)


def draw_polygons(random: np.random.Generator, batch: int) -> Batch:
    """Sample regular polygons of 3 to 8 robots."""
    return Batch(_polygons(random, BATCH, 3 + batch % 6, 2), 0.1)


def _polygons(random: np.random.Generator, count: int, n: int, dim: int) -> Array:
    """Regular polygons in order, in any plane."""
    angle = 2 * np.pi * np.arange(n) / n + random.uniform(0, 2 * np.pi, (count, 1))
    flat = np.zeros((count, n, dim))
    flat[..., 0], flat[..., 1] = np.cos(angle), np.sin(angle)
    axes, _ = np.linalg.qr(random.normal(size=(count, dim, dim)))
    return np.asarray(_EXTENT / 2 * flat @ axes)


def draw_weights(random: np.random.Generator, n: int) -> Array:
    """Sample weights of BATCH connected undirected graphs, (B, n, n), m/s: trees plus links."""
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
