"""Effects of measured sensors: detection by range, correlated errors, observer bias, outliers.

Constants for kernels, and equations.

Memories follow a step of τ by a factor k = exp(−τ/T):

    detection   u ← u with probability k, else uniform in [0, 1);   seen if u < p
    noise       e ← k e + √(1 − k²) z,   z ~ N(0, 1)

so that u is uniform and e normal at all times, and both have correlation exp(−t/T).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import inner_kernel
from ..physics.vectors import add, combine, cross, dot, norm, subtract, to_local, triple
from .sensing import Sensing

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_QUARTER, _HALF_TURN = np.float32(0.5 * math.pi), np.float32(math.pi)
_ARCTAN = tuple(
    np.float32(factor)
    for factor in (0.99997726, -0.33262347, 0.19354346, -0.11643287, 0.05265332, -0.01172120)
)
"""Coefficients of arctan(t)/t, in ascending powers of t² ≤ 1."""


class Effects(NamedTuple):
    """Effects of a team's sensors on neighbour rows, as kernel constants."""

    blind: bool  # whether any robot has a blind zone
    nearest: NDArray[np.float64]  # min_range of each robot, (n,), m
    detects: bool  # whether the probability of detection is drawn here, rather than dropout alone
    remembers: bool  # whether detection has a memory
    distances: NDArray[np.float64]  # of tables of detection, (1 or n, points), m
    chances: NDArray[np.float64]  # likewise, with the dropout of robots that draw detection here
    half_fields: NDArray[np.float64]  # (n,), rad; inf for a view without an edge
    falloffs: NDArray[np.float64]  # (n,), rad; 0 is a hard edge
    drifts: bool  # whether noise has a memory
    levels: NDArray[np.float32]  # (n,), of noise with a memory, rad
    replaces: bool  # whether there are outliers
    outliers: NDArray[np.float64]  # their probability for each robot, (n,)
    uniform: NDArray[np.bool_]  # (n,), whether outliers are uniform, or else of another robot


def draws_detection(sensing: Sensing, n_robots: int) -> NDArray[np.bool_]:
    """Mask of the robots whose detection differs from independent dropout, (n,)."""
    measured = np.array([bool(table) for table in sensing.tables(n_robots)])
    lasting = sensing.each("persistence", n_robots) > 0.0
    return measured | lasting | (falloffs_of(sensing, n_robots) > 0.0)


def falloffs_of(sensing: Sensing, n_robots: int) -> NDArray[np.float64]:
    """Width of the border of each robot's field of view, (n,), rad; 0 without an edge."""
    views, falloffs = (sensing.each(name, n_robots) for name in ("field_of_view", "view_falloff"))
    return np.where(views < 2.0 * math.pi, falloffs, 0.0)


def has_memory(sensing: Sensing, n_robots: int) -> NDArray[np.bool_]:
    """Mask of the robots whose noise has a memory, (n,)."""
    correlated = sensing.each("noise_correlation", n_robots) > 0.0
    return correlated & (sensing.each("noise", n_robots) > 0.0)


def effects_of(sensing: Sensing, n_robots: int) -> Effects | None:
    """Constants of a sensor's effects for kernels; None without effects."""
    detects, drifts = draws_detection(sensing, n_robots), has_memory(sensing, n_robots)
    nearest = sensing.each("min_range", n_robots)
    outliers = sensing.each("outliers", n_robots)
    if not detects.any() and not drifts.any() and max(nearest.max(), outliers.max()) == 0.0:
        return None
    kept = np.where(detects, 1.0 - sensing.each("dropout", n_robots), 1.0)
    differs = "detection" in sensing.per_robot or kept.min() < kept.max()
    tables = _of_equal_length(sensing.tables(n_robots if differs else 1))
    views = sensing.each("field_of_view", n_robots)
    return Effects(
        blind=bool(nearest.max() > 0.0),
        nearest=nearest,
        detects=bool(detects.any()),
        remembers=sensing.largest("persistence") > 0.0,
        distances=tables[:, :, 0].copy(),
        chances=tables[:, :, 1] * kept[: len(tables), None],
        half_fields=np.where(views < 2.0 * math.pi, 0.5 * views, math.inf),
        falloffs=falloffs_of(sensing, n_robots),
        drifts=bool(drifts.any()),
        levels=np.where(drifts, sensing.each("noise", n_robots), 0.0).astype(np.float32),
        replaces=bool(outliers.max() > 0.0),
        outliers=outliers,
        uniform=sensing.among("outlier_kind", n_robots, "uniform"),
    )


def _of_equal_length(tables: list[tuple[tuple[float, float], ...]]) -> NDArray[np.float64]:
    """Tables of detection, (count, points, 2), continued by points of the last probability."""
    given = [table or ((0.0, 1.0),) for table in tables]
    points = max(map(len, given))
    for row, table in enumerate(given):
        (last, chance), missing = table[-1], points - len(table)
        given[row] = (*table, *((2.0 * (last + k + 1.0), chance) for k in range(missing)))
    return np.array(given, np.float64)


def kept_share(time_constant: float, tau: float) -> float:
    """Factor k = exp(−τ/T), a number, of a step τ and a time constant T, s; 0 if T is 0."""
    return math.exp(-tau / time_constant) if time_constant > 0.0 else 0.0


def memory_of_errors(sensing: Sensing, n_robots: int, tau: float) -> NDArray[np.float32]:
    """Factors k and √(1 − k²) of the noise of each robot in a step τ, s, (n, 2)."""
    kept = [kept_share(time, tau) for time in sensing.each("noise_correlation", n_robots).tolist()]
    return np.array([(k, math.sqrt(1.0 - k * k)) for k in kept], np.float32)


def samples_of(sensing: Sensing, n_robots: int, tau: float) -> NDArray[np.float64]:
    """Samples in a step τ, s, of each robot, (n,), or of all, (1,); 0 without a sample period."""
    periods = sensing.each("sample_period", n_robots if "sample_period" in sensing.per_robot else 1)
    return np.array([tau / period if period > 0.0 else 0.0 for period in periods.tolist()])


class Redraws(NamedTuple):
    """Words of 32 bits that draw the u of detection anew in a step: those from ``lowest`` on."""

    lowest: NDArray[np.uint32]  # (n,), of each robot, 2³² k
    scales: NDArray[np.float32]  # (n,), from the rank of a word to u; 0 without a memory


def redraws_of(sensing: Sensing, n_robots: int, tau: float) -> Redraws:
    """Words that draw the memory of detection anew in a step τ, s."""
    times = sensing.each("persistence", n_robots).tolist()
    kept = [math.ceil(kept_share(time, tau) * 2.0**32) for time in times]
    lowest = [min(count, 2**32 - 2**10) for count in kept]
    scales = [
        2.0 / (2.0**32 - low) if time else 0.0 for low, time in zip(lowest, times, strict=True)
    ]
    return Redraws(np.array(lowest, np.uint32), np.array(scales, np.float32))


@inner_kernel(inline="code")
def share_in_view(offset, frame, half_field, falloff):
    """Factor of the detection probability near the edge of the field of view, from 0 to 1.

    It is the angle to the edge divided by the width of the border.
    """
    x, y, z = triple(to_local(as_float32(frame), as_float32(offset)))
    angle = _angle(x, np.float32(math.sqrt(y * y + z * z)))
    share = (np.float32(half_field) - angle) / np.float32(falloff)
    return min(max(share, _ZERO), _ONE)


@inner_kernel(inline="code")
def as_float32(v):
    """Pair, triple or frame in float32; a register holds twice as many of these numbers."""
    if len(v) == 2:
        return np.float32(v[0]), np.float32(v[1])
    first = np.float32(v[0]), np.float32(v[1]), np.float32(v[2])
    if len(v) == 3:
        return first
    if len(v) == 4:
        return (*first, np.float32(v[3]))
    second = np.float32(v[3]), np.float32(v[4]), np.float32(v[5])
    return (*first, *second, np.float32(v[6]), np.float32(v[7]), np.float32(v[8]))


@inner_kernel(inline="code")
def _angle(x, y):
    """Angle of (x, y ≥ 0) to the x axis, rad, to 10⁻⁵.

    It has no branch, so loops over lanes become SIMD.
    """
    level = abs(x)
    steep = y > level
    low, high = (level if steep else y), (y if steep else level)
    t = low / (high if high > 0 else _ONE)
    square = t * t
    series = _ARCTAN[5] * square + _ARCTAN[4]
    series = (series * square + _ARCTAN[3]) * square + _ARCTAN[2]
    angle = t * ((series * square + _ARCTAN[1]) * square + _ARCTAN[0])
    angle = _QUARTER - angle if steep else angle
    return _HALF_TURN - angle if x < 0 else angle


@inner_kernel(inline="code")
def distance_of(here, there):
    """Distance of two places, pairs or triples, m."""
    return norm(subtract(there, here))


@inner_kernel(inline="code")
def turned_about(row, turn):
    """Row rotated by the rotation of an observer: (cos α, sin α), in 3-D with the unit axis a.

    g cos α + (a × g) sin α + a (aᵀg)(1 − cos α)
    """
    c, s = turn[0], turn[1]
    if len(row) == 2:
        return c * row[0] - s * row[1], s * row[0] + c * row[1]
    axis = (turn[2], turn[3], turn[4])
    return add(combine(c, row, s, cross(axis, row)), dot(axis, row) * (_ONE - c), axis)
