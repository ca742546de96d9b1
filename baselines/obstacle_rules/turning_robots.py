"""Robots that turn among obstacles: they drive where their axis points past every silhouette.

Who stands outside a shape and moves along a ray outside its silhouette never enters it. So a
robot that turns on the spot until its axis is clear meets nothing that it sees, however slowly it
turns.
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
from ..steering import Steering, can_steer
from .merged_silhouettes_2d import is_clear
from .planes_in_space import lies_outside, widened_rays

FLAT = 0.04
"""rad; no more do the flat sides between eight boundary rays lie within a round cone."""


def can_pass_obstacles(scenario: Scenario) -> bool:
    """Whether ``Steering`` knows a scenario's robots, and they may see obstacles."""
    return can_steer(scenario) and scenario.observation_layout.obstacle_slots > 0


def steered(
    steering: Steering, wanted: NDArray[Any], observations: NDArray[Any], scenario: Scenario
) -> NDArray[np.float32]:
    """Actions (..., n, a) that follow velocities (..., n, d), m/s, of robots that see (..., n,
    rows, d); robots that turn rest while they do not point past all silhouettes.
    """
    actions = within_limits(steering.actions(wanted, observations), scenario)
    if steering.turns:
        seen = np.ascontiguousarray(scenario.observation_layout.split(observations).obstacles)
        pitches = steering.pitches(observations).reshape(-1)
        hold_back = _hold_back if scenario.dim == 2 else _hold_back_3d
        flat = actions.reshape(-1, actions.shape[-1])
        hold_back(flat, seen.reshape(-1, *seen.shape[-3:]), pitches, steering.gate)
    return actions


@kernel
def _hold_back(actions, silhouettes, pitches, gate):
    for i in range(actions.shape[0]):
        if not axis_is_clear(rates_of(actions[i], gate), silhouettes[i], gate):
            actions[i, 0] = 0.0


@kernel(allocates=True)
def _hold_back_3d(actions, silhouettes, pitches, gate):
    rays = np.empty(silhouettes.shape[1:])
    for i in range(actions.shape[0]):
        cones = rays[: widened_rays(silhouettes[i], FLAT, rays)]
        if not axis_is_clear_3d(rates_of(actions[i], gate), pitches[i], cones, gate):
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


@kernel
def axis_is_clear_3d(rates, pitch, rays, gate):
    """As ``axis_is_clear``, of cones (K, 8, 3); the pitch is β at the start of the step, rad."""
    on_the_way = mean_axis(rates, pitch, gate)
    return lies_outside(X_AXIS, rays) and lies_outside(on_the_way, rays)
