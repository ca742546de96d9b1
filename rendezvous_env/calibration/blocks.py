"""Block bootstrap: blocks of one observer and a time span are sampled with replacement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .log import Floats, Ints

CONFIDENCE = 0.99
"""Confidence level of intervals, high because a dozen parameters are estimated."""
DRAWS = 120
_WIDER = 1.15
"""Factor on the spread of replicates, since blocks are not fully independent."""
_SPANS, _LONGEST, _SHORTEST = 40, 60.0, 4.0
"""Spans of time in a log, and their longest and shortest length, s."""


class Blocks:
    """Weights of blocks in bootstrap replicates.

    Args:
        observers: n, number of observers.
        duration: of the log, s.
        period: sample period, s; a span has at least 20.
        seed: of the draws.
        replicates: R, number of draws.
    """

    def __init__(
        self, observers: int, duration: float, period: float, seed: int, replicates: int = DRAWS
    ) -> None:
        self.replicates = replicates
        span = min(max(duration / _SPANS, _SHORTEST, 20.0 * period), _LONGEST)
        self.span = min(span, duration / 4.0) or 1.0
        self.spans = int(duration / self.span) + 1
        self.count = observers * self.spans
        self._random = np.random.default_rng(seed)

    def of(self, observer: Ints, time: Floats) -> Ints:
        """Block of each entry, by its observer and time."""
        inside = np.clip((time / self.span).astype(np.int64), 0, self.spans - 1)
        block: Ints = observer * self.spans + inside
        return block

    def sums(self, block: Ints, values: Floats) -> Floats:
        """Sums over the entries of each block: (count, ...) of values (N, ...)."""
        flat = values.reshape(len(values), -1)
        columns = [np.bincount(block, one, minlength=self.count) for one in flat.T]
        out = np.stack(columns, axis=-1).astype(np.float64)
        return out.reshape(self.count, *values.shape[1:])

    def draws(self, block: Ints) -> NDArray[np.float64]:
        """Weights of blocks in each replicate, (R, count); only blocks with entries count."""
        present = np.bincount(block, minlength=self.count) > 0
        used = np.flatnonzero(present)
        weights = np.zeros((self.replicates, self.count))
        share = np.full(len(used), 1.0 / max(len(used), 1))
        weights[:, used] = self._random.multinomial(len(used), share, size=self.replicates)
        return weights


def half_width(replicates: Floats, blocks_used: int) -> float:
    """Half the width of an interval, from the spread of the replicates, by Student's t."""
    from scipy import stats

    found = replicates[np.isfinite(replicates)]
    if len(found) < 2:
        return np.inf
    factor = stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(blocks_used - 1, 2))
    return float(_WIDER * factor * found.std(ddof=1))


def weighted_quantile(values: Floats, weights: Floats, share: float) -> float:
    """Quantile of values, (N,), sorted, with weights (N,)."""
    total = np.cumsum(weights)
    if not len(total) or total[-1] <= 0.0:
        return np.nan
    return float(values[min(np.searchsorted(total, share * total[-1]), len(values) - 1)])
