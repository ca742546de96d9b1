"""Blind baselines: what any policy that sees must do better than."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env.checks import bools, whole
from rendezvous_env.limits import LARGEST_SEED
from rendezvous_env.scenario.observation_layout import ObservedRows

from ..laws.paper_laws import Array, LawPolicy
from ..policy import Policy, TeamPolicy, register

if TYPE_CHECKING:
    from rendezvous_env.scenario.scenario import Scenario


@register("random", fits=lambda scenario: True, kind="blind")
@dataclass
class RandomPolicy(TeamPolicy):
    """Actions drawn at random, whatever is seen.

    They are uniform in the action space, from a generator of its own.
    """

    scenario: Scenario
    """Whose robots it steers."""
    seed: int = 0
    """Of the generator."""
    _generator: np.random.Generator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Start the stream."""
        self.seed = whole("seed", self.seed, 0, LARGEST_SEED)
        self.reset()

    def act(self, observations: NDArray[Any], time: ArrayLike) -> NDArray[np.float32]:
        """Actions (..., n, a); see ``Policy``."""
        bounds = self.scenario.action_bounds
        seen = self.scenario.observation_layout.checked(observations)
        shape = (*seen.shape[:-2], bounds.size)
        drawn: Array = self._generator.uniform(-bounds, bounds, shape)
        return drawn.astype(np.float32)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Start the stream anew; the teams share it, so a mask that spares some changes nothing."""
        if mask is None or bools("mask", mask, None, "teams").all():
            self._generator = np.random.default_rng(self.seed)


def _no_actions(f: Array, seen: ObservedRows, time: ArrayLike, *, size: int) -> Array:
    return np.zeros((*f.shape[:-1], size))


@register("zero", fits=lambda scenario: True, kind="blind")
def _zero(scenario: Scenario) -> Policy:
    """No action at all."""
    return LawPolicy(scenario, partial(_no_actions, size=scenario.action_size))
