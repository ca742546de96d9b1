"""A log of bearings with ground truth, and the true bearings at its times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
_GAPS = 5.0
"""Ground truth is interpolated over gaps of up to this many intervals, and at least MIN_GAP."""
_MIN_GAP = 0.5  # s


def wrap(angle: Floats) -> Floats:
    """Angles, rad, from −π to π."""
    return angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))


@dataclass(frozen=True)
class Track:
    """Ground truth of a robot over time, or of a landmark, which has one pose."""

    time: Floats  # (T,), s, increasing
    position: Floats  # (T, 3), m; z is 0 in the plane
    heading: Floats  # (T,), rad, unwrapped

    @property
    def is_static(self) -> bool:
        """True for a landmark."""
        return len(self.time) == 1

    @cached_property
    def max_gap(self) -> float:
        """Longest gap over which poses are interpolated, s."""
        return max(_MIN_GAP, _GAPS * float(np.median(np.diff(self.time))))

    def at(self, time: Floats) -> tuple[Floats, Floats, Mask]:
        """Positions (N, 3), headings (N,) and whether they are known (N,) at times (N,)."""
        if self.is_static:
            count = len(time)
            place = np.broadcast_to(self.position[0], (count, 3))
            return place, np.full(count, self.heading[0]), np.ones(count, np.bool_)
        after = np.clip(np.searchsorted(self.time, time), 1, len(self.time) - 1)
        before = after - 1
        start, gap = self.time[before], self.time[after] - self.time[before]
        share = np.clip((time - start) / gap, 0.0, 1.0)
        heading = self.heading[before] + share * (self.heading[after] - self.heading[before])
        first = self.position[before]
        place = first + share[:, None] * (self.position[after] - first)
        inside = (time >= self.time[0]) & (time <= self.time[-1])
        return place, heading, inside & (gap <= self.max_gap)


class Truth(NamedTuple):
    """True bearings of N pairs of observer and target."""

    bearing: Floats  # (N,), rad, in the observer's frame
    elevation: Floats  # (N,), rad
    distance: Floats  # (N,), m
    known: Mask  # (N,)


@dataclass(frozen=True)
class SensorLog:
    """Bearings of N rows, with ground truth of all robots and landmarks.

    Robots have numbers 0 to n − 1, landmarks follow. Times are s since ``origin``.
    """

    names: tuple[str, ...]
    """Identifiers of robots and landmarks in the log."""
    tracks: tuple[Track, ...]
    """Ground truth of each."""
    n_robots: int
    """n, number of robots."""
    observer: Ints
    """(N,), number of the robot that measures."""
    target: Ints
    """(N,), number of the robot or landmark that is seen; −1 in a frame without detections."""
    time: Floats
    """(N,), s."""
    bearing: Floats
    """(N,), rad, counter-clockwise from the observer's x axis."""
    elevation: Floats | None = None
    """(N,), rad, in 3-D."""
    source: str = "log"
    """File or folder of the log."""
    origin: float = 0.0
    """Time of the clock at which the log begins, s."""
    frames: str = "auto"
    """"detected": only frames with a detection count; "listed": all frames are rows; "auto": frames
    without detections are inferred from a regular clock."""
    timed: bool = True
    """False if times only number the rows, so that nothing that depends on time is estimated."""
    notes: tuple[str, ...] = ()
    """Notes about findings and corrections while reading."""

    @property
    def dim(self) -> int:
        """Dimension, 2 or 3."""
        return 2 if self.elevation is None else 3

    @property
    def duration(self) -> float:
        """Time between the first and the last row, s."""
        return float(np.ptp(self.time)) if len(self.time) else 0.0

    def some(self, rows: Mask) -> SensorLog:
        """The log of some rows."""
        up = None if self.elevation is None else self.elevation[rows]
        return replace(
            self, observer=self.observer[rows], target=self.target[rows], time=self.time[rows],
            bearing=self.bearing[rows], elevation=up,
        )  # fmt: skip

    def noted(self, *notes: str) -> SensorLog:
        """The log with further notes."""
        return replace(self, notes=(*self.notes, *(n for n in notes if n not in self.notes)))

    def truth(self, observer: Ints, target: Ints, time: Floats) -> Truth:
        """True bearings and distances of pairs at times, (N,) each."""
        here, heading, known = self._poses(observer, time)
        there, _, also = self._poses(target, time)
        offset = there - here
        flat = np.hypot(offset[:, 0], offset[:, 1])
        bearing = wrap(np.arctan2(offset[:, 1], offset[:, 0]) - heading)
        elevation = np.arctan2(offset[:, 2], flat)
        height = offset[:, 2] if self.dim == 3 else 0.0
        return Truth(bearing, elevation, np.hypot(flat, height), known & also)

    def _poses(self, which: Ints, time: Floats) -> tuple[Floats, Floats, Mask]:
        place, heading = np.zeros((len(time), 3)), np.zeros(len(time))
        known = np.zeros(len(time), np.bool_)
        for number in np.flatnonzero(np.bincount(which[which >= 0], minlength=1)):
            rows = np.flatnonzero(which == number)
            place[rows], heading[rows], known[rows] = self.tracks[number].at(time[rows])
        return place, heading, known

    def robot_rows(self) -> Mask:
        """(N,), rows in which a robot is seen."""
        return (self.target >= 0) & (self.target < self.n_robots)
