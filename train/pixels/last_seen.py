"""Policies with memory and search for robots whose neighbours are occluded."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rendezvous_env.baselines.policy import Policy

from rendezvous_env.scenario.scenario import Scenario

from .. import policies

_PATIENCE = 6.0
"""Time for which the last detections are held before the search starts, s."""
_TURN = np.pi * (3.0 - np.sqrt(5.0))
"""Angle between successive search directions, the golden angle, rad."""


class LastSeen:
    """Policy wrapper that moves towards the last detections when all neighbours are hidden.

    Law (1) and its derivatives stop without a visible neighbour, so two robots on opposite sides of
    an obstacle would never meet. After a while the robot searches.
    """

    def __init__(self, policy: Policy, scenario: Scenario) -> None:
        self._policy, self._layout = policy, scenario.observation_layout
        self._tau, self._patience = scenario.tau, round(_PATIENCE / scenario.tau)
        self._rows: NDArray[np.float32] | None = None
        self._since = np.zeros(0, int)
        self.reset()

    def __call__(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Actions, see ``Policy``."""
        shown = np.array(observations)
        rows = self._layout.split(shown).neighbours
        if self._rows is None or self._rows.shape != rows.shape:
            self._rows = np.zeros_like(rows)
            self._since = np.full(rows.shape[:-2], self._patience)
        nobody = np.asarray(~rows.any(axis=(-2, -1)))
        self._since = np.where(nobody, self._since + 1, 0)
        self._rows = np.where(nobody[..., None, None], self._rows, rows)
        rows[...] = self._rows
        seeking = self._since > self._patience
        rows[seeking] = 0.0
        sought = self._tau * (self._since - self._patience)[seeking]  # s
        # legs of 3, 5, 7, … s: with legs of equal length two robots would circle separately
        rows[seeking, 0] = unit(_TURN * (np.floor(np.sqrt(1.0 + sought)) - 1.0))
        return self._policy(shown, time)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Clear the memory of some environments, or of all."""
        self._policy.reset(mask)
        if mask is None:
            self._rows = None
        elif self._rows is not None:
            self._since[mask] = self._patience


def make(name: str, scenario: Scenario) -> Policy:
    """Named policy with memory of the last detections."""
    return LastSeen(policies.make(name, scenario), scenario)


def unit(angles: ArrayLike) -> NDArray[np.float64]:
    """Unit vectors (..., 2) of angles (...), rad."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)
