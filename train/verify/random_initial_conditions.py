"""Initial conditions and obstacles of random scenarios.

Robots form rows, rings, trees and clusters with gaps from r to the maximum link length; balls lie
at merge points.
"""

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rendezvous_env as rv
from rendezvous_env.obstacles.shape import CENTRE

Array = NDArray[np.float64]
Random = np.random.Generator

STRIDES = (1e-3, 3.0)  # size of changes of initial positions, in units of r


def log_uniform(random: Random, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


def pick(random: Random, *options: Any) -> Any:
    """Random element."""
    return options[int(random.integers(len(options)))]


# Positions (n, d), m, of robots with links from r to ``reach``, m.


def _in_box(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    return random.uniform(0.0, r * log_uniform(random, 1.5, 25.0), (n, dim))


def along_x(gaps: Any, dim: int) -> Array:
    """Robots on the x axis with the given gaps."""
    places = np.zeros((len(gaps), dim))
    places[:, 0] = np.cumsum(gaps)
    return places


def on_line(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Robots nearly on a line, in order, with random gaps."""
    places = along_x([_gap(random, r, reach) for _ in range(n)], dim)
    return places + pick(random, 0.0, 1e-9, 1e-3, 0.1) * r * random.normal(size=(n, dim))


def _gap(random: Random, r: float, reach: float) -> float:
    """Random gap between neighbours: below r, slightly above, arbitrary, or the longest link."""
    gaps = (
        r * log_uniform(random, 1e-3, 1.0),
        r * (1.0 + log_uniform(random, 1e-5, 0.3)),
        r * log_uniform(random, 1.0, 20.0),
        min(reach, 30.0 * r) * (1.0 - log_uniform(random, 1e-7, 0.1)),
    )
    return float(pick(random, *gaps))


def _in_clusters(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Two or three groups a few r apart, each within r."""
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
    """Random tree: each robot at a gap from a previous one, straight on or sideways."""
    places, straight = np.zeros((n, dim)), random.normal(size=dim)
    for k in range(1, n):
        towards = pick(random, straight, random.normal(size=dim))
        at = int(pick(random, k - 1, random.integers(k)))
        places[k] = places[at] + _gap(random, r, reach) * towards / np.linalg.norm(towards)
    return places


def in_tail(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Robots in a row about r apart with decreasing gaps, and the last one at maximum distance."""
    near = random.uniform(0.6, 1.0, n - 1)
    gaps = np.sort(pick(random, near, 1.0 + 0.03 * near**3))[::-1] * r
    gaps[-1] = min(reach, 30.0 * r) * (1.0 - log_uniform(random, 1e-7, 0.05))
    places = along_x([0.0, *gaps], dim)
    return places + pick(random, 0.0, 1e-3, 0.05) * r * random.normal(size=(n, dim))


def in_wedge(random: Random, n: int, dim: int, r: float, reach: float) -> Array:
    """Robot 0 between others in nearly opposite directions, with nearly cancelling bearings."""
    angle, places = log_uniform(random, 0.02, 0.8), np.zeros((n, dim))
    for k in range(1, n):
        distance = r * log_uniform(random, 1.01, 3.0) if n > 3 else r * 1.5
        places[k, 0] = (-1.0) ** k * distance * math.cos(angle)
        places[k, 1] = -distance * math.sin(angle) - 1.2 * r * ((k - 1) // 2)
    return places


STARTS = (None, _in_box, on_line, _in_clusters, _in_clusters, _on_ring, _in_tree, in_wedge)


def random_positions(random: Random, n: int, dim: int, r: float, reach: float) -> Array | None:
    """Positions of a random kind, permuted and rotated; None samples them per episode."""
    if (place := pick(random, *STARTS)) is None:
        return None
    places = place(random, n, dim, r, reach)
    turn, _ = np.linalg.qr(random.normal(size=(dim, dim)))
    if random.random() < 0.7:
        places = random.permutation(places)
    return np.asarray(places @ turn.T)


def changed(random: Random, places: Array, r: float) -> Array:
    """Variation of positions in which one robot or all are moved."""
    stride = r * log_uniform(random, *STRIDES)
    which = np.arange(len(places)) == random.integers(len(places))
    which |= random.random() < 0.5
    return np.asarray(places + stride * random.normal(size=places.shape) * which[:, None])


def obstacles(
    random: Random, dim: int, round_only: bool, r: float, places: Array | None, side: float
) -> Any:
    """Obstacles at merge points, anywhere between robots, or sampled per episode."""
    if places is None or random.random() < 0.2:
        if dim == 2 and not round_only:
            layout = pick(random, "trap", "corridor", "rooms")
            length, opening = (0.3 * side, 0.6 * side), (0.05 * side, 0.1 * side)
            return rv.WallField(layout, length, opening, 0.03 * side, side, 0.1 * r)
        radius = (0.02 * side, 0.1 * side)
        return rv.ObstacleField((1, 3), radius, side, 0.1 * r, bool(random.integers(2)))
    if random.random() < 0.6:
        found = at_midpoints(random, places)
    else:
        at = places[random.integers(len(places), size=int(random.integers(1, 4)))]
        sizes = [r * log_uniform(random, 0.1, 5.0) for _ in at]
        found = [
            _ball(place + 2.0 * size * random.normal(size=dim), size)
            for place, size in zip(at, sizes, strict=True)
        ]
    if not round_only:
        found.append(angular(random, dim, r, places))
    if random.random() < 0.2:
        found = [_moving(random, one, r) if random.random() < 0.5 else one for one in found]
    return tuple(found)


def _moving(random: Random, shape: Any, r: float) -> Any:
    """A shape with a constant velocity, waypoints or a random walk, up to 10 r per second."""
    speed, seconds = r * log_uniform(random, 0.1, 10.0), log_uniform(random, 0.1, 10.0)
    course = random.normal(size=shape.dim)
    course *= speed / np.linalg.norm(course)
    kind = int(random.integers(3))
    if kind == 0:
        return rv.Moving(shape, velocity=tuple(course.tolist()))
    if kind == 1:
        there, back = (course * seconds).tolist(), [0.0] * shape.dim
        rows = ((0.0, *back), (seconds, *there), (2.0 * seconds, *back))
        return rv.Moving(shape, waypoints=rows)
    centre = np.array(shape.packed()[CENTRE : CENTRE + shape.dim])
    reach = speed * seconds
    box = tuple((centre - reach).tolist()), tuple((centre + reach).tolist())
    return rv.Moving(shape, speed=speed, box=box, interval=seconds)


def _ball(centre: Array, radius: float) -> Any:
    return (rv.Disc if len(centre) == 2 else rv.Sphere)(tuple(centre.tolist()), radius)


def angular(random: Random, dim: int, r: float, places: Array) -> Any:
    """A triangle or a capsule at a random place between the robots."""
    size = r * log_uniform(random, 0.1, 5.0)
    at = places[int(random.integers(len(places)))] + 2.0 * size * random.normal(size=dim)
    if dim == 2 and random.random() < 0.5:
        angles = np.sort(random.uniform(0.0, 2.0 * np.pi, 3))
        corners = at + size * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return rv.Polygon(tuple(map(tuple, corners.tolist())))
    other = at + size * random.normal(size=dim)
    return rv.Capsule((tuple(at.tolist()), tuple(other.tolist())), 0.3 * size)


def at_midpoints(random: Random, places: Array) -> list[Any]:
    """Balls at the midpoints of the nearest pairs."""
    pairs = [
        (float(np.linalg.norm(one - other)), (one + other) / 2.0)
        for one, other in itertools.combinations(places, 2)
    ]
    nearest = sorted(pairs, key=lambda pair: pair[0])[: int(random.integers(1, len(places) + 1))]
    return [_ball(middle, 0.5 * gap * random.uniform(0.2, 0.95)) for gap, middle in nearest]
