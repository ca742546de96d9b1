"""The state of a whole team as each of its robots would see it: for critics, while training only.

Privileged: positions and distances, which no robot can measure. What a critic has read is not
needed to act, so no policy that is served is shown any of it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.experiment.packing import CENTRE, RADIUS
from rendezvous_env.simulator import Simulator

ROBOT_COLUMNS = 4
"""Where a robot is, x, y, in units of FAR; log(1 + A/(r D̄)) of its tank, 0 without; 1."""
OBSTACLE_COLUMNS = 3
"""Centre x, y and radius of the bounding ball of an obstacle, in units of FAR."""
CONTEXT_COLUMNS = 2
"""V/V(0); the share of the time limit that has passed."""
FAR = 5.0
"""m."""


class Situation(NamedTuple):
    """The global state taken apart; every part is a view."""

    robots: Any
    """(..., n, ROBOT_COLUMNS); rows of robots that are gone are zero."""
    obstacles: Any
    """(..., M, OBSTACLE_COLUMNS); rows of obstacles that are absent are zero."""
    context: Any
    """(..., CONTEXT_COLUMNS)."""


class GlobalStateLayout(NamedTuple):
    """Which part of a flat row of numbers is what."""

    n_robots: int
    """n."""
    obstacle_slots: int
    """M."""

    @property
    def size(self) -> int:
        """Numbers for each robot."""
        rows = self.n_robots * ROBOT_COLUMNS + self.obstacle_slots * OBSTACLE_COLUMNS
        return rows + CONTEXT_COLUMNS

    def split(self, state: Any) -> Situation:
        """Take (..., size) apart, an array or a tensor."""
        leading, stop = state.shape[:-1], self.n_robots * ROBOT_COLUMNS
        return Situation(
            state[..., :stop].reshape(*leading, self.n_robots, ROBOT_COLUMNS),
            state[..., stop:-CONTEXT_COLUMNS].reshape(
                *leading, self.obstacle_slots, OBSTACLE_COLUMNS
            ),
            state[..., -CONTEXT_COLUMNS:],
        )

    def states(
        self, simulator: Simulator, towards: NDArray[Any], levels: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Global states of B teams in the plane.

        Every robot's is written from where it is, in the frame with x along f.

        Args:
            simulator: of the teams.
            towards: f_i in the robots' own frames, (B, n, 2), of any length; zero is local x.
            levels: A/(r D̄) of the tanks, (B, n).

        Returns:
            (B, n, size); zeros for robots that are gone.
        """
        positions, active = simulator.positions, simulator.active
        axes = _axes(simulator.frames, towards)
        batch, n = active.shape
        robots = np.ones((batch, n, n, ROBOT_COLUMNS))
        robots[..., :2] = _seen_from(positions, axes, positions)
        robots[..., 2] = np.log1p(levels)[:, np.newaxis]
        robots *= active[:, np.newaxis, :, np.newaxis]
        table = simulator.obstacles
        obstacles = np.zeros((batch, n, self.obstacle_slots, OBSTACLE_COLUMNS))
        there = obstacles[:, :, : table.shape[1]]
        there[..., :2] = _seen_from(positions, axes, table[..., CENTRE : CENTRE + 2])
        there[..., 2] = table[:, np.newaxis, :, RADIUS] / FAR
        there *= (table[..., RADIUS] > 0.0)[:, np.newaxis, :, np.newaxis]
        context = np.stack(
            (
                simulator.lyapunov() / simulator.initial_lyapunov,
                simulator.steps / simulator.max_steps,
            ),
            axis=-1,
        )
        rows = (robots.reshape(batch, n, -1), obstacles.reshape(batch, n, -1))
        context = np.broadcast_to(context[:, np.newaxis], (batch, n, CONTEXT_COLUMNS))
        states = np.concatenate((*rows, context), axis=-1) * active[..., np.newaxis]
        return states.astype(np.float32)


def _axes(frames: NDArray[np.float64], towards: NDArray[Any]) -> NDArray[np.float64]:
    """Axes (B, n, 2, 2) of the frames with x along f, rows in the global frame."""
    x = towards.astype(np.float64)
    length = np.linalg.norm(x, axis=-1, keepdims=True)
    x = np.where(length > 0.0, x / np.where(length > 0.0, length, 1.0), [1.0, 0.0])
    x = np.einsum("bnij,bnj->bni", frames, x)
    return np.stack((x, np.stack((-x[..., 1], x[..., 0]), axis=-1)), axis=-2)


def _seen_from(
    positions: NDArray[np.float64], axes: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (B, k, 2), m, from robots at positions (B, n, 2): (B, n, k, 2), in units of FAR."""
    apart = points[:, np.newaxis] - positions[:, :, np.newaxis]
    return np.einsum("bnij,bnkj->bnki", axes, apart) / FAR
