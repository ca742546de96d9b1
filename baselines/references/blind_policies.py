"""Blind baselines, which ignore observations."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import bools
from rendezvous_env.scenario.observation_layout import ObservedRows
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.scenario.start_options import check_seed

from ..laws.paper_laws import Array, Law
from ..policy import Float32, Mask, TeamPolicy, register


@register("random", fits=lambda scenario: True, kind="blind")
@dataclass
class RandomPolicy(TeamPolicy):
    """Uniformly random actions."""

    scenario: Scenario
    seed: int = 0

    def __post_init__(self) -> None:
        """Initialise the random stream."""
        self.seed = check_seed(self.seed)
        self.reset()

    def act(self, observations: NDArray[Any], time: ArrayLike) -> Float32:
        """Actions (..., n, a); see ``Policy``."""
        bounds = self.scenario.action_bounds
        size = bounds.size
        bounds = self.scenario.robot_bounds if self.scenario.per_robot else bounds
        seen = self.scenario.observation_layout.checked(observations)
        drawn = self._generator.uniform(-bounds, bounds, (*seen.shape[:-2], size))
        return drawn.astype(np.float32)

    def reset(self, mask: Mask | None = None) -> None:
        """Restart the random stream, shared by all environments; a partial mask has no effect."""
        if mask is None or bools("mask", mask, None, "environments").all():
            self._generator = np.random.default_rng(self.seed)


@register("zero", fits=lambda scenario: True, kind="blind")
class _Zero(Law):
    """Zero actions."""

    def actions(self, f: Array, seen: ObservedRows, time: ArrayLike) -> Array:
        return np.zeros((*f.shape[:-1], self.scenario.action_size))
