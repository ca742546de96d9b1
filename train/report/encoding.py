"""Recordings as text for a page: rounded to 16 bits, differences in time, gzip, base64.

A recording of 400 frames of 20 robots shrinks to a hundredth of what its numbers take as JSON.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..recording import Recording

LARGEST = 32767
"""Of a rounded number; one below minus this stands for NaN."""

BUDGET = 11_000_000
"""Characters that all recordings of a page may take together before they are thinned out."""

_EXACT = ("times", "lyapunov", "lyapunov_before_merge", "lyapunov_after_merge", "contacts")
_ROUNDED = ("positions", "frames", "alignment", "observations")


@dataclass(frozen=True)
class Encoded:
    """A recording as the page reads it."""

    fields: list[dict[str, Any]]
    """Of each array, in order: name, type ("float32", "uint8" or "int16"), shape, and of an int16
    the scale, so that a number is scale · integer."""
    text: str
    """All arrays, little-endian, in base64 of gzip."""
    stride: int
    """Every how manieth recorded frame is there, besides merges and the end."""


def encode_all(recordings: Sequence[Recording]) -> list[Encoded]:
    """Encode recordings; if they exceed BUDGET, thin out those that take more than their share."""
    whole = [encode(recording) for recording in recordings]
    if sum(len(encoded.text) for encoded in whole) <= BUDGET:
        return whole
    share = BUDGET // len(whole)
    return [
        _encode_within(share, recording, encoded)
        for recording, encoded in zip(recordings, whole, strict=True)
    ]


def _encode_within(share: int, recording: Recording, encoded: Encoded) -> Encoded:
    while len(encoded.text) > share and encoded.stride < len(recording["times"]):
        encoded = encode(recording, 2 * encoded.stride)
    return encoded


def thinned(recording: Recording, stride: int) -> Recording:
    """Every stride-th frame, every merge and the end."""
    stays = ~np.isnan(recording["lyapunov_before_merge"])
    stays[::stride] = stays[-1] = True
    return {name: recording[name][stays] for name in ("active", *_EXACT, *_ROUNDED)}


def encode(recording: Recording, stride: int = 1) -> Encoded:
    """A recording as the page reads it, every stride-th frame of it."""
    recording = thinned(recording, stride)
    fields, parts = [], []
    for name in _EXACT:
        fields.append({"name": name, "type": "float32", "shape": recording[name].shape})
        parts.append(recording[name].astype("<f4").tobytes())
    fields.append({"name": "active", "type": "uint8", "shape": recording["active"].shape})
    parts.append(recording["active"].astype(np.uint8).tobytes())
    for name in _ROUNDED:
        scale, shape = rounding(recording[name]), recording[name].shape
        fields.append({"name": name, "type": "int16", "shape": shape, "scale": scale})
        parts.append(_differences(_rounded(recording[name], scale)))
    packed = gzip.compress(b"".join(parts), compresslevel=9, mtime=0)
    return Encoded(fields, base64.b64encode(packed).decode("ascii"), stride)


def rounding(array: NDArray[np.floating[Any]]) -> float:
    """Scale with which an array fits into 16 bits; its numbers are rounded to half of it."""
    reach = float(np.nanmax(np.abs(array), initial=0.0))
    return reach / LARGEST or 1.0


def _rounded(array: NDArray[np.floating[Any]], scale: float) -> NDArray[np.int16]:
    rounded = np.rint(array.astype(np.float64) / scale)
    return np.where(np.isnan(rounded), -LARGEST - 1, rounded).astype(np.int16)


def _differences(values: NDArray[np.int16]) -> bytes:
    """Differences from frame to frame modulo 2¹⁶, time running fastest; all low bytes first."""
    first = np.zeros_like(values[:1])
    steps = np.moveaxis(np.diff(values, axis=0, prepend=first), 0, -1)
    pairs = np.ascontiguousarray(steps, dtype="<i2").view(np.uint8).reshape(-1, 2)
    return pairs.T.tobytes()
