"""What makes the links of a state from outside fit to be handed to compiled code."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenario.scenario import Scenario

_Ends = tuple[NDArray[np.int64], NDArray[np.int64]]


def check_lists(n: int, state: Mapping[str, NDArray[Any]]) -> None:
    """Lists of links: indices of two robots, the lower one first, sorted, those in use first.

    A matrix of arcs has none from a robot to itself.

    Raises:
        ValueError: naming the entry, its value, and what would be right.
    """
    if state["weights"].ndim == 3:
        own = (state["weights"] > 0) & np.eye(n, dtype=bool)
        refuse_first("weights", own, state["weights"], "0: no robot is its own neighbour")
    if "first" not in state:
        return
    first, second, used = state["first"], state["second"], state["weights"] > 0
    refuse_first("first", (first < 0) | (first >= n), first, f"from 0 to {n - 1}")
    refuse_first("second", (second < 0) | (second >= n), second, f"from 0 to {n - 1}")
    refuse_first("second", used & (second <= first), second, "above the other robot of its link")
    order = first * n + second
    ahead = np.concatenate([np.full((len(used), 1), -1), order[:, :-1]], axis=1)
    refuse_first("first", used & (order <= ahead), first, "in the order of the links, each once")
    refuse_first("weights", used[:, 1:] & ~used[:, :-1], state["weights"][:, 1:], "0 after a 0")


def check_rows(scenario: Scenario, state: Mapping[str, NDArray[Any]]) -> None:
    """Every neighbour needs a row of the observation.

    Raises:
        ValueError: naming robot and team.
    """
    n, slots = scenario.n_robots, scenario.observation_layout.neighbour_slots
    used = state["weights"] > 0
    if used.ndim == 3:
        counts = used.sum(axis=2)
    else:
        counts = np.zeros((len(used), n), np.int64)
        team, e = np.nonzero(used)
        for ends in _ends(n, state):
            np.add.at(counts, (team, np.broadcast_to(ends, used.shape)[team, e]), 1)
    if (counts > slots).any():
        place = tuple(int(k) for k in np.argwhere(counts > slots)[0])
        raise ValueError(
            f"state: weights give robot_{place[1]} of team {place[0]} {counts[place]} neighbours; "
            f"there are rows for neighbour_slots = {slots}"
        )


def check_nobody_sees_the_merged(state: Mapping[str, NDArray[Any]]) -> None:
    """A robot that is part of another one has no links.

    Raises:
        ValueError: naming the link.
    """
    into, weights = state["merged_into"], state["weights"]
    n = into.shape[1]
    gone = into != np.arange(n)
    if weights.ndim == 3:
        of_gone = gone[:, :, None] | gone[:, None, :]
    else:
        shape = weights.shape
        first, second = (np.broadcast_to(ends, shape) for ends in _ends(n, state))
        of_gone = np.take_along_axis(gone, first, axis=1)
        of_gone = of_gone | np.take_along_axis(gone, second, axis=1)
    linked = (weights > 0) & of_gone
    refuse_first("weights", linked, weights, "0 for pairs with a merged-away robot")


def _ends(n: int, state: Mapping[str, NDArray[Any]]) -> _Ends:
    """Both robots of every link, (B, E) or (E,)."""
    if "first" in state:
        return state["first"], state["second"]
    first, second = np.triu_indices(n, 1)
    return first, second


def refuse_first(name: str, wrong: NDArray[np.bool_], values: NDArray[Any], what: str) -> None:
    """Name the first wrong place, (team,), (team, robot), (team, slot) or deeper, if there is
    one.
    """
    if wrong.any():
        place = tuple(int(k) for k in np.argwhere(wrong)[0])
        where = ", ".join(map(str, place))
        raise ValueError(f"state: {name}[{where}] is {values[place].tolist()}; it must be {what}")
