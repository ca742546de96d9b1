"""Statistics of episodes: intervals, censored medians, paired comparisons."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.safety.tank import unit_of_tanks
from rendezvous_env.scenario.scenario import Scenario

from .evaluation import Episodes

CONFIDENCE = 0.95
RESAMPLES = 2000
"""Number of bootstrap resamples."""
_AT_ONCE = 10**7
"""Maximum number of values of simultaneous resamples."""

Interval = tuple[float, float]
_NONE: Interval = (np.nan, np.nan)
"""Interval of a single sample, or of a quantity that is not applicable."""


def fraction_interval(hits: NDArray[Any]) -> Interval:
    """Wilson interval of the mean of ``hits``, (N,), 0 or 1.

    Valid near 0 and 1, unlike the bootstrap. Undefined for a single sample and for NaN.
    """
    from scipy.stats import binomtest

    if len(hits) == 1 or np.isnan(hits).any():
        return _NONE
    test = binomtest(int(hits.sum()), len(hits))
    interval = test.proportion_ci(CONFIDENCE, method="wilson")
    return float(interval.low), float(interval.high)


def bootstrap_interval(
    samples: tuple[NDArray[Any], ...], statistic: Callable[..., Any]
) -> Interval:
    """Percentile bootstrap interval of a statistic of paired ``samples``, each (N,).

    Deterministic. Undefined for a single sample and for NaN.
    """
    from scipy.stats import bootstrap

    if len(samples[0]) == 1 or np.isnan(samples[0]).any():
        return _NONE
    result = bootstrap(
        samples,
        statistic,
        paired=True,
        vectorized=True,
        n_resamples=RESAMPLES,
        batch=max(1, _AT_ONCE // len(samples[0])),
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    interval = result.confidence_interval
    return float(interval.low), float(interval.high)


def paired_interval(values: NDArray[Any], least: float, most: float) -> Interval:
    """Interval of the mean of ``values``, (N,), which lie between ``least`` and ``most``.

    It is the bootstrap interval. If all values are equal, a fraction 1 − p may differ, with p the
    lower end of Wilson's interval for N of N.
    """
    if (values != values[0]).any():
        return bootstrap_interval((values,), np.mean)
    share, _ = fraction_interval(np.ones(len(values)))
    low, high = (float(share * values[0] + (1.0 - share) * end) for end in (least, most))
    return low, high


def censored_median(
    times: NDArray[np.float64], success: NDArray[np.bool_], limit: float
) -> tuple[float, Interval]:
    """Median of rendezvous times (N,), s, with time-outs censored, and its 95 % interval.

    A time-out ranks after every rendezvous. A median or interval end among the time-outs is
    ``limit`` and means: later than this.
    """

    def median(censored: NDArray[np.float64], axis: int = -1) -> Any:
        return np.minimum(np.median(censored, axis=axis), limit)

    censored = np.where(success, times, np.inf)
    value = float(median(censored))
    return value, bootstrap_interval((censored,), median)


def rounding_of_v(scenario: Scenario) -> float:
    """Largest increase of V attributed to rounding, m²/s: 10⁻⁹ r D̄."""
    return 1e-9 * unit_of_tanks(scenario)


def rounding_of_clearance(scenario: Scenario) -> float:
    """Largest clearance, a number, m, that counts as a contact: r/1000."""
    return 1e-3 * scenario.merge_radius


def summarise(scenario: Scenario, policy: str, episodes: Episodes) -> dict[str, Any]:
    """Row of results.csv, see ``results.RESULTS``; NaN if not applicable."""
    limit = scenario.max_steps * scenario.tau
    median, times = censored_median(episodes.time, episodes.success, limit)
    return {
        "scenario": scenario.name,
        "policy": policy,
        "episodes": len(episodes.success),
        "success": episodes.success.mean(),
        **_ends("success", fraction_interval(episodes.success)),
        "collision_free_success": episodes.collision_free.mean(),
        **_ends("collision_free", fraction_interval(episodes.collision_free)),
        "median_time": median,
        **_ends("time", times),
        "time_over_bound": np.fmax.reduce(episodes.time / episodes.time_bound),
        "path_length": np.median(episodes.path_length),
        "min_clearance": np.fmin.reduce(episodes.clearance),
        "max_rise_between_merges": episodes.max_rise_between_merges.max(),
        "min_alignment": np.fmin.reduce(episodes.min_alignment),
        "contacts": episodes.contacts.mean(),
    }


def _ends(name: str, interval: Interval) -> dict[str, float]:
    """Columns of an interval."""
    return {f"{name}_low": interval[0], f"{name}_high": interval[1]}


def best_policy(played: Mapping[str, Episodes]) -> str:
    """Policy with the most (collision-free) success; ties are broken by time."""
    return max(played, key=lambda name: (played[name].good.mean(), -np.median(played[name].time)))


def collision_free_difference(own: Episodes, other: Episodes) -> tuple[float, Interval]:
    """Paired difference of collision-free success and its 95 % interval; NaN without contacts."""
    difference = own.collision_free.astype(float) - other.collision_free
    return float(difference.mean()), paired_interval(difference, -1.0, 1.0)


def compare_pairs(
    scenario: str, played: Mapping[str, Episodes], against: str | None = None
) -> list[dict[str, Any]]:
    """Rows of paired.csv, see ``results.PAIRED``: every policy against a reference.

    The default reference is law (1), or else the best policy. Two failures tie.
    """
    against = against or ("bearing-only" if "bearing-only" in played else best_policy(played))
    # without success, an episode ranks after any rendezvous
    costs = {name: np.where(own.good, own.time, np.inf) for name, own in played.items()}
    rows = []
    for name in (name for name in played if name != against):
        difference, interval = collision_free_difference(played[name], played[against])
        better = (costs[name] < costs[against]) + 0.5 * (costs[name] == costs[against])
        rows.append(
            {
                "scenario": scenario,
                "policy": name,
                "against": against,
                "collision_free_difference": difference,
                **_ends("collision_free_difference", interval),
                "probability_of_improvement": better.mean(),
                **_ends("improvement", paired_interval(better, 0.0, 1.0)),
            }
        )
    return rows


def interquartile_mean(scores: NDArray[np.float64]) -> float:
    """Interquartile mean of scores (S, F), of S seeds and F scenarios.

    ``scipy.stats.trim_mean`` is too slow for a bootstrap.
    """
    quarter = scores.size // 4
    ordered = np.partition(scores, (quarter, scores.size - quarter - 1), axis=None)
    return float(ordered[quarter : scores.size - quarter].mean())


def stratified_interval(
    samples: tuple[NDArray[np.float64], ...], statistic: Callable[..., float]
) -> Interval:
    """Stratified percentile bootstrap interval of a statistic of ``samples``, (S, F) each.

    Resampling is independent per sample and scenario, and deterministic. Undefined for one seed.
    """
    if all(len(one) == 1 for one in samples):
        return _NONE
    rng = np.random.default_rng(0)

    def drawn(scores: NDArray[np.float64]) -> Any:
        chosen = rng.integers(len(scores), size=scores.shape)
        return np.take_along_axis(scores, chosen, axis=0)

    found = [statistic(*(drawn(one) for one in samples)) for _ in range(RESAMPLES)]
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(found, [tail, 100.0 - tail])
    return float(low), float(high)


def probability_of_improvement(own: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Probability that a run of scores (S, F) exceeds one of (S', F) on the same scenario.

    A tie counts one half.
    """
    above = (own[:, None] > other) + 0.5 * (own[:, None] == other)
    return float(above.mean(axis=(0, 1)).mean())


def performance_profile(
    scores: NDArray[np.float64], levels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Fraction of runs that reach each level, scenarios weighted equally: (L,) from (S, F)."""
    reached: NDArray[np.float64] = (scores[..., None] >= levels).mean(axis=(0, 1))
    return reached
