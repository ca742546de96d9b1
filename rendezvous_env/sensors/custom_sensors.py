"""Custom sensor imperfections: functions of the observations of a batch, applied last."""

import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import Registry, raise_invalid
from ..compilation import kernel
from ..physics.random_streams import SENSING, mix, stream_key, uniform
from .chance import step_key


class ObservationBatch:
    """Observations of B environments at one time, to be modified in place."""

    neighbours: NDArray[np.float32]
    """Neighbour rows a_ij g_ij in the robots' frames, (B, n, K, d), m/s; zero if absent."""
    obstacles: NDArray[np.float32]
    """Unit bearings to obstacle edges in the robots' frames, (B, n, M, S, d); zero if absent."""
    positions: NDArray[np.float64]
    """Positions, (B, n, d), m, for distance-dependent errors; not observed by robots."""
    time: NDArray[np.float64]
    """Time since the start of the episode, (B,), s."""

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
        """Random numbers in [0, 1), (B, *shape), keyed by seed, episode, step and imperfection."""
        numbers = np.empty((len(self.time), int(np.prod(shape))))
        salt = np.uint64(zlib.crc32(self._name.encode()))
        with np.errstate(over="ignore"):  # as kernels without compilation require
            _fill(*self._keys, salt, numbers)
        return numbers.reshape(len(numbers), *shape)


@kernel
def _fill(seeds, episodes, steps, salt, out):
    """Fill random numbers of each environment's sensing stream for a step and imperfection."""
    for team in range(out.shape[0]):
        key = step_key(stream_key(seeds[team], episodes[team], SENSING), steps[team])
        key = mix(key ^ salt)
        for number in range(out.shape[1]):
            out[team, number] = uniform(key, number)


Imperfection = Callable[[ObservationBatch], None]
IMPERFECTIONS = Registry("sensor imperfection", "rv.sensor_imperfection")


def sensor_imperfection(name: str, change: Imperfection | None = None) -> Any:
    """Register a sensor imperfection: a function that modifies an ``ObservationBatch``.

    ``Sensing(custom=(name,))`` applies it after all others. It must treat environments
    independently and be stateless. It may zero and rotate rows; absent rows stay absent. With fewer
    rows than other robots, present rows are moved to the front. An existing one of the same name is
    replaced. Without ``change`` this is a decorator.

    Raises:
        ValueError: for an invalid name or a function that is not callable.
    """
    return IMPERFECTIONS.add(name, change)


def as_custom(field: str, value: Any) -> tuple[str, ...]:
    """Validated names of registered imperfections."""
    if not isinstance(value, list | tuple):
        raise_invalid(field, value, "a list of names")
    for name in value:
        IMPERFECTIONS.check(field, name)
    return tuple(value)


def apply_custom(seen: ObservationBatch) -> None:
    """Apply the custom imperfections of a scenario."""
    tables = seen.neighbours, seen.obstacles
    for name in seen.scenario.sensing.custom:
        absent = [~table.any(axis=-1) for table in tables]
        seen._name = name
        IMPERFECTIONS[name](seen)
        if seen.neighbours is not tables[0] or seen.obstacles is not tables[1]:
            remedy = "change what is in it: seen.neighbours[...] = …"
            raise ValueError(
                f"sensing.custom: {name!r} replaced an array of its argument; {remedy}"
            )
        for table, gone in zip(tables, absent, strict=True):
            table[gone] = 0.0
            if not np.isfinite(table).all():
                raise ValueError(f"sensing.custom: {name!r} returned a number that is not finite")
    if seen.neighbours.shape[2] < seen.scenario.n_robots - 1:
        present = seen.neighbours.any(axis=-1)
        order = np.argsort(~present, axis=-1, kind="stable")
        seen.neighbours[...] = np.take_along_axis(seen.neighbours, order[..., None], axis=2)
