"""Errors of bearings: delay, constant errors, noise and its correlation, outliers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .blocks import Blocks, half_width, weighted_quantile
from .log import Floats, Ints, Mask, SensorLog, wrap

_NORMAL_MEDIAN = 0.6744897501960817
_CORE = 3.5
"""Errors beyond this many standard deviations do not enter means, and are clipped in products."""
_SCAN = np.arange(-1.0, 2.0001, 0.05)
"""Delays of the scan, s."""
_COARSE_ROWS, _FINE_ROWS = 3000, 20_000
SIGNIFICANT = 9.0
"""Twice the gain of log-likelihood from which an effect is accepted."""
_TAILS = (4.0, 8.0, 100.0)
"""Degrees of freedom of errors other than outliers; the most likely ones are used."""


class Estimate(NamedTuple):
    """A parameter with its interval."""

    value: float
    low: float
    high: float

    @classmethod
    def around(
        cls, value: float, half: float, low: float = -math.inf, high: float = math.inf
    ) -> Estimate:
        """An interval of a half-width about the value, within limits."""
        return cls(value, max(value - half, low), min(value + half, high))

    @classmethod
    def by_factor(cls, value: float, logarithms: Floats, used: int) -> Estimate:
        """An interval by a factor, from replicates of the logarithm."""
        factor = math.exp(min(half_width(logarithms, used), 50.0))
        return cls(value, value / factor, value * factor)


@dataclass(frozen=True)
class Errors:
    """Errors of N rows with ground truth."""

    observer: Ints
    target: Ints
    time: Floats
    error: Floats  # (N,), rad, counter-clockwise
    error_up: Floats | None  # (N,), rad, of elevation
    true: Floats  # (N,), rad, true bearing
    distance: Floats  # (N,), m
    known: Mask  # rows of the log that are in here
    robots: int  # n; targets from n on are landmarks

    @property
    def of_robots(self) -> Mask:
        """(N,), rows in which a robot is seen."""
        return self.target < self.robots

    def pair(self) -> Ints:
        """Number of the ordered pair of each row."""
        return self.observer * (int(self.target.max(initial=0)) + 1) + self.target


def errors_at(log: SensorLog, delay: float) -> Errors:
    """Errors of a log's rows, relative to the truth of a delay earlier."""
    rows = np.flatnonzero(log.target >= 0)
    found = log.truth(log.observer[rows], log.target[rows], log.time[rows] - delay)
    known = np.zeros(len(log.time), np.bool_)
    known[rows[found.known]] = True
    kept, rows = found.known, rows[found.known]
    up = None
    if log.elevation is not None:
        up = log.elevation[rows] - found.elevation[kept]
    error = wrap(log.bearing[rows] - found.bearing[kept])
    if up is not None:
        error = error * np.cos(found.elevation[kept])
    return Errors(
        log.observer[rows], log.target[rows], log.time[rows], error, up, found.bearing[kept],
        found.distance[kept], known, log.n_robots,
    )  # fmt: skip


def centred(error: Floats, pair: Ints) -> tuple[Floats, dict[int, float]]:
    """Errors without the median of their pair, and the medians."""
    medians = {int(one): float(np.median(error[pair == one])) for one in np.unique(pair)}
    lookup = np.zeros(int(pair.max(initial=0)) + 1)
    for one, median in medians.items():
        lookup[one] = median
    return error - lookup[pair], medians


def robust_deviation(values: Floats) -> float:
    """1.4826 times the median of the absolute deviations from the median."""
    if not len(values):
        return math.nan
    return float(np.median(np.abs(values - np.median(values))) / _NORMAL_MEDIAN)


class DelayScan(NamedTuple):
    """Spread of errors against assumed delays."""

    delay: Floats  # (D,), s
    spread: Floats  # (D,), rad: mean absolute error, clipped
    best: Estimate


def scan_delay(log: SensorLog, blocks: Blocks) -> DelayScan:
    """Delay at which errors about each pair's median are smallest, by their clipped mean."""
    spread = _losses(_thinned(log, _COARSE_ROWS), _SCAN)[0].mean(axis=0)
    best = float(_SCAN[np.argmin(spread)])
    fine = best + np.arange(-0.1, 0.1001, 0.01)
    losses, observer, time = _losses(_thinned(log, _FINE_ROWS), fine)
    block = blocks.of(observer, time)
    sums = blocks.sums(block, losses)
    draws = blocks.draws(block)
    found = np.array([_lowest(fine, one) for one in draws @ sums])
    value = _lowest(fine, sums.sum(axis=0))
    half = half_width(found, int((sums.sum(axis=-1) > 0).sum()))
    return DelayScan(_SCAN, spread, Estimate.around(value, half))


def _thinned(log: SensorLog, count: int) -> SensorLog:
    """A log of at most that many rows, evenly spaced."""
    step = -(-len(log.time) // count)
    return log.some(np.arange(len(log.time)) % step == 0) if step > 1 else log


def _losses(log: SensorLog, delays: Floats) -> tuple[Floats, Ints, Floats]:
    """Clipped absolute errors (N, D) of rows known at all delays, with observers and times."""
    ends = [errors_at(log, float(delay)) for delay in (delays[0], delays[-1])]
    log = log.some(ends[0].known & ends[1].known)
    every = [errors_at(log, float(delay)) for delay in delays]
    both = np.logical_and.reduce([one.known for one in every])
    if not both.all():
        log = log.some(both)
        every = [errors_at(log, float(delay)) for delay in delays]
    error = np.stack([centred(one.error, one.observer)[0] for one in every], axis=-1)
    limit = _CORE * min(robust_deviation(column) for column in error.T)
    return np.minimum(np.abs(error), max(limit, 1e-9)), every[0].observer, every[0].time


def _lowest(x: Floats, y: Floats) -> float:
    """Minimum of a parabola through the lowest point and its neighbours."""
    k = int(np.clip(np.argmin(y), 1, len(x) - 2))
    a, b, c = y[k - 1], y[k], y[k + 1]
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend > 0.0 else 0.0
    return float(x[k] + np.clip(shift, -1.0, 1.0) * (x[k] - x[k - 1]))


def most_likely(times: Floats, gain: Floats, block: Ints, blocks: Blocks) -> Estimate | None:
    """Time constant of maximum likelihood, s; None if it is not significant.

    ``gain`` are log-likelihood ratios to independence, (N, len(times)), of entries in blocks (N,).
    """
    sums = blocks.sums(block, gain)
    total = sums.sum(axis=0)
    if 2.0 * total.max() < SIGNIFICANT:
        return None
    steps = np.log(times)
    found = np.array([_lowest(steps, -one) for one in blocks.draws(block) @ sums])
    value = math.exp(_lowest(steps, -total))
    return Estimate.by_factor(value, found, len(np.unique(block)))


class Constant(NamedTuple):
    """Constant errors of pairs and observers."""

    pairs: dict[tuple[int, int], float]  # rad
    observers: dict[int, float]  # rad, expected value
    bias: Estimate  # rad, standard deviation of pairs
    observer_bias: Estimate  # rad, standard deviation of observers


def constant_errors(errors: Errors, core: Mask, blocks: Blocks) -> Constant:
    """Standard deviations of constant errors, and the errors, by maximum likelihood.

    The mean error of a pair is oᵢ + pᵢⱼ + eᵢⱼ, where e has the variance of the block bootstrap.
    """
    means, variances, groups, keys = [], [], [], []
    block = blocks.of(errors.observer, errors.time)
    for i in np.unique(errors.observer):
        for j in np.unique(errors.target[errors.observer == i]):
            rows = (errors.observer == i) & (errors.target == j) & core
            if rows.sum() < 10:
                continue
            used = block[rows]
            sums = blocks.sums(used, np.stack([errors.error[rows], np.ones(rows.sum())], axis=-1))
            drawn = blocks.draws(used) @ sums
            means.append(float(errors.error[rows].mean()))
            spread = float(np.var(drawn[:, 0] / np.maximum(drawn[:, 1], 1e-9)))
            count = len(np.unique(used))
            floor = float(errors.error[rows].var()) / rows.sum()
            variances.append(max(spread * (1.0 + 2.0 / max(count - 1, 1)), floor))
            groups.append(int(i))
            keys.append((int(i), int(j)))
    y, v, g = np.array(means), np.maximum(variances, 1e-14), np.array(groups)
    if len(y) < 2:
        none = Estimate(0.0, 0.0, math.inf)
        return Constant(dict(zip(keys, means, strict=True)), {}, none, none)
    bias, observer_bias = _components(y, v, g)
    observers = {
        int(i): _expected(y[g == i], v[g == i], bias.value, observer_bias.value)
        for i in np.unique(g)
    }
    return Constant(dict(zip(keys, means, strict=True)), observers, bias, observer_bias)


def _expected(y: Floats, v: Floats, bias: float, observer_bias: float) -> float:
    """Expected error of an observer, given the means of its pairs."""
    weight = 1.0 / (v + bias**2 + 1e-18)
    return float((weight * y).sum() / (weight.sum() + 1.0 / (observer_bias**2 + 1e-18)))


def _components(y: Floats, v: Floats, g: Ints) -> tuple[Estimate, Estimate]:
    """Standard deviations within and between groups, with profile-likelihood intervals."""
    scale = float(np.sqrt(np.mean(y**2)))
    levels = np.concatenate([[0.0], scale * np.geomspace(0.01, 12.0, 90)])
    pair, common = np.meshgrid(levels, levels, indexing="ij")
    total = np.zeros_like(pair)
    for group in np.unique(g):
        own, noise = y[g == group], v[g == group]
        spread = pair[..., None] ** 2 + noise
        weight, between = (1.0 / spread).sum(axis=-1), common**2
        inner = (own / spread).sum(axis=-1)
        total -= 0.5 * (np.log(spread).sum(axis=-1) + np.log1p(between * weight))
        total -= 0.5 * (
            (own**2 / spread).sum(axis=-1) - between * inner**2 / (1.0 + between * weight)
        )
    best = np.unravel_index(np.argmax(total), total.shape)
    found = []
    for axis, place in enumerate(best):
        profile = total.max(axis=1 - axis)
        within = levels[profile > profile.max() - 5.5]
        found.append(Estimate(float(levels[place]), float(within[0]), float(within[-1])))
    return found[0], found[1]


def core_rows(error: Floats, scale: Floats) -> Mask:
    """Rows that are not far outside the bulk."""
    return np.abs(error) < _CORE * scale


class Noise(NamedTuple):
    """Standard deviation of errors about the constant error of their pair."""

    level: Estimate  # rad
    observers: dict[int, Estimate]  # rad


def noise_level(errors: Errors, residual: Floats, outliers: float, blocks: Blocks) -> Noise:
    """Robust standard deviations: the median absolute error, less what outliers add to it."""
    size = np.abs(residual) if errors.error_up is None else np.hypot(residual, errors.error_up)
    every = _level(size, blocks.of(errors.observer, errors.time), outliers, blocks)
    own = {}
    for robot in np.unique(errors.observer):
        rows = errors.observer == robot
        if rows.sum() >= 30:
            block = blocks.of(errors.observer[rows], errors.time[rows])
            own[int(robot)] = _level(size[rows], block, outliers, blocks)
    return Noise(every, own)


def _level(size: Floats, block: Ints, outliers: float, blocks: Blocks) -> Estimate:
    order = np.argsort(size)
    size, block = size[order], block[order]
    share = 0.5 * (1.0 - outliers)
    value = weighted_quantile(size, np.ones(len(size)), share) / _NORMAL_MEDIAN
    draws = blocks.draws(block)
    found = np.array([weighted_quantile(size, one[block], share) for one in draws])
    half = half_width(found / _NORMAL_MEDIAN, len(np.unique(block)))
    return Estimate.around(value, half, 0.0)


class Outliers(NamedTuple):
    """Rate of outliers and their kind."""

    rate: Estimate
    kind: str  # "uniform" or "robot"
    share: Floats  # (N,), probability that a row is one


def find_outliers(
    log: SensorLog, errors: Errors, residual: Floats, scale: Floats, delay: float
) -> Outliers:
    """Mixture of errors with Student tails and of outliers, uniform or another robot's bearing."""
    z = residual / scale
    uniform = np.full(len(z), 0.5 / math.pi)
    found = []
    for tail in _TAILS:
        core = _student(z, tail) / scale
        found.append(("uniform", *_mixture(core, uniform)))
        other = _others(log, errors, residual, scale, delay, tail)
        found.append(("robot", *_mixture(core, other)))
    kind, rate, _, share = max(found, key=lambda one: one[2])
    return Outliers(_binomial(rate, len(z)), kind, share)


def _student(z: Floats, tail: float) -> Floats:
    """Density of Student's t with the median absolute value of a normal distribution."""
    from scipy import stats

    factor = stats.t.ppf(0.75, tail) / _NORMAL_MEDIAN
    return stats.t.pdf(z * factor, tail) * factor


def _others(
    log: SensorLog, errors: Errors, residual: Floats, scale: Floats, delay: float, tail: float
) -> Floats:
    """Density of an error if the bearing is that of another robot, drawn uniformly."""
    total, count = np.zeros(len(residual)), np.zeros(len(residual))
    for other in range(log.n_robots):
        which = np.full(len(residual), other)
        truth = log.truth(errors.observer, which, errors.time - delay)
        use = truth.known & (errors.target != other) & (errors.observer != other)
        offset = wrap(residual + errors.true - truth.bearing)
        total += np.where(use, _student(offset / scale, tail) / scale, 0.0)
        count += use
    return total / np.maximum(count, 1.0)


def _mixture(core: Floats, other: Floats) -> tuple[float, float, Floats]:
    """Rate, log-likelihood and posterior of the second density, by expectation maximisation."""
    rate = 0.01
    share = np.zeros(len(core))
    for _ in range(200):
        mixed = (1.0 - rate) * core + rate * other
        share = rate * other / np.maximum(mixed, 1e-300)
        new = float(share.mean())
        if abs(new - rate) < 1e-7:
            break
        rate = new
    mixed = (1.0 - rate) * core + rate * other
    return rate, float(np.log(np.maximum(mixed, 1e-300)).sum()), share


def _binomial(rate: float, count: int) -> Estimate:
    """Clopper–Pearson interval."""
    from scipy import stats

    k = rate * count
    low = stats.beta.ppf(0.005, k, count - k + 1.0) if k > 1e-9 else 0.0
    high = stats.beta.ppf(0.995, k + 1.0, max(count - k, 1e-9))
    return Estimate(rate, float(low), float(high))


class Correlation(NamedTuple):
    """Time constant of errors."""

    time: Estimate  # s; 0 is white
    lags: Floats  # (L,), s
    values: Floats  # (L,), autocorrelation


def correlation_time(
    errors: Errors, residual: Floats, scale: Floats, core: Mask, period: float, blocks: Blocks
) -> Correlation:
    """Time constant of an AR(1) process, by maximum likelihood of successive errors of a pair."""
    z = np.clip(residual / scale, -_CORE, _CORE)
    z = z / max(float(z[core].std()), 1e-12) if core.any() else z
    lags, values = _autocorrelation(errors, z, core, period)
    first, second, gap = _successive(errors, core, 5.5 * period)
    white = Correlation(Estimate(0.0, 0.0, 0.5 * period), lags, values)
    if len(first) < 50:
        return white
    times = period * np.geomspace(0.1, 60.0, 121)
    rho = np.exp(-gap[:, None] / times)
    rest = 1.0 - rho**2
    a, b = z[first][:, None], z[second][:, None]
    gain = -0.5 * np.log(rest) - 0.5 * (b - rho * a) ** 2 / rest + 0.5 * b**2
    found = most_likely(times, gain, blocks.of(errors.observer[first], errors.time[first]), blocks)
    return white if found is None else Correlation(found, lags, values)


def _successive(errors: Errors, core: Mask, longest: float) -> tuple[Ints, Ints, Floats]:
    """Rows of successive errors of a pair, and the times between them, s."""
    rows = np.flatnonzero(core)
    order = rows[np.lexsort((errors.time[rows], errors.pair()[rows]))]
    first, second = order[:-1], order[1:]
    gap = errors.time[second] - errors.time[first]
    use = (errors.pair()[first] == errors.pair()[second]) & (gap < longest) & (gap > 0.0)
    return first[use], second[use], gap[use]


def _autocorrelation(errors: Errors, z: Floats, core: Mask, period: float) -> tuple[Floats, Floats]:
    """Autocorrelation at multiples of the period."""
    rows = np.flatnonzero(core)
    order = rows[np.lexsort((errors.time[rows], errors.pair()[rows]))]
    pair, time, x = errors.pair()[order], errors.time[order], z[order]
    sums, counts = np.zeros(13), np.zeros(13)
    for step in range(1, 13):
        gap = time[step:] - time[:-step]
        lag = np.rint(gap / max(period, 1e-9))
        use = (pair[step:] == pair[:-step]) & (lag >= 1) & (lag <= 12)
        use &= np.abs(gap - lag * period) < 0.3 * period
        np.add.at(sums, lag[use].astype(int), (x[step:] * x[:-step])[use])
        np.add.at(counts, lag[use].astype(int), 1.0)
    good = counts > 20
    variance = float(np.mean(x**2)) if len(x) else 1.0
    lags = period * np.flatnonzero(good).astype(np.float64)
    return lags, sums[good] / counts[good] / (variance or 1.0)
