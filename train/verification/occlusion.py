"""Law (1) on what other robots do not hide (guarantees 13)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rendezvous_env import Simulator
from rendezvous_env.trajectory import Policy

from .cases import Case
from .claim import Array, Mask


def what_is_seen(case: Case, num_envs: int, random: np.random.Generator) -> Policy:
    """Law (1) among robots that hide one another as discs or balls of radius r/2."""
    return Occluded()


class Occluded:
    """ṗ_i = Σ a_ij g_ij over the neighbours j that no nearer robot hides.

    It reads positions, as a stand-in for a sensor that cannot see through robots. Each neighbour
    must have a row of its own.
    """

    def watch(self, teams: Simulator) -> None:
        """Look at these teams."""
        self._teams = teams

    def __call__(self, observations: NDArray[np.float32], time: ArrayLike) -> NDArray[np.float32]:
        """Velocities (B, n, d), m/s."""
        scenario = self._teams.scenario
        hidden = self.hides(self._teams.positions, self._teams.active, scenario.merge_radius / 2.0)
        n = scenario.n_robots
        others = ~np.eye(n, dtype=bool)
        visible = ~hidden[:, others].reshape(-1, n, n - 1)
        rows = scenario.observation_layout.split(observations).neighbours
        velocities: NDArray[np.float32] = np.sum(rows * visible[..., None], axis=-2)
        return velocities

    def hides(self, positions: Array, active: Mask, radius: float) -> Mask:
        """(B, n, n): whether robot i cannot see robot j."""
        return hidden_by_robots(positions, active, radius)


def hidden_by_robots(positions: Array, active: Mask, radius: float) -> Mask:
    """Whether a nearer robot stands in the line of sight from robot i to the middle of robot j.

    Args:
        positions: (B, n, d), m.
        active: (B, n), who is there.
        radius: of the robots, m.

    Returns:
        (B, n, n).
    """
    n = positions.shape[1]
    offsets = positions[:, None] - positions[:, :, None]  # [i, j] from i to j
    distance = np.linalg.norm(offsets, axis=-1)
    apart = active[:, None] & active[:, :, None] & ~np.eye(n, dtype=bool)
    bearing = offsets / np.where(distance > 0, distance, 1.0)[..., None]
    cosine = np.einsum("bijd,bikd->bijk", bearing, bearing)
    # the disc of k subtends asin(radius/d_ik) from i
    share = np.minimum(radius / np.where(distance > 0, distance, np.inf), 1.0)
    covers = (cosine > np.sqrt(1.0 - share**2)[:, :, None, :]) & apart[:, :, None, :]
    nearer = distance[:, :, None, :] < distance[:, :, :, None]
    return np.asarray(np.any(covers & nearer, axis=-1))
