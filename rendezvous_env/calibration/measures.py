"""Plain measures of a log, and effects in it that the sensor model does not express."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from .detection import binned, distance_edges
from .errors import Errors, centred, errors_at, robust_deviation
from .fit import Estimates, SensorFit
from .frames import Chances, find_chances, frames_by_stamp
from .log import Floats, Mask, SensorLog

_BULK = 0.3  # rad, within which moments of errors are computed
_WRONG = 1.0  # rad, beyond which a bearing is attributed to another object
_SHARE_OF_VIEW = 0.875  # of half the field of view, within which detection by distance is counted
_STAMPS = 1.02  # stamps per frame from which measures by stamp are reported


def measures(fit: SensorFit) -> dict[str, Any]:
    """Measures of a log by their definitions, without a model.

    ``error_deviation_raw`` is the robust standard deviation of all errors at zero delay; the others
    have delay and constant errors removed.
    """
    found = fit.estimates
    log, errors = found.log, found.errors
    raw = errors_at(log.some(log.robot_rows()), 0.0)
    interval = found.frames.interval()
    interval = interval[np.isfinite(interval)]
    seen = log.bearing[log.robot_rows()]
    told: dict[str, Any] = {
        "rows_of_robots": len(errors.error),
        "rows_of_landmarks": int((log.target >= log.n_robots).sum()),
        "frames": len(found.frames.time),
        "duration": log.duration,
        "error_deviation_raw": robust_deviation(raw.error),
        "error_deviation": robust_deviation(found.residual),
        "share_above_1_rad": float((np.abs(raw.error) > _WRONG).mean()),
        "successive_correlation_raw": _successive(raw, found.frames.period),
        "bearing_quantiles": _quantiles(seen, (0.005, 0.995)),
        "frame_interval_quantiles": _quantiles(interval, (0.1, 0.5, 0.9)),
        "longest_gap": float(interval.max()) if len(interval) else 0.0,
        "observers": _observers(found),
        "pairs": _pairs(found),
        "pair_bias_deviation": _pair_deviation(found),
        "noise_by_distance": noise_by_distance(errors, found.residual),
        **_detection(found.chances, inner_angle(found)),
        "seen_again": found.memory.seen_again,
        "seen_after_miss": found.memory.seen_after_miss,
    }
    if not found.frames.complete and not found.frames.held:
        told.update(_by_stamp(found))
    return told


def inner_angle(found: Estimates) -> float:
    """Angle within which detection by distance is counted, rad."""
    return _SHARE_OF_VIEW * found.view.half_field.value


def _quantiles(values: Floats, shares: tuple[float, ...]) -> list[float]:
    return [float(one) for one in np.quantile(values, shares)] if len(values) else []


def _observers(found: Estimates) -> dict[str, dict[str, float]]:
    """Moments of the errors of each observer."""
    log, errors = found.log, found.errors
    every = errors_at(log, found.scan.best.value if found.scan else 0.0)
    told = {}
    for robot in np.unique(errors.observer).tolist():
        rows = errors.observer == robot
        bulk = found.residual[rows & (np.abs(errors.error) < _BULK)]
        variance = float(bulk.var()) or 1.0
        fixed = every.error[(every.observer == robot) & ~every.of_robots]
        told[log.names[robot]] = {
            "rows": int(rows.sum()),
            "bias": float(np.median(errors.error[rows])),
            "bias_of_all": float(np.median(every.error[every.observer == robot])),
            "bias_of_landmarks": float(np.median(fixed)) if len(fixed) else float("nan"),
            "deviation": robust_deviation(found.residual[rows]),
            "standard_deviation": float(bulk.std()),
            "kurtosis": float(((bulk - bulk.mean()) ** 4).mean() / variance**2),
        }
    return told


def _pairs(found: Estimates) -> dict[str, float]:
    names = found.log.names
    return {f"{names[i]} {names[j]}": value for (i, j), value in found.constant.pairs.items()}


def _pair_deviation(found: Estimates) -> float:
    values = list(found.constant.pairs.values())
    return float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")


def noise_by_distance(errors: Errors, residual: Floats) -> list[list[float]]:
    """Rows of least and largest distance, m, robust deviation, rad, and number of errors."""
    edges = distance_edges(float(errors.distance.max(initial=1.0)))
    told = []
    for low, high in pairwise(edges):
        rows = (errors.distance >= low) & (errors.distance < high)
        if rows.sum() >= 30:
            deviation = robust_deviation(residual[rows])
            told.append([float(low), float(high), deviation, int(rows.sum())])
    return told


def _successive(errors: Errors, period: float) -> float:
    """Correlation of successive errors of a pair, within the bulk."""
    rows = np.flatnonzero(np.abs(errors.error) < _BULK)
    order = rows[np.lexsort((errors.time[rows], errors.pair()[rows]))]
    pair, time, error = errors.pair()[order], errors.time[order], errors.error[order]
    gap = np.diff(time)
    use = (pair[1:] == pair[:-1]) & (gap > 0.5 * period) & (gap < 1.7 * period)
    if use.sum() < 10:
        return float("nan")
    error, _ = centred(error, pair)
    return float(np.corrcoef(error[1:][use], error[:-1][use])[0, 1])


def _detection(chances: Chances, inner: float) -> dict[str, list[list[float]]]:
    """Rows of low, high, share and opportunities: by distance within the view, and by bearing."""
    near = chances.some(np.abs(chances.bearing) < inner)
    edges = distance_edges(float(near.distance.max(initial=1.0)))
    angles = np.linspace(-np.pi, np.pi, 97)
    far = chances.distance > 0.8
    return {
        "detection_by_distance": binned(near.distance, near.seen, edges).rows(),
        "detection_by_bearing": binned(chances.bearing[far], chances.seen[far], angles).rows(),
    }


def _by_stamp(found: Estimates) -> dict[str, Any]:
    """Detection with a frame for each time stamp, where rows of one image have several."""
    frames = frames_by_stamp(found.log)
    if len(frames.time) < _STAMPS * len(found.frames.time):
        return {}
    chances = find_chances(found.log, frames, found.scan.best.value if found.scan else 0.0)
    inner = inner_angle(found)
    rows = chances.some(np.abs(chances.bearing) < inner)
    again, after = _follow(rows)
    table = _detection(chances, inner)["detection_by_distance"]
    return {
        "stamps": len(frames.time),
        "detection_by_distance_by_stamp": table,
        "seen_again_by_stamp": again,
        "seen_after_miss_by_stamp": after,
    }


def _follow(rows: Chances) -> tuple[float, float]:
    second = np.flatnonzero(rows.follows)
    a, b = rows.seen[second - 1], rows.seen[second]
    return float(b[a].mean()) if a.any() else 0.0, float(b[~a].mean()) if (~a).any() else 0.0


def unexpressed(fit: SensorFit) -> list[str]:
    """Effects in a log that the fitted model does not have, one sentence each."""
    found = fit.estimates
    told = [
        *_tails(found), *_noise_differences(fit), *_drift(found), *_clock(found),
        *_asymmetry(found), *_detection_differences(found), *_lens(found),
    ]  # fmt: skip
    told.append("Occlusion lowers the fitted probability of detection; it is not separated.")
    return told


def _tails(found: Estimates) -> list[str]:
    z = np.abs(found.residual / found.scale)
    clean = found.outliers.share < 0.5
    beyond = float((z[clean] > 3.0).mean())
    if beyond < 0.006:
        return []
    return [f"Heavy tails: {beyond:.1%} of errors exceed 3 standard deviations (normal: 0.3 %)."]


def _noise_differences(fit: SensorFit) -> list[str]:
    found, told = fit.estimates, []
    levels = [one for one in found.noise.observers.values()]
    common = found.noise.level.value
    if not isinstance(fit.fields.get("noise"), tuple) and any(
        one.low > common or one.high < common for one in levels
    ):
        low, high = min(one.value for one in levels), max(one.value for one in levels)
        told.append(f"Noise differs between observers: {low:.2g} to {high:.2g} rad (--per-robot).")
    rows = [row for row in noise_by_distance(found.errors, found.residual) if row[3] >= 100]
    values = [row[2] for row in rows]
    if values and max(values) > 1.5 * min(values):
        near, far = rows[int(np.argmin(values))], rows[int(np.argmax(values))]
        told.append(
            f"Noise depends on distance: {near[2]:.2g} rad at {near[0]:g} to {near[1]:g} m, "
            f"{far[2]:.2g} rad at {far[0]:g} to {far[1]:g} m."
        )
    return told


def _drift(found: Estimates) -> list[str]:
    lags, values = found.correlation.lags, found.correlation.values
    time = found.correlation.time.value
    if len(lags) < 3 or time <= 0.0:
        return []
    excess = values - np.exp(-lags / time)
    last = int(np.argmax(excess))
    if excess[last] < 0.1:
        return []
    return [
        f"Slow drift: the correlation of errors is still {values[last]:.2f} after "
        f"{lags[last]:.1f} s; one time constant gives {np.exp(-lags[last] / time):.2f}."
    ]


def _clock(found: Estimates) -> list[str]:
    gap = found.frames.interval()
    gap = gap[np.isfinite(gap)]
    if found.frames.regular or found.frames.complete or len(gap) < 10 or not found.log.timed:
        return []
    low, high = np.quantile(gap, (0.1, 0.9))
    return [
        f"Frames are irregular: 80 % of the intervals are {low:.2f} to {high:.2f} s, the longest "
        f"{gap.max():.0f} s. Probabilities are of frames with any detection."
    ]


def _asymmetry(found: Estimates) -> list[str]:
    half = found.view.half_field.value
    if half >= np.pi:
        return []
    seen = found.errors.true[found.outliers.share < 0.5]
    low, high = np.quantile(seen, (0.01, 0.99))
    if abs(low + high) < 0.1 * half:
        return []
    return [
        f"The field of view is not symmetric: 98 % of bearings are {low:.2f} to {high:.2f} rad."
    ]


def _detection_differences(found: Estimates) -> list[str]:
    chances = found.chances
    used: Mask = np.abs(chances.bearing) < inner_angle(found)
    expected = found.view.probability(chances)
    ratios = {}
    for robot in np.unique(chances.observer[used]).tolist():
        rows = used & (chances.observer == robot)
        if expected[rows].sum() > 50:
            ratios[robot] = float(chances.seen[rows].sum() / expected[rows].sum())
    if not ratios or max(ratios.values()) < 1.3 * min(ratios.values()):
        return []
    low, high = min(ratios.values()), max(ratios.values())
    return [f"Detection differs between observers: {low:.2f} to {high:.2f} of the fitted one."]


def _lens(found: Estimates) -> list[str]:
    half, errors = found.view.half_field.value, found.errors
    core = np.abs(found.residual) < 3.0 * found.scale
    if half >= np.pi or core.sum() < 200:
        return []
    slope = float(np.polyfit(errors.true[core], found.residual[core], 1)[0])
    if abs(slope) * half < 0.5 * found.noise.level.value:
        return []
    return [f"Errors depend on the bearing: {slope:+.3f} rad per rad."]


def summary(log: SensorLog) -> str:
    """One line about a log."""
    robots = int(log.robot_rows().sum())
    return (
        f"{robots} bearings between {log.n_robots} robots and {len(log.time) - robots} others, "
        f"{log.duration:.0f} s"
    )
