"""Oracle baselines of the literature: laws that need relative positions.

They show what the distances would be worth that bearings lack.
"""

from __future__ import annotations

import numpy as np

from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.simulator import Simulator

from ..laws.literature_laws import unit_mean_law
from ..laws.neighbour_order import chosen_rows
from ..policy import is_single_integrator, register
from .enclosing_ball import smallest_enclosing_ball
from .privileged_policy import Array, Mask, PrivilegedPolicy, within_a_step


def consensus_law(ways: Array, gains: Array) -> Array:
    """Velocity towards the neighbours, the faster the farther they are.

        ṗᵢ = Σⱼ aᵢⱼ (pⱼ − pᵢ)                             (Olfati-Saber & Murray, 2004)

    Args:
        ways: p_j − p_i, (..., n, n, d), m.
        gains: a_ij, (..., n, n), here in 1/s.

    Returns:
        Velocities, (..., n, d), m/s.
    """
    return np.asarray(np.sum(gains[..., np.newaxis] * ways, axis=-2))


def circumcentres(positions: Array, linked: Mask) -> Array:
    """Centres of the smallest balls about each robot and its neighbours.

    Args:
        positions: p, (n, d), m.
        linked: who is whose neighbour, (n, n).

    Returns:
        (n, d), m.
    """
    company, which = np.unique(
        linked | np.eye(len(positions), dtype=bool), axis=0, return_inverse=True
    )
    centres = [smallest_enclosing_ball(positions[members])[0] for members in company]
    return np.array(centres)[which.reshape(-1)]


def farthest_steps(towards: Array, ways: Array, linked: Mask, sight: float) -> Array:
    """How far robots may go in one step and still see their neighbours, wherever those go.

        lᵢⱼ = (dⱼ/2) cos θⱼ + √((R/2)² − ((dⱼ/2) sin θⱼ)²),   minⱼ lᵢⱼ       (Ando et al., 1999)

    Each of two neighbours stays in the ball of radius R/2 about the midpoint between them.

    Args:
        towards: unit vectors along which they go, (n, d).
        ways: p_j − p_i, (n, n, d), m; d_j long, at θ_j from ``towards``.
        linked: who is whose neighbour, (n, n).
        sight: R, m.

    Returns:
        (n,), m; inf for a robot without a neighbour.
    """
    along = 0.5 * np.sum(ways * towards[:, np.newaxis], axis=-1)
    aside = np.maximum(0.25 * np.sum(ways**2, axis=-1) - along**2, 0.0)
    limits = along + np.sqrt(np.maximum(0.25 * sight**2 - aside, 0.0))
    return np.asarray(np.min(np.maximum(limits, 0.0), axis=-1, where=linked, initial=np.inf))


def _ways_and_gains(simulator: Simulator) -> tuple[Array, Array]:
    """p_j − p_i, (B, n, n, d), m; and a_ij, (B, n, n), m/s, of robots within each other's range."""
    positions, sight = simulator.positions, simulator.scenario.sensing.range
    ways, gains = positions[:, np.newaxis] - positions[:, :, np.newaxis], simulator.weights
    if sight is not None:
        gains = np.where(np.linalg.norm(ways, axis=-1) <= sight, gains, 0.0)
    return ways, gains


@register("privileged-consensus", is_single_integrator, kind="privileged", on_request=True)
class PrivilegedConsensus(PrivilegedPolicy):
    """Linear consensus: towards the neighbours, the faster the farther they are.

    Slowed where a step would lead beyond the neighbours' mean.
    """

    name = "privileged-consensus"

    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        ways, gains = _ways_and_gains(simulator)
        held = self.scenario.tau * gains.sum(axis=-1, keepdims=True)
        return consensus_law(ways, gains) / np.maximum(held, 1.0)


@register("privileged-circumcentre", is_single_integrator, kind="privileged", on_request=True)
class PrivilegedCircumcentre(PrivilegedPolicy):
    """To the circumcentre of what is seen, no farther than keeps links of limited range."""

    name = "privileged-circumcentre"

    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        ways, gains = _ways_and_gains(simulator)
        linked, sight = gains > 0.0, self.scenario.sensing.range
        positions = simulator.positions
        rest = np.zeros_like(positions)
        for team in np.flatnonzero(active.sum(axis=1) > 1):
            here = np.flatnonzero(active[team])
            among = linked[team][np.ix_(here, here)]
            goals = circumcentres(positions[team, here], among) - positions[team, here]
            if sight is not None:
                length = np.linalg.norm(goals, axis=-1, keepdims=True)
                towards = goals / np.where(length > 0.0, length, 1.0)
                nearby = ways[team][np.ix_(here, here)]
                most = farthest_steps(towards, nearby, among, sight)[:, np.newaxis]
                goals = towards * np.minimum(length, most)
            rest[team, here] = goals
        return within_a_step(rest, self.scenario)


@register("privileged-enclosing-ball", is_single_integrator, kind="privileged", on_request=True)
class PrivilegedEnclosingBall(PrivilegedPolicy):
    """Straight to the centre of the smallest ball about the start; ignores obstacles.

    Nobody can be sooner.
    """

    name = "privileged-enclosing-ball"

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._centres: Array = np.zeros((0, scenario.dim))

    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        positions = simulator.positions
        if len(self._centres) != len(begun):
            self._centres = np.zeros((len(begun), self.scenario.dim))
        for team in np.flatnonzero(begun):
            self._centres[team], _ = smallest_enclosing_ball(positions[team, active[team]])
        return within_a_step(self._centres[:, np.newaxis] - positions, self.scenario)


@register("privileged-nearest-pursuit", is_single_integrator, kind="privileged", on_request=True)
class PrivilegedNearestPursuit(PrivilegedPolicy):
    """Straight at the nearest robot that is seen; which that is no bearing tells."""

    name = "privileged-nearest-pursuit"

    def _velocities(self, simulator: Simulator, active: Mask, begun: Mask) -> Array:
        ways, gains = _ways_and_gains(simulator)
        linked = gains > 0.0
        distances = np.where(linked, np.linalg.norm(ways, axis=-1), np.inf)
        way = chosen_rows(ways, np.argmin(distances, axis=-1))
        way = np.where(linked.any(axis=-1, keepdims=True), way, 0.0)
        return unit_mean_law(way, speed=self.scenario.speed_limit)
