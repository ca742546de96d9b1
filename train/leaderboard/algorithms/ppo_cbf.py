"""PPO whose velocities pass a control-barrier-function filter (Ames et al. 2017).

With d the distance of a robot to a disc and n away from it, a velocity u becomes

    v = argmin ‖v − u‖²   so that   nᵀv ≥ −α d   for the discs near by,   α = 1/(2τ)

d is convex, so d after the step is at least d + τ nᵀv ≥ d/2: no contact between merges. A merge
puts robots elsewhere, which it does not see. It is given the distances and directions of discs,
which a sensor of bearings does not have. Nothing is said of V, so nobody is promised to meet.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rendezvous_env.baselines.learned.features import can_steer

from rendezvous_env.obstacles.disc import BALL
from rendezvous_env.obstacles.fields import ObstacleField
from rendezvous_env.obstacles.shape import CENTRE, KIND, RADIUS
from rendezvous_env.scenario.scenario import Scenario

from ..ppo import algorithm
from ..teams import Between

_NEAREST, _SWEEPS = 3, 8


def kept_out(
    wanted: NDArray[np.float64], away: NDArray[np.float64], least: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The QP in the plane: Hildreth's sweeps over its few constraints, then a share of what is left
    so that all hold; v = 0 always does.

    Args:
        wanted: u, (..., 2).
        away: n, (..., K, 2), unit vectors.
        least: −α d, (..., K), never positive.
    """
    v, duals = wanted.copy(), np.zeros(least.shape)
    for _ in range(_SWEEPS):
        for k in range(least.shape[-1]):
            normal = away[..., k, :]
            step = np.maximum(-duals[..., k], least[..., k] - (normal * v).sum(axis=-1))
            duals[..., k] += step
            v += step[..., None] * normal
    towards = -(away * v[..., None, :]).sum(axis=-1)
    share = np.where(towards > -least, -least / np.maximum(towards, 1e-12), 1.0)
    shares: NDArray[np.float64] = v * share.min(axis=-1)[..., None]
    return shares


class Barrier(Between):
    """Velocities pass the filter on their way to the robots."""

    def step(self, actions: Any) -> Any:
        """As the teams, with velocities (B, n, 2) filtered in the global frame."""
        simulator, scenario = self.simulator, self.scenario
        places, discs = simulator.positions, simulator.obstacles
        offset = places[:, :, None] - discs[:, None, :, CENTRE : CENTRE + 2]
        length = np.linalg.norm(offset, axis=-1)
        there = discs[:, None, :, KIND] == BALL
        distance = np.where(there, length - discs[:, None, :, RADIUS], np.inf)
        # farther away no constraint is active at full speed
        close = distance.min(axis=-1) < 2.0 * scenario.tau * scenario.speed_limit
        if not close.any():
            return self.env.step(actions)
        near = np.argsort(distance[close], axis=-1)[:, :_NEAREST]
        directions = offset[close] / length[close][..., None]
        away = np.take_along_axis(directions, near[..., None], axis=1)
        kept = np.maximum(np.take_along_axis(distance[close], near, axis=1), 0.0)
        frames, actions = simulator.frames[close], np.array(actions, np.float32)
        u = np.einsum("kij,kj->ki", frames, actions[close].astype(np.float64))
        v = kept_out(u, away, -kept / (2.0 * scenario.tau))
        actions[close] = np.einsum("kji,kj->ki", frames, v)
        return self.env.step(actions)


def _fits(field: Scenario) -> bool:
    return can_steer(field) and isinstance(field.obstacles, ObstacleField)


ALGORITHM = algorithm(
    "PPO behind a control-barrier-function filter; a first touch costs 1",
    "CBF",
    "none",
    given="distances of discs",
    safety="none",
    wrap=Barrier,
    fits=_fits,
)
