"""Imperfections of a user's own: functions of what a batch of teams sees, applied last."""

import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import Registry, refuse
from ..compilation import kernel
from ..physics.random_streams import SENSING, mix, stream_key, uniform
from .chance import step_key


class Seen:
    """What B teams see at one moment, to be changed in place."""

    neighbours: NDArray[np.float32]
    """(B, n, K, d): a_ij g_ij in the robots' own frames, m/s; zero where nobody is seen."""
    obstacles: NDArray[np.float32]
    """(B, n, M, S, d): unit silhouette bearings; likewise."""
    positions: NDArray[np.float64]
    """(B, n, d), m, for what depends on distance; robots themselves never know it."""
    time: NDArray[np.float64]
    """(B,), s since the start of the episode."""

    def __init__(
        self,
        scenario: Any,
        observations: NDArray[np.float32],
        steps: NDArray[np.int64],
        seeds: NDArray[np.uint64],
        episodes: NDArray[np.int64],
        positions: NDArray[np.float64],
    ) -> None:
        self.scenario, self.positions, self.time = scenario, positions, steps * scenario.tau
        self.neighbours, self.obstacles = scenario.observation_layout.split(observations)[:2]
        self._name, self._keys = "", (seeds, episodes, steps)

    def uniform(self, *shape: int) -> NDArray[np.float64]:
        """Random numbers in [0, 1), (B, *shape), which follow from a team's seed, episode and step
        and the name of the imperfection.
        """
        numbers = np.empty((len(self.time), int(np.prod(shape))))
        salt = np.uint64(zlib.crc32(self._name.encode()))
        with np.errstate(over="ignore"):  # of kernels that are left plain Python
            _fill(*self._keys, salt, numbers)
        return numbers.reshape(len(numbers), *shape)


@kernel
def _fill(seeds, episodes, steps, salt, out):
    """Numbers of every team's stream of sensing, of the step and of one imperfection."""
    for team in range(out.shape[0]):
        key = step_key(stream_key(seeds[team], episodes[team], SENSING), steps[team])
        key = mix(key ^ salt)
        for number in range(out.shape[1]):
            out[team, number] = uniform(key, number)


Imperfection = Callable[[Seen], None]
IMPERFECTIONS = Registry("sensor imperfection", "rv.sensor_imperfection")


def sensor_imperfection(name: str, change: Imperfection | None = None) -> Any:
    """Register an imperfection: a function that changes what is ``Seen`` in place.

    ``Sensing(custom=(name,))`` applies it after all others. It treats every team by itself and
    remembers nothing. It may zero rows and turn them; absent rows stay so. Where there are fewer
    rows than other robots, those left stand first. One of the same name is replaced; without
    ``change`` a decorator is returned.

    Raises:
        ValueError: for what is no name or cannot be called.
    """
    return IMPERFECTIONS.add(name, change)


def as_custom(field: str, value: Any) -> tuple[str, ...]:
    """Names of registered imperfections."""
    if not isinstance(value, list | tuple):
        refuse(field, value, "a list of names")
    for name in value:
        IMPERFECTIONS.check(field, name)
    return tuple(value)


def apply_custom(seen: Seen) -> None:
    """Let the custom imperfections of a scenario change what is seen."""
    tables = seen.neighbours, seen.obstacles
    for name in seen.scenario.sensing.custom:
        absent = [~table.any(axis=-1) for table in tables]
        seen._name = name
        IMPERFECTIONS[name](seen)
        if seen.neighbours is not tables[0] or seen.obstacles is not tables[1]:
            remedy = "change what is in it: seen.neighbours[...] = …"
            raise ValueError(f"sensing.custom: {name!r} put another array into seen; {remedy}")
        for table, gone in zip(tables, absent, strict=True):
            table[gone] = 0.0
            if not np.isfinite(table).all():
                raise ValueError(f"sensing.custom: {name!r} made a number that is not finite")
    if seen.neighbours.shape[2] < seen.scenario.n_robots - 1:
        present = seen.neighbours.any(axis=-1)
        order = np.argsort(~present, axis=-1, kind="stable")
        seen.neighbours[...] = np.take_along_axis(seen.neighbours, order[..., None], axis=2)
