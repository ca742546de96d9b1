"""Which neighbour a robot pursues: rows of an observation in an order of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario


def rows_have_an_order(scenario: Scenario) -> bool:
    """Whether the rows tell who comes next: there is one for each other robot, or one in all.

    Of two to n − 2 rows those present stand first, and nothing tells which robot stands where.
    """
    return scenario.observation_layout.neighbour_slots in (1, scenario.n_robots - 1)


def rows_from_next(n_robots: int, rows: int) -> NDArray[np.int64]:
    """Indices of rows, (n, K), in cyclic order from the next robot's on.

    With a row for each other robot these are the rows of robots i + 1, i + 2, …, i − 1 (mod n);
    with fewer, on sparse graphs, the rows as they stand.
    """
    robots, steps = np.arange(n_robots)[:, np.newaxis], np.arange(rows)
    return (robots + steps) % rows if rows == n_robots - 1 else 0 * robots + steps


def rows_from_nearest(n_robots: int, rows: int) -> NDArray[np.int64]:
    """Indices of rows, (n, K), in the order of how far their robots' indices are from a robot's
    own, of two equally far ones the lower first; on sparse graphs the rows as they stand.
    """
    own, row = np.arange(n_robots)[:, np.newaxis], np.arange(rows)
    if rows != n_robots - 1:
        return 0 * own + row
    return np.argsort(np.abs(row + (row >= own) - own), axis=1, kind="stable")


def first_seen(seen: NDArray[np.bool_], order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of rows in an order, ([...,] n, K), the first that is seen, (..., n, K): its index, (..., n);
    the first of all where none is seen.
    """
    order = np.broadcast_to(order, seen.shape)
    first = np.argmax(np.take_along_axis(seen, order, axis=-1), axis=-1)
    return np.take_along_axis(order, first[..., np.newaxis], axis=-1)[..., 0]


def chosen_rows(rows: NDArray[Any], target: NDArray[np.int64]) -> NDArray[np.float64]:
    """Of the rows (..., n, K, d) of each robot its target, (..., n): (..., n, d), float64."""
    chosen = target[..., np.newaxis, np.newaxis]
    return np.take_along_axis(rows, chosen, axis=-2)[..., 0, :].astype(np.float64)
