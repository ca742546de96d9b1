"""Frames of a sensor: rows of one time, the sample clock, and opportunities for detection."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from .log import Floats, Ints, Mask, SensorLog

_SAME = 0.3
"""Rows closer than this share of the sample period belong to one frame."""
_SINGLE = 1.7
"""Intervals of up to this many periods have no missing frame in between."""
_STEADY = 0.6
"""Largest spread of the phase of a regular clock, in periods."""
_WINDOW = 400
"""Number of frames in which a clock is searched."""
_HELD = 0.2
"""Share of repeated frames from which rows count as held between samples."""


class Frames(NamedTuple):
    """Frames of all observers, by observer and time."""

    observer: Ints  # (F,)
    time: Floats  # (F,), s
    row: Ints  # (N,), frame of each row of the log
    period: float  # time between successive frames, s
    regular: bool  # whether times follow a clock, so that empty frames are known
    complete: bool  # whether frames without detections are included
    held: bool  # whether rows were held between samples

    def interval(self) -> Floats:
        """Time since the observer's previous frame, (F,), s; ∞ for the first."""
        gap = np.diff(self.time, prepend=-np.inf)
        first = np.diff(self.observer, prepend=-1) != 0
        return np.where(first, np.inf, gap)


class Chances(NamedTuple):
    """Opportunities: a robot that could be detected in a frame, by pair and time."""

    observer: Ints  # (C,)
    target: Ints  # (C,)
    time: Floats  # (C,), s
    bearing: Floats  # (C,), rad, true
    distance: Floats  # (C,), m, true
    seen: Mask  # (C,)
    sure: Mask  # (C,), seen by a row that is no outlier
    follows: Mask  # (C,), whether the one before is of the same pair and the previous frame
    interval: Floats  # (C,), s since the previous frame

    def some(self, which: Mask) -> Chances:
        """The opportunities of a mask; ``follows`` requires that the one before is among them."""
        before = np.concatenate([[False], which[:-1]])
        kept: Any = [one[which] for one in self._replace(follows=self.follows & before)]
        return Chances(*kept)


def frames_by_stamp(log: SensorLog) -> Frames:
    """Frames of equal time stamps, as some evaluations count them."""
    frame_of, times, observers = _cluster(log, 0.0)
    period = float(np.median(np.diff(times)[np.diff(observers) == 0]))
    return Frames(observers, times, frame_of, period, False, False, False)


def find_frames(log: SensorLog) -> tuple[SensorLog, Frames]:
    """Frames of a log, and the log without repetitions of held rows."""
    log, frame_of, times, observers, held = _cluster_fresh(log)
    period, regular, filled = _clock(times, observers)
    complete = log.frames == "listed" or (log.frames == "auto" and regular)
    if log.frames == "auto" and regular:
        times, observers, frame_of = _fill(times, observers, frame_of, filled)
    made = Frames(observers, times, frame_of, period, regular, complete, held)
    return log, made


def _cluster_fresh(log: SensorLog) -> tuple[SensorLog, Ints, Floats, Ints, bool]:
    """Frames of rows, without those in which all rows are repeated."""
    frame_of, times, observers = _cluster(log)
    repeated = _repeated(log, frame_of, observers)
    # consecutive empty frames cannot be distinguished from held ones
    shown = np.bincount(frame_of[log.target >= 0], minlength=len(times)) > 0
    moving = _turning(log, frame_of, times, observers)
    share = repeated[shown & moving].mean() if (shown & moving).any() else 0.0
    if share < _HELD:
        return log, frame_of, times, observers, False
    log = log.some(~repeated[frame_of])
    if log.frames == "listed":
        log = replace(log, frames="auto").some(log.target >= 0)
    frame_of, times, observers = _cluster(log)
    return log, frame_of, times, observers, True


def _cluster(log: SensorLog, same: float = _SAME) -> tuple[Ints, Floats, Ints]:
    """Frame of each row, (N,), and time and observer of each frame, (F,)."""
    gap = np.diff(log.time, prepend=-np.inf)
    new = np.diff(log.observer, prepend=-1) != 0
    gap[new] = np.inf
    tiny = 1e-6
    usual = gap[np.isfinite(gap) & (gap > tiny)]
    for _ in range(2):  # the second time without intervals within a frame
        if len(usual):
            tiny = same * float(np.median(usual))
            usual = usual[usual > tiny]
    begins = new | (gap > tiny)
    frame_of = np.cumsum(begins) - 1
    return frame_of, log.time[begins], log.observer[begins]


def _repeated(log: SensorLog, frame_of: Ints, observers: Ints) -> Mask:
    """(F,), frames whose targets and bearings all equal those of the frame before."""
    count = len(observers)
    size = np.bincount(frame_of, minlength=count)
    first = np.searchsorted(frame_of, np.arange(count))
    same = np.zeros(count, np.bool_)
    same[1:] = (size[1:] == size[:-1]) & (observers[1:] == observers[:-1])
    rows = np.flatnonzero(same[frame_of])
    before = first[frame_of[rows] - 1] + (rows - first[frame_of[rows]])
    differs = (log.target[rows] != log.target[before]) | (log.bearing[rows] != log.bearing[before])
    same[np.unique(frame_of[rows[differs]])] = False
    return same


def _turning(log: SensorLog, frame_of: Ints, times: Floats, observers: Ints) -> Mask:
    """(F,), frames during whose interval a true bearing changed, so that rows should too."""
    known = np.flatnonzero(log.target >= 0)
    now = log.truth(log.observer[known], log.target[known], log.time[known])
    gap = np.diff(times, prepend=times[:1])
    then = log.truth(log.observer[known], log.target[known], log.time[known] - gap[frame_of[known]])
    moved = np.zeros(len(observers), np.bool_)
    changed = now.known & then.known & (np.abs(now.bearing - then.bearing) > 2e-3)
    moved[frame_of[known[changed]]] = True
    return moved


def _clock(times: Floats, observers: Ints) -> tuple[float, bool, dict[int, tuple[Ints, Floats]]]:
    """Sample period, whether the clock is regular, and each observer's ticks with their times."""
    gap = np.diff(times)[np.diff(observers) == 0]
    if not len(gap):
        return 0.0, False, {}
    median = float(np.median(gap))
    robots, counts = np.unique(observers, return_counts=True)
    period = _coherent(times[observers == robots[np.argmax(counts)]][:_WINDOW], gap)
    slopes, ticks = [], {}
    for robot, count in zip(robots.tolist(), counts.tolist(), strict=True):
        own = times[observers == robot]
        tick, slope, spread = _aligned(own, period)
        if spread > _STEADY * period or (np.diff(tick) < 1).any():
            return median, False, {}
        slopes.append((slope, count))
        ticks[robot] = (tick.astype(np.int64), own)
    mean = float(np.average([s for s, _ in slopes], weights=[n for _, n in slopes]))
    return mean, True, ticks


def _coherent(own: Floats, gap: Floats) -> float:
    """Period at which the phases of times are most alike, s.

    Samples at steps of a simulation have the same phases at an alias, which is shorter than the
    shortest intervals.
    """
    shortest, usual = np.quantile(gap, (0.01, 0.2)).tolist()
    rates = np.arange(1.0 / (1.45 * usual), 1.0 / (0.95 * shortest), 0.2 / max(np.ptp(own), usual))
    phase = np.exp(2j * np.pi * rates[:, None] * (own - own[0]))
    return float(1.0 / rates[np.argmax(np.abs(phase.mean(axis=1)))])


def _aligned(own: Floats, period: float) -> tuple[Floats, float, float]:
    """Ticks of times, their period and the spread of the times about them, s.

    The line through the times is fitted to more and more of them, so that the error of the period
    never adds up to half a tick.
    """
    slope, start, size = period, float(own[0]), 16
    tick = np.rint((own - start) / slope)
    while True:
        part = own[:size]
        if len(part) > 2 and part[-1] - part[0] > 4.0 * period:
            slope, start = (
                float(one) for one in np.polyfit(np.rint((part - start) / slope), part, 1)
            )
        tick = np.rint((own - start) / slope)
        if size >= len(own):
            break
        size *= 2
    return tick, slope, float(np.ptp(own - start - slope * tick))


def _fill(
    times: Floats, observers: Ints, frame_of: Ints, ticks: dict[int, tuple[Ints, Floats]]
) -> tuple[Floats, Ints, Ints]:
    """Times and observers of all frames of a regular clock, and the frame of each row."""
    all_times, all_observers, place = [], [], np.zeros(len(times), np.int64)
    offset = 0
    for robot in np.unique(observers):
        mine = np.flatnonzero(observers == robot)
        tick, own = ticks.get(int(robot), (np.arange(len(mine)), times[mine]))
        tick = tick - tick[0]
        every = np.arange(tick[-1] + 1)
        all_times.append(np.interp(every, tick, own))
        all_observers.append(np.full(len(every), robot))
        place[mine] = offset + tick
        offset += len(every)
    return np.concatenate(all_times), np.concatenate(all_observers), place[frame_of]


def find_chances(
    log: SensorLog, frames: Frames, delay: float, outlier: Mask | None = None
) -> Chances:
    """Opportunities of all robots in all frames, with the truth of a delay earlier.

    ``outlier`` marks rows of the log, (N,).
    """
    count, n = len(frames.time), log.n_robots
    seen = np.zeros((count, n), np.bool_)
    rows = log.robot_rows()
    seen[frames.row[rows], log.target[rows]] = True
    sure = np.zeros_like(seen)
    clean = rows if outlier is None else rows & ~outlier
    sure[frames.row[clean], log.target[clean]] = True
    frame, target = (
        grid.T.ravel() for grid in np.meshgrid(np.arange(count), np.arange(n), indexing="ij")
    )
    observer = frames.observer[frame]
    truth = log.truth(observer, target, frames.time[frame] - delay)
    kept = np.flatnonzero(truth.known & (observer != target))
    order = kept[np.lexsort((frame[kept], target[kept], observer[kept]))]
    frame, observer, target = frame[order], observer[order], target[order]
    follows = (np.diff(frame, prepend=-2) == 1) & (np.diff(target, prepend=-1) == 0)
    follows &= np.diff(observer, prepend=-1) == 0
    interval = frames.interval()[frame]
    follows &= interval < _SINGLE * frames.period
    return Chances(
        observer, target, frames.time[frame], truth.bearing[order], truth.distance[order],
        seen[frame, target], sure[frame, target], follows, interval,
    )  # fmt: skip
