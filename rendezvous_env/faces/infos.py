"""What is told of a step beside observations and rewards, in the forms of Gymnasium."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..outcome import Outcome
from ..simulator import Simulator
from ..team_readings import STANDING

Info = dict[str, Any]
Transition = tuple[
    NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info
]
"""Observations, rewards, terminations, truncations and infos of B teams."""


def start_info(simulator: Simulator) -> Info:
    """Infos of all teams at the start of an episode, without masks."""
    active = simulator.active
    return simulator.standing() | {
        "robot_rewards": np.zeros(active.shape),
        "active": active,
        "merged_into": simulator.merged_into,
        "contact": np.zeros(active.shape, dtype=np.bool_),
        "clearance": simulator.clearance,
    }


def step_info(simulator: Simulator, outcome: Outcome) -> Info:
    """Infos of all teams after a step, without masks."""
    return simulator.standing(outcome) | {
        "robot_rewards": outcome.robot_rewards,
        "active": outcome.active,
        "merged_into": simulator.merged_into,
        "contact": outcome.contact,
        "clearance": outcome.clearance,
    }


def summary_of(infos: Info, ended: NDArray[np.bool_]) -> Info:
    """How the episodes of these teams went, of ``step_info``, as copies."""
    return masked({key: infos[key].copy() for key in STANDING}, ended)


def of_all(infos: Info, num_envs: int) -> Info:
    """Infos that every team has, in Gymnasium's form."""
    return _with_masks(infos, _everyone(len(infos), num_envs).copy())


def masked(infos: Info, mask: NDArray[np.bool_]) -> Info:
    """Infos of the teams of a mask, in Gymnasium's form."""
    return _with_masks(infos, np.full((len(infos), len(mask)), mask))


def _with_masks(infos: Info, masks: NDArray[np.bool_]) -> Info:
    """To every key a mask ``_key`` of its own."""
    told, names = infos.copy(), _names_of_masks(tuple(infos))
    # to see whether a mask is left over, as ``strict`` would, takes as long as to hand all out
    told.update(zip(names, masks, strict=False))
    return told


@lru_cache
def _names_of_masks(keys: tuple[str, ...]) -> tuple[str, ...]:
    """Kept, since they are the same in each step."""
    return tuple(f"_{key}" for key in keys)


@lru_cache(maxsize=8)
def _everyone(keys: int, num_envs: int) -> NDArray[np.bool_]:
    """Masks that leave out nobody; to copy them takes half as long as to fill new ones."""
    return np.ones((keys, num_envs), dtype=np.bool_)


def of_first_team(infos: Info) -> Info:
    """Infos of team 0, without the axis of teams and without masks."""
    return {key: _first(values) for key, values in infos.items() if key[0] != "_"}


def _first(values: Any) -> Any:
    """What is told of team 0: nested infos, an array, or one of Python's own numbers."""
    if isinstance(values, dict):
        return of_first_team(values)
    return values[0] if values.ndim > 1 else values[0].item()
