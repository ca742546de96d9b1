"""Page of figures of a fitted sensor, and figure of a replay."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rendezvous_env.calibration import SensorFit
from rendezvous_env.calibration.detection import Binned, binned, distance_edges, share_in_view
from rendezvous_env.calibration.measures import inner_angle
from rendezvous_env.checks import counted

from ..figures import style
from .replay import Replayed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

_MODEL = "#d55e00"
_DATA = "#0072b2"
_OTHER = "#009e73"


def write_fit(path: Path, fit: SensorFit) -> None:
    """Write the page of a fit as PDF or PNG."""
    style.save(fit_figure(fit), path)


@style.styled
def fit_figure(fit: SensorFit) -> Figure:
    """Errors, tails, autocorrelation, detection by distance and bearing, dwell times and delay."""
    figure = style.new_figure(style.PAGE, 8.4)
    axes = figure.subplots(4, 2)
    for draw, place in zip(_PANELS, axes.ravel(), strict=True):
        draw(place, fit)
    found = fit.estimates
    figure.suptitle(f"{found.log.source}: {counted(len(found.errors.error), 'bearing')} of robots")
    return figure


def _errors(axis: Axes, fit: SensorFit) -> None:
    found = fit.estimates
    level = found.noise.level.value
    wide = 6.0 * level
    x = np.linspace(-wide, wide, 400)
    inside = found.residual[np.abs(found.residual) < wide]
    axis.hist(inside, 80, density=True, color=_DATA, alpha=0.5, label="log")
    density = np.exp(-0.5 * (x / level) ** 2) / (level * np.sqrt(2.0 * np.pi))
    rate = found.outliers.rate.value
    axis.plot(x, (1.0 - rate) * density + rate / (2.0 * np.pi), color=_MODEL, label="fitted")
    _label(axis, "error (rad)", "density (1/rad)")


def _tails(axis: Axes, fit: SensorFit) -> None:
    from scipy import stats

    found = fit.estimates
    size = np.sort(np.abs(found.residual))
    share = 1.0 - np.arange(len(size)) / len(size)
    axis.plot(size, share, color=_DATA, label="log")
    x = np.geomspace(max(size[-1] * 1e-3, 1e-5), np.pi, 300)
    rate, level = found.outliers.rate.value, found.noise.level.value
    model = (1.0 - rate) * 2.0 * stats.norm.sf(x / level) + rate * (1.0 - x / np.pi)
    axis.plot(x, model, color=_MODEL, label="fitted")
    axis.set(xscale="log", yscale="log", ylim=(0.3 / len(size), 1.5), xlim=(x[0], 4.0))
    _plain_ticks(axis.xaxis, axis.yaxis)
    _label(axis, "absolute error (rad)", "share of larger errors")


def _correlation(axis: Axes, fit: SensorFit) -> None:
    found = fit.estimates.correlation
    axis.plot(found.lags, found.values, "o", color=_DATA, label="log")
    if len(found.lags):
        x = np.linspace(0.0, found.lags[-1], 200)
        time = found.time.value
        y = np.exp(-x / time) if time > 0.0 else np.where(x > 0.0, 0.0, 1.0)
        axis.plot(x, y, color=_MODEL, label="fitted")
    axis.set_ylim(-0.2, 1.05)
    _label(axis, "lag (s)", "autocorrelation of errors")


def _points(axis: Axes, found: Binned) -> None:
    half = 2.576 * np.sqrt(found.share * (1.0 - found.share) / found.number)
    axis.errorbar(found.middle, found.share, half, fmt="o", color=_DATA, label="log", lw=0.8)


def _by_distance(axis: Axes, fit: SensorFit) -> None:
    found = fit.estimates
    near = found.chances.some(np.abs(found.chances.bearing) < inner_angle(found))
    longest = float(near.distance.max(initial=1.0))
    _points(axis, binned(near.distance, near.seen, distance_edges(longest)))
    x = np.linspace(0.0, longest, 400)
    y = np.interp(x, found.view.nodes, [one.value for one in found.view.chance])
    axis.plot(x, np.where(x < found.view.min_range.value, 0.0, y), color=_MODEL, label="fitted")
    axis.set_ylim(-0.03, 1.03)
    _label(axis, "distance (m)", "share detected in view")


def _by_bearing(axis: Axes, fit: SensorFit) -> None:
    found = fit.estimates
    chances, view = found.chances, found.view
    far = chances.distance >= view.min_range.value
    wide = min(1.5 * view.half_field.value, np.pi)
    edges = np.linspace(-wide, wide, 41)
    _points(axis, binned(chances.bearing[far], chances.seen[far], edges))
    x = np.linspace(-wide, wide, 400)
    inside = far & (np.abs(chances.bearing) < inner_angle(found))
    level = float(chances.seen[inside].mean()) if inside.any() else 0.0
    share = share_in_view(x, view.half_field.value, view.falloff.value)
    axis.plot(x, level * share, color=_MODEL, label="fitted")
    axis.set_ylim(-0.03, 1.03)
    _label(axis, "bearing (rad)", "share detected")


def _dwell(axis: Axes, fit: SensorFit) -> None:
    memory = fit.estimates.memory
    stays = (memory.seen_again, 1.0 - memory.seen_after_miss)
    runs = (memory.runs_seen, memory.runs_missed)
    for lengths, stay, word, colour in zip(
        runs, stays, ("seen", "missed"), (_DATA, _OTHER), strict=True
    ):
        if not lengths:
            continue
        counts = np.bincount(np.minimum(lengths, 30))[1:]
        x = np.arange(1, len(counts) + 1)
        axis.plot(x, counts / counts.sum(), "o", color=colour, label=f"{word}, log")
        if np.isfinite(stay):
            axis.plot(x, (1.0 - stay) * stay ** (x - 1), color=colour, label=f"{word}, Markov")
    axis.set_yscale("log")
    _plain_ticks(axis.yaxis)
    _label(axis, "dwell time (frames)", "share of runs")


def _delay(axis: Axes, fit: SensorFit) -> None:
    scan = fit.estimates.scan
    if scan is not None:
        axis.plot(scan.delay, scan.spread, color=_DATA, label="log")
        axis.axvline(scan.best.value, color=_MODEL, label="fitted")
    _label(axis, "assumed delay (s)", "mean absolute error (rad)")


def _observers(axis: Axes, fit: SensorFit) -> None:
    found = fit.estimates
    robots = sorted(found.noise.observers)
    names = [found.log.names[robot] for robot in robots]
    levels = np.array([found.noise.observers[robot] for robot in robots]).reshape(-1, 3)
    x = np.arange(len(robots))
    low, high = levels[:, 0] - levels[:, 1], levels[:, 2] - levels[:, 0]
    axis.errorbar(x, levels[:, 0], (low, high), fmt="o", color=_DATA, label="noise")
    bias = [found.constant.observers.get(robot, np.nan) for robot in robots]
    axis.plot(x, bias, "s", color=_MODEL, label="constant error")
    axis.axhline(0.0, color="0.8", lw=0.6)
    axis.set_xticks(x, names)
    _label(axis, "observer", "angle (rad)")


_PANELS = (_errors, _tails, _correlation, _delay, _by_distance, _by_bearing, _dwell, _observers)


def _plain_ticks(*axes: Axis) -> None:
    """Numbers without mathematical text, which the style has turned off."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    for axis in axes:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def _label(axis: Axes, x: str, y: str) -> None:
    axis.set(xlabel=x, ylabel=y)
    handles, _ = axis.get_legend_handles_labels()
    if handles:
        axis.legend()


def write_replay(path: Path, found: Sequence[Replayed]) -> None:
    """Write the figure of a replay as PDF or PNG."""
    style.save(replay_figure(found), path)


@style.styled
def replay_figure(found: Sequence[Replayed]) -> Figure:
    """Shares of time, and distribution of the margin, by policy."""
    from .replay import summary

    figure = style.new_figure(style.PAGE, 2.6)
    left, right = figure.subplots(1, 2)
    rows = [summary(one) for one in found]
    start = np.zeros(len(rows))
    colours = {"decreases": _OTHER, "increases": _MODEL, "rests": "0.8"}
    words = {"decreases": "V falls", "increases": "V rises", "rests": "rests"}
    for key, colour in colours.items():
        share = np.array([row[key] for row in rows])
        left.barh(np.arange(len(rows)), share, left=start, color=colour, label=words[key])
        start += share
    left.set_yticks(np.arange(len(rows)), [one.policy for one in found])
    left.set_xlim(0.0, 1.0)
    left.invert_yaxis()
    left.set_xlabel("share of time")
    left.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    for one in found:
        margin: Any = np.sort(one.margin[np.isfinite(one.margin)])
        if len(margin):
            right.plot(margin, np.linspace(0.0, 1.0, len(margin)), label=one.policy)
    right.axvline(0.0, color="0.8", lw=0.6)
    _label(right, "margin: cosine of command and net bearing", "share of frames below")
    return figure
