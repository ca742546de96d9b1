"""Who looks at whom, and how much: adversaries for graphs that are directed and switch."""

from __future__ import annotations

import numpy as np

from .flow_sights import outward
from .free_flow import Array, Mask, Sights, Teams

_EXACT = 1e6
_SHARPNESS = (0.0, 3.0, 30.0, _EXACT, _EXACT)
_REDRAWN = (0.0, 0.02, 0.3)
"""Chances that a team changes its likings at a call: fixed, switching, never the same."""


class Attention:
    """Shares with which each robot looks at the others, softmax of a score.

    A robot scores others by one of: how far outward they lie (who looks there makes the hull
    shrink slowest), how far or how near they are, whom it likes, or chance. Likings make cycles
    (pursuit in order), pairs (never connected at once), or neither, and change at random moments.

    Args:
        teams: who look.
        random: draws all that.
    """

    def __init__(self, teams: Teams, random: np.random.Generator) -> None:
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

    def __call__(self, teams: Teams, sights: Sights) -> Array:
        """(B, n, n), at least 0; each row that sees anyone sums to 1."""
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
