"""Compact text encoding of recordings: 16-bit rounding, time differences, gzip, base64.

A recording of 400 frames of 20 robots has a hundredth of its size as JSON. In the plane an
observation row is stored as length and angle. The angle of a neighbour row is relative to the true
bearing, which makes it nearly 0 for exact sensors.
"""

import base64
import gzip
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.obstacles.obstacle_set import outlines
from rendezvous_env.render.scene import outermost

from .recording import Recording

LARGEST = 32767
"""Largest rounded value; the value below its negative encodes NaN."""

BUDGET = 3_500_000
"""Maximum total size of the recordings of a page, characters; larger ones are subsampled."""

ANGLE = 2 * np.pi / 2**16
"""Unit of a 16-bit angle, rad; angles wrap around as integers do."""
_DIGITS = 6  # for lengths, in addition to the largest one
_COARSE = 4
"""Stored angles are multiples of this number of units, which is finer than visible."""

_EXACT = ("times", "lyapunov", "lyapunov_before_merge", "lyapunov_after_merge", "contacts")
_ROUNDED = ("positions", "frames", "alignment")
_MARKS = ("active", "conditions")
_KEPT = ("active", "observations", *_EXACT, *_ROUNDED)


@dataclass(frozen=True)
class Encoded:
    """Encoded recording, as read by the page."""

    fields: list[list[Any]]
    """Per array: name, type ("float32", "uint8" or "int16"), shape, and scale of an int16 (value =
    scale · integer). In the plane, "lengths" and "angles" replace the observations."""
    text: str
    """All arrays, little-endian, gzip and base64."""
    stride: int  # recorded frames are thinned to every stride-th, except merges and the end
    extent: list[list[float]]  # of robots and obstacles, minimum and maximum of each axis, m
    obstacles: list[dict[str, Any]]  # centre, radius, vertices, m


def encode_all(recordings: Sequence[Recording], budget: int | None = None) -> list[Encoded]:
    """Encode recordings; subsample the largest if they exceed a budget (default BUDGET)."""
    found = [encode(recording) for recording in recordings]
    left, share = budget or BUDGET, np.inf
    sizes = sorted(len(encoded.text) for encoded in found)
    for count, size in zip(range(len(sizes), 0, -1), sizes, strict=True):
        if size * count > left:
            share = left / count  # maximum size of each
            break
        left -= size
    for number, recording in enumerate(recordings):
        while len((one := found[number]).text) > share and one.stride < len(recording["times"]):
            excess = math.ceil(math.log2(len(one.text) / share))
            found[number] = encode(recording, one.stride * 2**excess)
    return found


def encode(recording: Recording, stride: int = 1) -> Encoded:
    """Encode every stride-th frame of a recording, every merge and the last frame."""
    table, dim = recording["obstacles"], recording["positions"].shape[-1]
    points = outermost(recording["positions"], table)
    shapes, offsets = outlines(table, dim), _offsets_of_outlines(recording, dim)
    if offsets is not None:
        ends = [
            one.centre + sign * one.radius + offsets[:, k]
            for k, one in enumerate(shapes)
            for sign in (-1.0, 1.0)
        ]
        points = np.concatenate([points, *ends])
    stays = ~np.isnan(recording["lyapunov_before_merge"])
    stays[::stride] = stays[-1] = True
    kept = (*_KEPT, *(name for name in _MARKS[1:] if name in recording))
    recording = {name: recording[name][stays] for name in kept}
    fields: list[list[Any]] = []
    parts: list[bytes] = []
    if offsets is not None:
        fields.append(["obstacle_offsets", "float32", [*offsets[stays].shape]])
        parts.append(offsets[stays].astype("<f4").tobytes())
    marks = ((name, "uint8") for name in _MARKS if name in recording)
    for name, kind in (*((name, "float32") for name in _EXACT), *marks):
        fields.append([name, kind, [*recording[name].shape]])
        parts.append(recording[name].astype(np.dtype(kind).newbyteorder("<")).tobytes())
    rounded = {name: _rounded(recording[name]) for name in _ROUNDED}
    if dim == 2:
        now = rounded["positions"], rounded["frames"]
        placed, turned = (values.astype(np.float64) * scale for values, scale in now)
        seen = _seen(recording["observations"], placed, turned)
    else:
        seen = {"observations": _rounded(recording["observations"])}
    for name, (values, scale) in (rounded | seen).items():
        fields.append([name, "int16", [*values.shape], scale])
        parts.append(_differences(values))
    packed = gzip.compress(b"".join(parts), compresslevel=6, mtime=0)
    extent = np.stack([points.min(axis=0), points.max(axis=0)], axis=1).tolist()
    digits = max(5, _DIGITS - math.floor(math.log10(np.ptp(points, axis=0).max() or 1.0)))
    text = base64.b64encode(packed).decode("ascii")
    plain = [  # to 0.01 mm, or finer in a small world
        {name: np.round(value, digits).tolist() for name, value in one._asdict().items()}
        for one in shapes
    ]
    return Encoded(fields, text, stride, extent, plain)


def _offsets_of_outlines(recording: Recording, dim: int) -> NDArray[np.float64] | None:
    """Displacements of the outlines of obstacles, (T, outlines, d), m; None if none moves."""
    if "obstacle_offsets" not in recording:
        return None
    counts = [len(outlines(row[None], dim)) for row in recording["obstacles"]]
    return np.repeat(recording["obstacle_offsets"], counts, axis=1)


def rounding(array: NDArray[np.floating[Any]]) -> float:
    """Scale with which an array fits into 16 bits; the rounding error is half of it."""
    reach = float(np.nanmax(np.abs(array), initial=0.0))
    return reach / LARGEST or 1.0


def _rounded(array: NDArray[np.floating[Any]]) -> tuple[NDArray[np.int16], float]:
    """Array rounded to 16 bits, and its scale."""
    scale = rounding(array)
    rounded = np.rint(array.astype(np.float64) / scale)
    return np.where(np.isnan(rounded), -LARGEST - 1, rounded).astype(np.int16), scale


def _seen(
    observations: NDArray[Any], positions: NDArray[np.float64], frames: NDArray[np.float64]
) -> dict[str, tuple[NDArray[np.int16], float]]:
    """Lengths and angles of planar observations (T, n, rows, 2), in 16 bits."""
    x, y = np.moveaxis(observations.astype(np.float64), -1, 0)
    lengths, off = np.hypot(x, y), np.arctan2(y, x)
    rows = min(off.shape[-1], off.shape[1] - 1)
    off[..., :rows] -= _bearings(positions, frames)[..., :rows]
    whole = np.rint((off + np.pi) % (2 * np.pi) / (_COARSE * ANGLE)).astype(np.int64) * _COARSE
    last = np.where(lengths > 0.0, np.arange(len(lengths))[:, None, None], 0)
    steady = np.take_along_axis(whole, np.maximum.accumulate(last, axis=0), axis=0)
    angles = np.clip(steady - 2**15, -LARGEST, LARGEST)  # one below means NaN
    return {"lengths": _rounded(lengths), "angles": (angles.astype(np.int16), ANGLE)}


def _bearings(positions: NDArray[np.float64], frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """True bearings (T, n, n − 1) of all other robots in the robots' frames, rad."""
    n = positions.shape[1]
    others = np.array([[j for j in range(n) if j != i] for i in range(n)], dtype=np.int64)
    offsets = positions[:, others] - positions[:, :, None]
    own = np.einsum("tiba,tikb->tika", frames, offsets)
    return np.asarray(np.arctan2(own[..., 1], own[..., 0]))


def _differences(values: NDArray[np.int16]) -> bytes:
    """Differences between frames modulo 2¹⁶, time axis last; all low bytes first."""
    first = np.zeros_like(values[:1])
    steps = np.moveaxis(np.diff(values, axis=0, prepend=first), 0, -1)
    pairs = np.ascontiguousarray(steps, dtype="<i2").view(np.uint8).reshape(-1, 2)
    return pairs.T.tobytes()
