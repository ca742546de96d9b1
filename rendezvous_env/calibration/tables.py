"""Tables of bearings and poses as a SensorLog: columns, units, identifiers and clocks."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..suggestions import closest_match
from .log import Floats, Ints, Mask, SensorLog, Track, wrap

BEARING_COLUMNS = ("time", "observer", "target", "bearing")
"""Columns of a table of bearings; ``elevation`` is optional, a row without target is a frame in
which nothing was detected."""
POSE_COLUMNS = ("time", "robot", "x", "y", "heading")
"""Columns of a table of poses; ``z`` is optional. A robot with a single pose is a landmark."""
_FEW = 6  # identifiers that a message lists
_CLEARLY = 0.2  # ratio of the error to that in other units, below which the units are accepted
_SMALL = 0.03  # rad, of errors that no other unit could improve
_TOLERABLE = 0.5  # share of rows whose target may be unknown
_MANY_ROWS = 2000  # minimum number of rows to recognise units


class LogError(ValueError):
    """A log that cannot be used; the message names the place and the remedy."""


def from_tables(
    bearings: Any, poses: Any, *, source: str = "log", clock_offset: float = 0.0, **told: Any
) -> SensorLog:
    """A log of a table of bearings and a table of poses.

    Args:
        bearings: columns ``time`` s, ``observer``, ``target``, ``bearing`` rad, and optionally
            ``elevation`` rad: a mapping of names to arrays, a pandas DataFrame, a structured array,
            or rows of numbers in this order. A row with an empty target is a frame without
            detections.
        poses: columns ``time`` s, ``robot``, ``x``, ``y``, optionally ``z``, m, and ``heading``
            rad, likewise.
        source: name for messages.
        clock_offset: s, added to the times of bearings.
        told: further fields of the log.

    Raises:
        LogError: for missing columns, numbers that are not finite, unknown identifiers, and clocks
            that do not overlap; with the row and the remedy.
    """
    seen = _columns("bearings", bearings, BEARING_COLUMNS, "elevation", 5)
    truth = _columns("poses", poses, POSE_COLUMNS, "z", 6)
    names, tracks, n_robots = _tracks(truth, source)
    numbers = {name: number for number, name in enumerate(names)}
    observer, unknown_observers = _numbered(seen["observer"], numbers)
    target, unknown_targets = _numbered(seen["target"], numbers)
    time, bearing = (_finite(f"{source}: bearings", seen, key) for key in ("time", "bearing"))
    up = _finite(f"{source}: bearings", seen, "elevation") if "elevation" in seen else None
    empty = target == -1
    bad = ~np.isfinite(bearing) & ~empty
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise LogError(f"{source}: bearings, row {row + 1}: bearing is not a finite number")
    usable = (observer >= 0) & (target > -2)
    notes = _unknown(source, unknown_observers | unknown_targets, ~usable, names)
    log = SensorLog(
        names=names, tracks=tracks, n_robots=n_robots, observer=observer, target=target,
        time=time + clock_offset, bearing=np.where(empty, 0.0, bearing), elevation=up,
        source=source, notes=notes,
    )  # fmt: skip
    log = replace(log, **told) if told else log
    log = log.some(usable & ((observer != target) | empty))
    if empty.any() and log.frames == "auto":
        log = replace(log, frames="listed")
    return _in_order(_in_radians(_overlapping(log)))


def _columns(
    what: str, table: Any, wanted: Sequence[str], extra: str, with_extra: int
) -> dict[str, NDArray[Any]]:
    """Columns of a table by name."""
    kinds = getattr(getattr(table, "dtype", None), "names", None)
    names: Iterable[str] | None = kinds or getattr(table, "columns", None)
    if names is None and isinstance(table, Mapping):
        names = table.keys()
    if names is None:
        rows = np.asarray(table)
        order = list(wanted)
        if rows.ndim == 2 and rows.shape[1] == with_extra:
            order.insert(4, extra)
        if rows.ndim != 2 or rows.shape[1] != len(order):
            shape = f"rows of {', '.join(wanted)}"
            raise LogError(f"{what} has shape {rows.shape}; it must be {shape}, or named columns")
        return dict(zip(order, rows.T, strict=True))
    found = {str(name).strip().lower(): name for name in names}
    for name in wanted:
        if name not in found:
            near = closest_match(name, list(found), after=" ")
            listed = ", ".join(found)
            raise LogError(f"{what}: no column {name!r}; {near}columns are {listed}")
    kept = [name for name in (*wanted, extra) if name in found]
    columns = {name: np.asarray(table[found[name]]) for name in kept}
    sizes = {name: len(column) for name, column in columns.items()}
    if len(set(sizes.values())) > 1 or not all(sizes.values()):
        raise LogError(f"{what}: columns must have equal lengths of at least 1, got {sizes}")
    return columns


def _finite(what: str, columns: Mapping[str, NDArray[Any]], name: str) -> Floats:
    """A column of numbers; only bearings and elevations may lack some."""
    try:
        values = columns[name].astype(np.float64)
    except (TypeError, ValueError) as error:
        raise LogError(f"{what}: column {name!r} must hold numbers ({error})") from None
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad) and name not in ("bearing", "elevation"):
        row = int(bad[0]) + 1
        raise LogError(
            f"{what}, row {row}: {name} is {values[bad[0]]}; give a finite number or remove the row"
        )
    return values


def _identifier(value: Any) -> str:
    """An identifier as text: 3, 3.0 and "3" are equal; empty ones are ''."""
    if value is None:
        return ""
    if isinstance(value, float | np.floating):
        if np.isnan(value):
            return ""
        value = int(value) if float(value).is_integer() else value
    return str(value).strip()


def _texts(column: NDArray[Any]) -> NDArray[np.str_]:
    try:
        kinds, places = np.unique(column, return_inverse=True)
    except TypeError:  # of mixed types
        return np.array([_identifier(one) for one in column.tolist()])
    return np.array([_identifier(one) for one in kinds.tolist()])[places]


def _numbered(column: NDArray[Any], numbers: Mapping[str, int]) -> tuple[Ints, set[str]]:
    """Numbers of identifiers: −1 for an empty one, −2 for an unknown one; and the unknown."""
    texts = _texts(column)
    kinds, places = np.unique(texts, return_inverse=True)
    known = np.array([numbers.get(str(k), -1 if k == "" else -2) for k in kinds], np.int64)
    unknown = {str(kind) for kind, number in zip(kinds, known, strict=True) if number == -2}
    return known[places], unknown


def _tracks(
    poses: Mapping[str, NDArray[Any]], source: str
) -> tuple[tuple[str, ...], tuple[Track, ...], int]:
    """Names and tracks of robots, then of landmarks, and the number of robots."""
    what = f"{source}: poses"
    time, x, y, heading = (_finite(what, poses, key) for key in ("time", "x", "y", "heading"))
    z = _finite(what, poses, "z") if "z" in poses else np.zeros(len(x))
    place, robot = np.stack([x, y, z], axis=-1), _texts(poses["robot"])
    made: dict[str, Track] = {}
    for name in sorted(set(robot.tolist()), key=_natural):
        rows = np.flatnonzero(robot == name)
        _, first = np.unique(time[rows], return_index=True)
        rows = rows[first]
        made[name] = Track(time[rows], place[rows], heading[rows])
    robots = [name for name, track in made.items() if not track.is_static]
    if not robots:
        raise LogError(
            f"{what}: each robot has a single pose, so ground truth is missing; "
            "give poses over time of each robot"
        )
    names = (*robots, *(name for name in made if name not in robots))
    return names, tuple(made[name] for name in names), len(robots)


def _natural(name: str) -> tuple[int, float, str]:
    return (0, float(name), name) if name.replace(".", "", 1).isdigit() else (1, 0.0, name)


def _unknown(
    source: str, unknown: set[str], dropped: Mask, names: Sequence[str]
) -> tuple[str, ...]:
    """A note on rows with unknown identifiers; an error if most of them are."""
    if not unknown:
        return ()
    listed = ", ".join(sorted(unknown, key=_natural)[:_FEW]) + ", …" * (len(unknown) > _FEW)
    share = float(dropped.mean())
    told = f"{int(dropped.sum())} rows ({share:.1%}) have identifiers without poses: {listed}"
    if share > _TOLERABLE:
        known = ", ".join(names[:_FEW]) + ", …" * (len(names) > _FEW)
        raise LogError(f"{source}: {told}; poses are of {known}: use the same identifiers in both")
    return (f"{told}; dropped",)


def _overlapping(log: SensorLog) -> SensorLog:
    """The log relative to its first row; an error if bearings and poses do not overlap."""
    moving = log.tracks[: log.n_robots]
    first, last = min(t.time[0] for t in moving), max(t.time[-1] for t in moving)
    if not len(log.time):
        raise LogError(f"{log.source}: no bearing is left; give bearings of robots with poses")
    inside = (log.time >= first) & (log.time <= last)
    if not inside.any():
        begin, end = log.time.min(), log.time.max()
        raise LogError(
            f"{log.source}: bearings are from {begin:.3f} to {end:.3f} s and poses from "
            f"{first:.3f} to {last:.3f} s: the clocks differ, or ground truth is missing; give "
            f"both the same clock, or --clock-offset {first - begin:.3f} if they begin together"
        )
    origin = float(log.time.min())
    tracks = tuple(replace(t, time=t.time - origin) for t in log.tracks)
    return replace(log, time=log.time - origin, tracks=tracks, origin=origin)


def _in_radians(log: SensorLog) -> SensorLog:
    """The log with angles in rad, counter-clockwise; other units are recognised by the errors."""
    rows = np.flatnonzero(log.target >= 0)
    if not len(rows):
        raise LogError(f"{log.source}: no row has a target; there is nothing to fit")
    rows = rows[:: max(1, len(rows) // _MANY_ROWS)]
    measured = log.bearing[rows]
    true = log.truth(log.observer[rows], log.target[rows], log.time[rows])
    if not true.known.any():
        raise LogError(
            f"{log.source}: no bearing has ground truth of both robots at its time; give poses of "
            "all robots over the time of the log"
        )
    errors = {}
    for b, h in itertools.product((1.0, np.pi / 180.0), repeat=2):
        scaled = replace(log, tracks=_turned(log.tracks, h))
        found = scaled.truth(log.observer[rows], log.target[rows], log.time[rows])
        for sign in (1.0, -1.0):
            error = np.abs(wrap(sign * b * measured - found.bearing))[found.known]
            errors[sign * b, h] = float(np.median(error))
    best = min(errors, key=errors.__getitem__)
    if errors[1.0, 1.0] < _SMALL or errors[best] > _CLEARLY * errors[1.0, 1.0]:
        best = (1.0, 1.0)
    return _converted(log, *best)


def _converted(log: SensorLog, b: float, h: float) -> SensorLog:
    notes = []
    if b < 0.0:
        raise LogError(
            f"{log.source}: bearings agree with the poses if their sign is changed; give them "
            "counter-clockwise, as headings"
        )
    if b != 1.0:
        notes.append("bearings are in degrees; converted")
    if h != 1.0:
        notes.append("headings are in degrees; converted")
    bearing = b * log.bearing
    if np.abs(bearing).max() > np.pi * (1 + 1e-9):
        notes.append("bearings run beyond ±π; wrapped to −π … π")
    up = None if log.elevation is None else b * log.elevation
    tracks = _turned(log.tracks, h)
    return replace(log, bearing=wrap(bearing), elevation=up, tracks=tracks).noted(*notes)


def _turned(tracks: Sequence[Track], factor: float) -> tuple[Track, ...]:
    """Tracks with headings multiplied by a factor, then unwrapped."""
    return tuple(replace(t, heading=np.unwrap(factor * t.heading)) for t in tracks)


def _in_order(log: SensorLog) -> SensorLog:
    """Rows by observer and time."""
    order = np.lexsort((log.target, log.time, log.observer))
    up = None if log.elevation is None else log.elevation[order]
    return replace(
        log, observer=log.observer[order], target=log.target[order], time=log.time[order],
        bearing=log.bearing[order], elevation=up,
    )  # fmt: skip
