"""Privileged references of the field: laws that need relative positions.

They show what the distances would be worth that bearings lack.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rendezvous_env.safety.enclosing_ball import smallest_enclosing_ball
from rendezvous_env.scenario.scenario import Scenario
from rendezvous_env.simulator import Simulator

from ..policy import Policy, is_single_integrator, register
from .privileged_policy import Array, PrivilegedPolicy

Mask = NDArray[np.bool_]


def linked_gains(simulator: Simulator, ways: Array) -> Array:
    """a_ij, (B, n, n), m/s, between robots that are linked and within each other's range.

    Args:
        simulator: the teams.
        ways: p_j − p_i, (B, n, n, d), m.
    """
    gains, sight = simulator.weights, simulator.scenario.sensing.range
    if sight is None:
        return gains
    return np.where(np.linalg.norm(ways, axis=-1) <= sight, gains, 0.0)


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


def within_a_step(rest: Array, scenario: Scenario) -> Array:
    """Velocities that lead straight to a place at the speed limit, and not beyond it in a step.

    Args:
        rest: ways that are left, (..., d), m.
        scenario: gives v_max and τ.

    Returns:
        (..., d), m/s.
    """
    distance = np.linalg.norm(rest, axis=-1, keepdims=True)
    speed = scenario.speed_limit / np.where(distance > 0.0, distance, 1.0)
    return rest * np.minimum(speed, 1.0 / scenario.tau)


class PrivilegedConsensus(PrivilegedPolicy):
    """Linear consensus, slowed where a step would lead beyond the neighbours' mean."""

    name = "privileged-consensus"

    def _velocities(
        self, simulator: Simulator, positions: Array, active: Mask, begun: Mask
    ) -> Array:
        ways = positions[:, np.newaxis] - positions[:, :, np.newaxis]
        gains = linked_gains(simulator, ways)
        held = self.scenario.tau * gains.sum(axis=-1, keepdims=True)
        return consensus_law(ways, gains) / np.maximum(held, 1.0)


class PrivilegedCircumcentre(PrivilegedPolicy):
    """Each robot goes to the circumcentre of what it sees, and no farther than keeps its links."""

    name = "privileged-circumcentre"

    def _velocities(
        self, simulator: Simulator, positions: Array, active: Mask, begun: Mask
    ) -> Array:
        ways = positions[:, np.newaxis] - positions[:, :, np.newaxis]
        linked, sight = linked_gains(simulator, ways) > 0.0, self.scenario.sensing.range
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


class PrivilegedEnclosingBall(PrivilegedPolicy):
    """All go straight to the centre of the smallest ball about the start: nobody can be sooner."""

    name = "privileged-enclosing-ball"

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._centres: Array = np.zeros((0, scenario.dim))

    def _velocities(
        self, simulator: Simulator, positions: Array, active: Mask, begun: Mask
    ) -> Array:
        if len(self._centres) != len(begun):
            self._centres = np.zeros((len(begun), self.scenario.dim))
        for team in np.flatnonzero(begun):
            self._centres[team], _ = smallest_enclosing_ball(positions[team, active[team]])
        return within_a_step(self._centres[:, np.newaxis] - positions, self.scenario)


class PrivilegedNearestPursuit(PrivilegedPolicy):
    """Each robot goes straight at the nearest of those it sees; which that is no bearing tells."""

    name = "privileged-nearest-pursuit"

    def _velocities(
        self, simulator: Simulator, positions: Array, active: Mask, begun: Mask
    ) -> Array:
        ways = positions[:, np.newaxis] - positions[:, :, np.newaxis]
        linked = linked_gains(simulator, ways) > 0.0
        distances = np.where(linked, np.linalg.norm(ways, axis=-1), np.inf)
        nearest = np.argmin(distances, axis=-1)[..., np.newaxis]
        way = np.take_along_axis(ways, nearest[..., np.newaxis], axis=-2)[..., 0, :]
        way = np.where(linked.any(axis=-1, keepdims=True), way, 0.0)
        distance = np.linalg.norm(way, axis=-1, keepdims=True)
        return self.scenario.speed_limit * way / np.where(distance > 0.0, distance, 1.0)


@register(PrivilegedConsensus.name, fits=is_single_integrator, kind="privileged", on_request=True)
def _privileged_consensus(scenario: Scenario) -> Policy:
    """Linear consensus: towards the neighbours, the faster the farther they are."""
    return PrivilegedConsensus(scenario)


@register(
    PrivilegedCircumcentre.name, fits=is_single_integrator, kind="privileged", on_request=True
)
def _privileged_circumcentre(scenario: Scenario) -> Policy:
    """To the circumcentre of what is seen, no farther than keeps links of limited range."""
    return PrivilegedCircumcentre(scenario)


@register(
    PrivilegedEnclosingBall.name, fits=is_single_integrator, kind="privileged", on_request=True
)
def _privileged_enclosing_ball(scenario: Scenario) -> Policy:
    """Straight to the centre of the smallest ball about the start; ignores obstacles."""
    return PrivilegedEnclosingBall(scenario)


@register(
    PrivilegedNearestPursuit.name, fits=is_single_integrator, kind="privileged", on_request=True
)
def _privileged_nearest_pursuit(scenario: Scenario) -> Policy:
    """Straight at the nearest robot that is seen."""
    return PrivilegedNearestPursuit(scenario)
