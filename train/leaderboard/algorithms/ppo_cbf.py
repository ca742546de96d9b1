"""PPO whose velocities pass a control-barrier-function filter (Ames et al. 2017).

With d the distance of a robot to a disc and n the unit vector away from it, a velocity u becomes

    v = argmin ‖v − u‖²   subject to   nᵀv ≥ −α d   for all nearby discs,   α = 1/(2τ)

d is convex, so after the step it is at least d + τ nᵀv ≥ d/2: no contact between merges. The filter
does not account for the displacement at a merge. It uses distances to discs, which a bearing sensor
does not provide, and does not constrain V, so it does not guarantee rendezvous.
"""

from typing import Any

import numpy as np
from gymnasium.vector import VectorWrapper
from numpy.typing import NDArray
from rendezvous_env.baselines.policy import in_the_plane

from rendezvous_env.compilation import kernel
from rendezvous_env.obstacles.disc import BALL
from rendezvous_env.obstacles.fields import ObstacleField
from rendezvous_env.obstacles.shape import CENTRE, KIND, RADIUS
from rendezvous_env.physics.half_planes import nearest_within

from .ppo import algorithm

Floats = NDArray[np.float64]
_NEAREST = 3


def kept_out(wanted: Floats, away: Floats, least: Floats) -> Floats:
    """Solve the planar QP for u (N, 2), n (N, K, 2) and −α d (N, K) ≤ 0; v = 0 is feasible."""
    _keep_out(wanted, -away, -least, kept := np.empty(wanted.shape))
    return kept


@kernel
def _keep_out(wanted: Any, towards: Any, rooms: Any, kept: Any) -> None:
    for i in range(len(wanted)):
        u = wanted[i, 0], wanted[i, 1]
        kept[i, 0], kept[i, 1] = nearest_within(u, towards[i], rooms[i], rooms.shape[1])


class Barrier(VectorWrapper):
    """Vector wrapper that applies the filter to velocities."""

    part_of_world = True  # no guarantee about V

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self.scenario, self.simulator = env.unwrapped.scenario, env.unwrapped.simulator

    def step(self, actions: Any) -> Any:
        """As the wrapped environment, with velocities (B, n, 2) filtered in the global frame."""
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


ALGORITHM = algorithm(
    "PPO with a control-barrier-function filter; a first contact costs 1",
    "CBF",
    "none",
    given="distances of discs",
    fits=lambda field: in_the_plane(field) and isinstance(field.obstacles, ObstacleField),
    wrap=Barrier,
)
