"""Unicycles among obstacles: they drive where their axis points past every silhouette.

Who stands outside a shape and moves along a ray outside its silhouette never enters it. So a
unicycle that turns on the spot until its axis is clear meets nothing that it sees, however slowly
it turns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.compilation import kernel
from rendezvous_env.physics.vectors import X_AXIS
from rendezvous_env.safety.turning import mean_axis, rates_of
from rendezvous_env.scenario.scenario import Scenario

from ..policy import within_limits
from ..steering import Steering
from .merged_silhouettes_2d import is_clear


def in_the_plane_or_turning(scenario: Scenario) -> bool:
    """Whether robots are single integrators or unicycles of the plane that may see obstacles."""
    known = scenario.robot_model in ("single_integrator", "unicycle")
    return known and scenario.dim == 2 and scenario.observation_layout.obstacle_slots > 0


def steered(
    steering: Steering, wanted: NDArray[Any], observations: NDArray[Any], scenario: Scenario
) -> NDArray[np.float32]:
    """Actions (..., n, a) that follow velocities (..., n, d), m/s, of robots that see (..., n,
    rows, d); unicycles rest while they do not point past all silhouettes.
    """
    actions = within_limits(steering.actions(wanted, observations), scenario)
    if steering.turns and scenario.dim == 2:
        seen = np.ascontiguousarray(scenario.observation_layout.split(observations).obstacles)
        silhouettes = seen.reshape(-1, *seen.shape[-3:])
        _hold_back(actions.reshape(-1, actions.shape[-1]), silhouettes, steering.gate)
    return actions


@kernel
def _hold_back(actions, silhouettes, gate):
    for i in range(actions.shape[0]):
        if not axis_is_clear(rates_of(actions[i], gate), silhouettes[i], gate):
            actions[i, 0] = 0.0


@kernel
def axis_is_clear(rates, silhouettes, gate):
    """Whether the body axis, and its mean over a step, point past all silhouettes.

    Args:
        rates: turn rates, a pair, rad/s.
        silhouettes: (M, 2, 2) of one unicycle.
        gate: a Gate.
    """
    ahead, on_the_way = X_AXIS, mean_axis(rates, 0.0, gate)
    return is_clear(ahead, silhouettes, 0.0) and is_clear(on_the_way, silhouettes, 0.0)
