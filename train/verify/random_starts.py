"""Starts and obstacles of random scenarios: robots in rows, rings, trees and clusters, within r of
each other and as far apart as links may be; balls where they will merge.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv

Array = NDArray[np.float64]
Random = np.random.Generator

STRIDES = (1e-3, 3.0)
"""By how much a start is changed, in units of r."""


def log_uniform(random: Random, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


def pick(random: Random, *options: Any) -> Any:
    """One of them."""
    return options[int(random.integers(len(options)))]


def starts(random: Random, n: int, dim: int, r: float, reach: float) -> Array | None:
    """Places (n, d), m, of one of STARTS, in any order and orientation; None: they are drawn."""
    place = pick(random, *STARTS)
    if place is None:
        return None
    places = place(random, n, dim, r, reach)
    turn, _ = np.linalg.qr(random.normal(size=(dim, dim)))
    if random.random() < 0.7:
        places = random.permutation(places)
    return np.asarray(places @ turn.T)


def _in_box(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    return random.uniform(0.0, r * log_uniform(random, 1.5, 25.0), (n, dim))


def _along_x(gaps: Any, dim: int) -> Array:
    """Robots in order, so far apart."""
    places = np.zeros((len(gaps), dim))
    places[:, 0] = np.cumsum(gaps)
    return places


def on_line(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Robots nearly on a line, in order, gaps as they come."""
    places = _along_x([_gap(random, r, reach) for _ in range(n)], dim)
    return places + pick(random, 0.0, 1e-9, 1e-3, 0.1) * r * random.normal(size=(n, dim))


def _gap(random: Random, r: float, reach: float) -> float:
    """Between neighbours: within r, hardly more, as far as a link may be, or anything."""
    gaps = (
        r * log_uniform(random, 1e-3, 1.0),
        r * (1.0 + log_uniform(random, 1e-5, 0.3)),
        r * log_uniform(random, 1.0, 20.0),
        min(reach, 30.0 * r) * (1.0 - log_uniform(random, 1e-7, 0.1)),
    )
    return float(pick(random, *gaps))


def _in_clusters(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Some robots within r of each other, and others so, a few r apart."""
    apart = r * log_uniform(random, 1.2, 20.0)
    centres = apart * random.normal(size=(int(random.integers(2, 4)), dim))
    offsets = r * log_uniform(random, 1e-3, 0.9) * random.normal(size=(n, dim))
    return np.asarray(centres[np.arange(n) % len(centres)] + offsets)


def _on_ring(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    angle, places = 2.0 * np.pi * np.arange(n) / n, np.zeros((n, dim))
    places[:, 0], places[:, 1] = np.cos(angle), np.sin(angle)
    places *= r * log_uniform(random, 0.4, 10.0)
    return places + pick(random, 0.0, 1e-6, 0.1) * r * random.normal(size=(n, dim))


def _in_tree(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Each at a gap from one before it, straight on or to any side."""
    places, straight = np.zeros((n, dim)), random.normal(size=dim)
    for k in range(1, n):
        towards = pick(random, straight, random.normal(size=dim))
        at = int(pick(random, k - 1, random.integers(k)))
        places[k] = places[at] + _gap(random, r, reach) * towards / np.linalg.norm(towards)
    return places


def in_row(random: Random, n: int, dim: int, r: float) -> Array:
    """Robots on a line, apart, in order."""
    return _along_x([r * log_uniform(random, 2.0, 20.0) for _ in range(n)], dim)


def in_tail(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Robots in a row about r apart, ever nearer, and the last one as far as it may be."""
    near = random.uniform(0.6, 1.0, n - 1)
    gaps = np.sort(pick(random, near, 1.0 + 0.03 * near**3))[::-1] * r
    gaps[-1] = min(reach, 30.0 * r) * (1.0 - log_uniform(random, 1e-7, 0.05))
    places = _along_x([0.0, *gaps], dim)
    return places + pick(random, 0.0, 1e-3, 0.05) * r * random.normal(size=(n, dim))


def in_wedge(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Robot 0 between others in nearly opposite directions, so that its bearings nearly cancel."""
    angle, places = log_uniform(random, 0.02, 0.8), np.zeros((n, dim))
    for k in range(1, n):
        distance = r * log_uniform(random, 1.01, 3.0) if n > 3 else r * 1.5
        places[k, 0] = (-1.0) ** k * distance * math.cos(angle)
        places[k, 1] = -distance * math.sin(angle) - 1.2 * r * ((k - 1) // 2)
    return places


STARTS = (None, _in_box, on_line, _in_clusters, _in_clusters, _on_ring, _in_tree, in_wedge)


def changed(random: Random, places: Array, r: float) -> Array:
    """A start from which one robot has been moved, or all."""
    stride = r * log_uniform(random, *STRIDES)
    which = np.arange(len(places)) == random.integers(len(places))
    which |= random.random() < 0.5
    return np.asarray(places + stride * random.normal(size=places.shape) * which[:, None])


def obstacles(
    random: Random, dim: int, round_only: bool, r: float, places: Array | None, side: float
) -> Any:
    """Where robots will merge, anywhere among them, or drawn for every episode."""
    if places is None or random.random() < 0.2:
        if dim == 2 and not round_only:
            layout = pick(random, "trap", "corridor", "rooms")
            length, opening = (0.3 * side, 0.6 * side), (0.05 * side, 0.1 * side)
            return rv.WallField(layout, length, opening, 0.03 * side, side, 0.1 * r)
        radius = (0.02 * side, 0.1 * side)
        return rv.ObstacleField((1, 3), radius, side, 0.1 * r, bool(random.integers(2)))
    ball = rv.Disc if dim == 2 else rv.Sphere
    if random.random() < 0.6:
        found = at_midpoints(random, ball, places)
    else:
        at = places[random.integers(len(places), size=int(random.integers(1, 4)))]
        sizes = [r * log_uniform(random, 0.1, 5.0) for _ in at]
        found = [
            ball(tuple((place + 2.0 * size * random.normal(size=dim)).tolist()), size)
            for place, size in zip(at, sizes, strict=True)
        ]
    if not round_only:
        found.append(angular(random, dim, r, places))
    return tuple(found)


def angular(random: Random, dim: int, r: float, places: Array) -> Any:
    """A triangle or a capsule somewhere among the robots."""
    size = r * log_uniform(random, 0.1, 5.0)
    at = places[int(random.integers(len(places)))] + 2.0 * size * random.normal(size=dim)
    if dim == 2 and random.random() < 0.5:
        angles = np.sort(random.uniform(0.0, 2.0 * np.pi, 3))
        corners = at + size * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return rv.Polygon(tuple(map(tuple, corners.tolist())))
    other = at + size * random.normal(size=dim)
    return rv.Capsule((tuple(at.tolist()), tuple(other.tolist())), 0.3 * size)


def at_midpoints(random: Random, ball: Any, places: Array) -> list[Any]:
    """Balls at the midpoints of the nearest pairs."""
    pairs = sorted(
        itertools.combinations(range(len(places)), 2),
        key=lambda pair: float(np.linalg.norm(places[pair[0]] - places[pair[1]])),
    )
    found = []
    for i, j in pairs[: int(random.integers(1, len(places) + 1))]:
        radius = 0.5 * float(np.linalg.norm(places[i] - places[j])) * random.uniform(0.2, 0.95)
        found.append(ball(tuple(((places[i] + places[j]) / 2.0).tolist()), radius))
    return found
