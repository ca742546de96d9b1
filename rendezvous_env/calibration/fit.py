"""Sensor model of a log: estimates with intervals, measures, and the prediction of unseen rows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from .blocks import CONFIDENCE, DRAWS, Blocks
from .detection import DetectionMemory, View, find_memory, find_view
from .errors import (
    Constant,
    Correlation,
    DelayScan,
    Errors,
    Estimate,
    Noise,
    Outliers,
    centred,
    constant_errors,
    core_rows,
    correlation_time,
    errors_at,
    find_outliers,
    noise_level,
    robust_deviation,
    scan_delay,
)
from .frames import Chances, Frames, find_chances, find_frames
from .log import Floats, SensorLog
from .tables import LogError

_LEAST_ROWS = 50
_CLOCKS = 0.5  # s, delay from which a difference of clocks is reported
_FLAT = 0.01  # relative change of the spread below which a delay is not significant
_RAREST = 1e-6  # rate of outliers that is not distinguished from none
_FINEST = 1e-3  # rad, least scale of errors that may be outliers
_ZERO = Estimate(0.0, 0.0, 0.0)


class Estimates(NamedTuple):
    """All estimates of a log."""

    log: SensorLog
    frames: Frames
    errors: Errors
    residual: Floats  # (N,), rad, errors of robots without the constant errors of their pairs
    scale: Floats  # (N,), rad, noise of each row
    scan: DelayScan | None
    constant: Constant
    noise: Noise
    outliers: Outliers
    correlation: Correlation
    chances: Chances
    view: View
    memory: DetectionMemory
    sample_period: Estimate
    notes: tuple[str, ...]


def estimate(log: SensorLog, seed: int = 0, replicates: int = DRAWS) -> Estimates:
    """Estimate everything from a log.

    Raises:
        LogError: if too few rows have ground truth.
    """
    _check_size(log.source, int(log.robot_rows().sum()))
    log, frames = find_frames(log)
    blocks = Blocks(log.n_robots, log.duration, frames.period, seed, replicates)
    scan = scan_delay(log, blocks) if log.timed else None
    delay, notes = _delay(scan)
    every = errors_at(log, delay)
    robots = every.of_robots
    _check_size(log.source, int(robots.sum()))
    known = np.flatnonzero(every.known)
    mask = np.zeros(len(log.time), np.bool_)
    mask[known[robots]] = True
    errors = errors_at(log.some(mask), delay)
    residual, scale = _centred_and_scaled(errors)
    outliers = find_outliers(log, errors, residual, scale, delay)
    core = core_rows(residual, scale) & (outliers.share < 0.5)
    constant = constant_errors(errors, core, blocks)
    noise = noise_level(errors, residual, outliers.rate.value, blocks)
    correlation = Correlation(_ZERO, np.zeros(0), np.zeros(0))
    if log.timed:
        clean = outliers.share < 0.5
        correlation = correlation_time(errors, residual, scale, clean, frames.period, blocks)
    suspect = np.zeros(len(log.time), np.bool_)
    suspect[np.flatnonzero(mask)] = outliers.share > 0.5
    chances = find_chances(log, frames, delay, suspect)
    view = find_view(chances, blocks)
    memory = find_memory(chances, view, blocks)
    if not log.timed:
        memory = memory._replace(persistence=_ZERO)
    return Estimates(
        log, frames, errors, residual, scale, scan, constant, noise, outliers, correlation, chances,
        view, memory, _period(frames, blocks) if log.timed else _ZERO, notes,
    )  # fmt: skip


def _check_size(source: str, rows: int) -> None:
    """Raise a LogError for too few rows."""
    if rows < _LEAST_ROWS:
        raise LogError(
            f"{source}: {rows} bearings of robots have ground truth; a fit needs {_LEAST_ROWS} or "
            "more: give a longer log"
        )


def _delay(scan: DelayScan | None) -> tuple[float, tuple[str, ...]]:
    """Delay to correct, s, and notes about clocks."""
    if scan is None:
        return 0.0, ()
    flat = scan.spread.max() - scan.spread.min() < _FLAT * scan.spread.min()
    if flat:
        return 0.0, ("errors hardly depend on an assumed delay; it is set to 0",)
    delay = scan.best.value
    if abs(delay) > _CLOCKS:
        word = "late" if delay > 0 else "early"
        return delay, (
            f"bearings are {abs(delay):.2f} s {word} against the poses: the clocks may differ; "
            f"correct them with --clock-offset {-delay:.2f}, or use it as the sensor's delay",
        )
    return delay, ()


def _centred_and_scaled(errors: Errors) -> tuple[Floats, Floats]:
    """Errors about the median of their pair, and the robust deviation of their observer."""
    residual, _ = centred(errors.error, errors.pair())
    scale = np.full(len(residual), max(robust_deviation(residual), _FINEST))
    for robot in np.unique(errors.observer):
        rows = errors.observer == robot
        if rows.sum() >= 30:
            scale[rows] = max(robust_deviation(residual[rows]), _FINEST)
    return residual, scale


def _period(frames: Frames, blocks: Blocks) -> Estimate:
    """Time between samples, s."""
    gap = frames.interval()
    use = np.isfinite(gap)
    if frames.regular:
        # the phase stays within a period over the whole log
        ticks = max(float(np.sum(use)) / max(len(np.unique(frames.observer)), 1), 1.0)
        half = max(frames.period / ticks, 1e-4 * frames.period)
        return Estimate.around(frames.period, half, 0.0)
    if not use.any():
        return _ZERO
    steps, value = gap[use], frames.period
    draws = np.random.default_rng(0).integers(0, len(steps), (100, min(len(steps), 5000)))
    spread = np.median(steps[draws], axis=1).std() * math.sqrt(draws.shape[1] / len(steps))
    return Estimate.around(value, max(4.0 * float(spread), 0.001), 0.0)


@dataclass(frozen=True)
class SensorFit:
    """A fitted sensor model.

    ``parameters`` maps fields of Sensing to a value with its 99 % interval; ``fields`` are those of
    the Sensing that ``rv.Sensing(**fit.fields)`` makes.
    """

    estimates: Estimates
    parameters: dict[str, Estimate]
    fields: dict[str, Any]
    held_out: dict[str, float]
    """Prediction of the second half of the log by a fit of the first."""
    notes: tuple[str, ...]


def fit_sensor(log: SensorLog, *, per_robot: bool = False, seed: int = 0) -> SensorFit:
    """Fit the parameters of a sensor to a log.

    Args:
        log: bearings with ground truth.
        per_robot: one noise level for each robot, instead of a common one.
        seed: of the bootstrap.

    Raises:
        LogError: if too few rows have ground truth.
    """
    found = estimate(log, seed)
    parameters = _parameters(found)
    fields = _fields(found, parameters, per_robot)
    return SensorFit(
        found, parameters, fields, hold_out(log, seed), (*found.log.notes, *found.notes)
    )


def _parameters(found: Estimates) -> dict[str, Estimate]:
    """Estimates by the names of the fields of Sensing."""
    view, double = found.view, 2.0
    half = view.half_field
    delay = found.scan.best if found.scan is not None else _ZERO
    if found.notes and "hardly" in found.notes[0]:
        delay = Estimate(0.0, 0.0, delay.high)
    named = {
        "noise": found.noise.level,
        "noise_correlation": found.correlation.time,
        "bias": found.constant.bias,
        "observer_bias": found.constant.observer_bias,
        "outliers": found.outliers.rate,
        "min_range": view.min_range,
        "field_of_view": Estimate(*(double * one for one in half)),
        "view_falloff": view.falloff,
        "persistence": found.memory.persistence,
        "sample_period": found.sample_period,
        "delay_time": delay,
    }
    for node, chance in zip(view.nodes, view.chance, strict=True):
        named[f"detection[{node:.3g} m]"] = chance
    return named


def _fields(found: Estimates, parameters: dict[str, Estimate], per_robot: bool) -> dict[str, Any]:
    """Fields of Sensing, rounded to their accuracy."""
    scalar = {
        name: _rounded(one) for name, one in parameters.items() if not name.startswith("detection")
    }
    fields: dict[str, Any] = {name: value for name, value in scalar.items() if value > 0.0}
    if found.view.half_field.value >= math.pi:
        fields.pop("field_of_view", None)
        fields.pop("view_falloff", None)
    if parameters["outliers"].low < _RAREST:
        fields.pop("outliers", None)
    if found.outliers.kind == "robot" and "outliers" in fields:
        fields["outlier_kind"] = "robot"
    fields.update(_detection(found.view, len(found.chances.seen)))
    if per_robot:
        own, level = found.noise.observers, found.noise.level
        robots = range(found.log.n_robots)
        fields["noise"] = tuple(_rounded(own.get(robot, level)) for robot in robots)
    if not {"detection", "dropout", "view_falloff"} & fields.keys():
        fields.pop("persistence", None)
    if "noise" not in fields:
        fields.pop("noise_correlation", None)
    return fields


def _rounded(one: Estimate) -> float:
    """A value with two digits more than its interval, at most four significant ones."""
    return float(f"{max(one.value, 0.0):.4g}")


def _detection(view: View, count: int) -> dict[str, Any]:
    """A table of detection, a dropout if it is constant, or nothing if every robot is detected."""
    values = np.array([one.value for one in view.chance])
    if not count or (values > 0.995).all():
        return {}
    low = max(one.low for one in view.chance)
    high = min(one.high for one in view.chance)
    if low <= high:
        weight = np.array([1.0 / max(one.high - one.low, 1e-6) ** 2 for one in view.chance])
        return {"dropout": round(1.0 - float(np.average(values, weights=weight)), 4)}
    table = zip(view.nodes, values, strict=True)
    return {"detection": tuple((float(f"{r:.3g}"), round(float(p), 3)) for r, p in table)}


def hold_out(log: SensorLog, seed: int = 0) -> dict[str, float]:
    """Prediction of the second half of a log by a fit of the first half; empty if it is too short.

    ``error`` and ``predicted_error`` are robust deviations, rad, about the constant errors of the
    first half; ``within_95`` is the share of errors within 1.96 noise levels; the Brier scores are
    mean squared errors of the probability of detection, of the fit and of a constant.
    """
    half = 0.5 * log.duration
    first, second = log.time < half, log.time >= half
    try:
        fitted = estimate(log.some(first), seed, replicates=4)
        other = replace(log.some(second), notes=())
        other, frames = find_frames(other)
    except LogError:
        return {}
    delay = fitted.scan.best.value if fitted.scan is not None else 0.0
    errors = errors_at(other.some(other.robot_rows()), delay)
    if len(errors.error) < _LEAST_ROWS:
        return {}
    pairs = zip(errors.observer.tolist(), errors.target.tolist(), strict=True)
    constant = fitted.constant
    offset = np.array(
        [constant.pairs.get(pair, constant.observers.get(pair[0], 0.0)) for pair in pairs]
    )
    residual, level = errors.error - offset, fitted.noise.level.value
    chances = find_chances(other, frames, delay)
    p, seen = fitted.view.probability(chances), chances.seen.astype(np.float64)
    view = fitted.view.half_field.value
    visible = np.abs(chances.bearing) <= view
    base = float(fitted.chances.seen[np.abs(fitted.chances.bearing) <= view].mean())
    return {
        "rows": float(len(residual)),
        "error": robust_deviation(residual),
        "uncorrected_error": robust_deviation(errors.error),
        "predicted_error": level,
        "within_95": float((np.abs(residual) < 1.96 * level).mean()),
        "detection_brier": float(np.mean((seen - p)[visible] ** 2)),
        "detection_brier_constant": float(np.mean((seen - base)[visible] ** 2)),
    }


CONFIDENCE_LEVEL = CONFIDENCE
