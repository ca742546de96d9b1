"""The places of a start, drawn in the spawn area."""

import math

import numpy as np

from ...compilation import inner_kernel, kernel
from ...graphs.random_graphs import is_linked, join
from ...obstacles.obstacle_set import clear_of_obstacles
from ...physics.potential import distance_squared
from ...physics.random_streams import mix, uniform
from ...physics.vectors import load

_TRIES_FOR_START = 1000
TRIES_FOR_WAYS = 1000
"""Starts that are drawn until no robot is walled in."""
_TRIES_FOR_JOINED = 10_000


@kernel
def stream_of_try(key, trial):
    """The stream itself at first, then one of its own for each further try."""
    return key if trial == 0 else mix(key ^ np.uint64(trial))


@kernel
def draw_places(key, rules, reach, scene, positions, counts):
    """Places, unless they are given; whether they fit. ``scene`` is links and obstacles.

    Where links change they are drawn until those up to ``reach`` connect them.
    """
    if rules.draw_positions:
        if reach is not None:
            for trial in range(_TRIES_FOR_JOINED):
                # beside the streams of further tries for ways
                own = stream_of_try(key, trial * TRIES_FOR_WAYS)
                if not _draw_positions(own, rules, reach, scene, positions):
                    return False
                if _is_joined(positions, reach, counts):
                    return True
            return False
        return _draw_positions(key, rules, reach, scene, positions)
    return True


@inner_kernel
def _draw_positions(key, rules, reach, scene, positions):
    """Uniform in the spawn area, neighbours at least 2r apart, clear of obstacles; whether it
    fits.
    """
    (n, d), (links, world) = positions.shape, scene
    counter = 0
    for i in range(n):
        for _ in range(_TRIES_FOR_START):
            for k in range(d):
                positions[i, k] = rules.spawn_size * (uniform(key, counter) - 0.5)
                counter += 1
            if _apart(i, positions, reach, links, rules.least_distance) and _clear(
                positions[i], world, rules.keep_out
            ):
                break
        else:
            return False
    return True


@inner_kernel
def _clear(position, world, margin):
    if world is not None:
        return clear_of_obstacles(load(position), world, margin)
    return True


@inner_kernel
def _apart(i, positions, reach, links, least_distance):
    """Whether robot i is far enough from the neighbours that have a place already; where links
    change, from everyone who has.
    """
    for j in range(i):
        if distance_squared(positions, j, i) < least_distance * least_distance:
            if reach is not None:
                return False
            if is_linked(j, i, links):
                return False
    return True


@inner_kernel
def _is_joined(positions, reach, places):
    """Whether links up to a length (m) connect a team; ``places``, (n,), is working memory."""
    if math.isinf(reach):
        return True
    for i in range(len(places)):
        places[i] = i
    groups = len(places)
    for i in range(len(places)):
        for j in range(i):
            if distance_squared(positions, i, j) <= reach * reach:
                groups -= join(i, j, places)
    return groups == 1
